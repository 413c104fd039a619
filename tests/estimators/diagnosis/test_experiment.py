"""Suggested experiments: played on a plant that the models know nothing of, they settle what was open."""

from functools import cache

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import Diagnosis
from estimators.data.split import split_recordings
from estimators.diagnosis.experiment import SAFE_SHARE, ExperimentLimits, UnreachableAims, suggest_experiment
from estimators.diagnosis.questions import Question, make_typical_effect
from estimators.diagnosis.suggestion import Aim, Suggestion
from estimators.findings import Finding, Verdict
from estimators.selection.evidence import Evidence
from estimators.signals.residual import Region
from pendulum_env.physics import BASE, effects
from pendulum_env.recording import Recording
from tests.cases import diagnosed, recorded, recording

RATE = 500.0
FREELY = {"max_angle": np.inf, "max_speed": np.inf}
TIME = np.arange(6000) / RATE
WAGGING = 1.04 * np.sin(13 * TIME) + 0.64 * np.sin(9.3 * TIME + 1)  # within 0.3 rad
SPINNING = 4.6 + np.sin(5 * TIME) + 0.6 * np.sin(9 * TIME)  # never turns round
CASES: dict[str, tuple[Plant, np.ndarray]] = {
    "a spring at small angles": (Plant(coulomb=0.3, effects={"spring": {"spring_k": 0.4, "spring_q0": 0.0}}), WAGGING),
    "nothing at small angles": (Plant(coulomb=0.3), WAGGING),
    "a tilt at small angles": (Plant(coulomb=0.3, effects={"gravity_tilt": {"tilt_cos": 0.2}}), WAGGING),
    "an offset while spinning": (Plant(effects={"torque_offset": {"offset": 0.3}}), SPINNING),
}


def play(name: str, command: np.ndarray, seed: int = 2) -> Recording:
    """A command on the plant of a case."""
    experiment = Experiment(seed=seed, seconds=len(command) / RATE, rate=RATE)
    return recorded(CASES[name][0], experiment, commands=[command])[0]


@cache
def first(name: str) -> tuple[Recording, Diagnosis]:
    """The first recording of a case and its diagnosis."""
    recording = play(name, CASES[name][1], seed=1)
    return recording, diagnosed([recording], **FREELY)


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    return Evidence.from_data(*split_recordings([recording("moving")]))


def suggested(found: Diagnosis) -> Suggestion:
    assert found.suggestion is not None
    return found.suggestion


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "hidden", "before"),
    [
        ("a spring at small angles", "spring", ()),
        ("nothing at small angles", None, ()),
        ("a tilt at small angles", "gravity_tilt", ("torque_offset", "gravity_tilt")),
        ("an offset while spinning", "torque_offset", ()),
    ],
)
def test_the_suggested_experiment_settles_what_was_open(name, hidden, before):
    recording, found = first(name)
    assert set(before) <= {id for group in found.ambiguous for id in group}
    suggestion = suggested(found)
    assert any(aim.effect == hidden or aim.instead == hidden or hidden is None for aim in suggestion.settles)
    time = np.arange(round(suggestion.seconds * RATE)) / RATE
    settled = diagnosed([recording, play(name, suggestion.signal.signal(time))], **FREELY)
    assert settled.selected == (() if hidden is None else (hidden,))
    assert settled.suggestion is None
    assert settled.ambiguous == ((("torque_offset", "coulomb_asymmetry"),) if hidden == "torque_offset" else ())


def test_a_suggestion_says_what_to_expect_and_survives_json_and_what_it_asks_is_open_and_not_rejected_above():
    _, found = first("a spring at small angles")
    suggestion = suggested(found)
    assert Aim("spring", "gravity") in suggestion.settles
    assert suggestion.peak_torque <= 6.0
    assert suggestion.reach[1] - suggestion.reach[0] > 1.0  # beyond the small angles
    again = Suggestion.from_json(found.json()["suggestion"])
    time = np.linspace(0, suggestion.seconds, 999)
    np.testing.assert_array_equal(again.signal.signal(time), suggestion.signal.signal(time))
    assert again.json() == suggestion.json()
    verdicts = {candidate.effect: candidate.verdict for candidate in found.candidates}
    assert all(verdicts[aim.effect] in (Verdict.AMBIGUOUS, Verdict.NOT_EXCITED) for aim in suggestion.settles)


@pytest.mark.slow
def test_the_suggested_motion_stays_within_what_the_rig_bears():
    name = "a spring at small angles"
    recording, _ = first(name)
    suggestion = suggested(diagnosed([recording], max_angle=1.0, max_speed=4.0))
    run = play(name, suggestion.signal.signal(np.arange(round(suggestion.seconds * RATE)) / RATE))
    assert np.abs(run.position).max() <= 1.0
    assert np.abs(np.gradient(run.position[::10], 10 / RATE)).max() <= 4.0
    weak = suggested(diagnosed([recording], **FREELY, max_torque=2.5))
    assert weak.peak_torque <= 2.5
    assert np.abs(weak.signal.signal(np.linspace(0, weak.seconds, 9999))).max() <= 2.5
    assert diagnosed([recording, run]).selected == ("spring",)


def test_an_experiment_goes_where_most_is_left(evidence):
    model = evidence.fits.fit_with_std(BASE).model
    asked = [Question(Aim("spring"), BASE, make_typical_effect(effects()["spring"]))]
    low, high = evidence.train.get_range()

    def tried(place: float, **limits: float) -> tuple[Suggestion | None, Finding | None]:
        left = [Region("position", place - 0.1, place + 0.1, 0.1, 9.0)]
        suggestion, _, forbidden = suggest_experiment(evidence, model, asked, ExperimentLimits(6.0, **limits), left)
        return suggestion, forbidden

    for place in (0.6 * low, 0.6 * high):
        found, _ = tried(place)
        assert found is not None
        assert SAFE_SHARE * low <= found.reach[0] <= place <= found.reach[1] <= SAFE_SHARE * high
        most = {"angle": 0.8 * max(map(abs, found.reach)), "speed": 0.8 * found.peak_speed}
        for name in most:  # less far or less fast, if at all
            less, _ = tried(place, **{name: most[name]})
            assert less is None or {"angle": max(map(abs, less.reach)), "speed": less.peak_speed}[name] <= most[name]
    found, forbidden = tried(high + 2.0)
    assert found is None and forbidden.place.value == pytest.approx(high + 2.0)


@pytest.mark.parametrize(
    ("limits", "given"),
    [
        ({"max_torque": 0.5, **FREELY}, {"torque": 0.5}),
        ({}, {"torque": 6.0}),
        ({"max_angle": 0.3, "max_speed": 2.0}, {"torque": 6.0, "angle": 0.3, "speed": 2.0}),
    ],
)
def test_limits_that_leave_no_experiment_are_said(limits, given):
    recording, _ = first("a spring at small angles")
    found = diagnosed([recording], **limits)
    assert found.suggestion is None and UnreachableAims(found.no_experiment.aims) not in found.findings
    assert isinstance(found.no_experiment, UnreachableAims) and found.no_experiment.aims == (Aim("spring", "gravity"),)
    assert {name: found.no_experiment.limits[name].value for name in given} == given
    assert limits or found.no_experiment.limits.keys() == {"torque"}  # unless asked, it stays within what was recorded
    assert first("a spring at small angles")[1].no_experiment is None
