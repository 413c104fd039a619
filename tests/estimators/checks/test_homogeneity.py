"""Agreement of recordings: another payload is named and measured, and one plant is one plant."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, random_case, simulate
from estimators import compare, identify
from estimators.checks.homogeneity import (
    ComparedParameters,
    Disagreement,
    RecordingFit,
    find_disagreements,
    find_misfits,
    fit_each_recording,
    pool_fits,
)
from estimators.weak_form.preparation import prepare_windows
from pendulum_env.physics import BASE, effect
from pendulum_env.recording import Recording
from tests import slow
from tests.cases import diagnosed, make_recording

PLANT = Plant()
HEAVIER = replace(PLANT, inertia=1.1 * PLANT.inertia, gravity=1.1 * PLANT.gravity)
KINDS = ("two_tone", "multisine", "prbs")
RUBBING = replace(PLANT, effects={"stribeck": {"strib_d": 0.45, "strib_v": 0.6}})
GEARED = replace(PLANT, effects={"load_dependent_friction": {"load_mu": 0.1}})


def recorded(plants: list[Plant], seconds: float = 10.0) -> list[Recording]:
    """One recording of each plant at 500 Hz, under an excitation that differs from place to place."""
    cases = [(p, Experiment(500.0, seconds, KINDS[place % 3], seed=place)) for place, p in enumerate(plants)]
    return [make_recording(run, f"run {place}") for place, run in enumerate(simulate(cases))]


def test_recordings_of_one_plant_agree():
    rng, cases = np.random.default_rng(8), []
    for _ in range(8):
        sensors = {"rate": float(rng.choice([200.0, 500.0])), "counts": 65_536, "seconds": 10.0, "torque_noise": 0.05}
        plant = random_case(rng).plant
        cases += [(plant, random_case(rng, (), **sensors).train) for _ in range(3)]
    runs = [make_recording(run) for run in simulate(cases)]
    assert [
        find_disagreements(fit_each_recording([prepare_windows(runs[j : j + 3])], BASE)) for j in range(0, 24, 3)
    ] == [()] * 8


def test_recordings_that_tell_a_sum_alone_are_compared_by_that():
    """Each knows two parameters along one direction only, so that no covariance has an inverse."""
    (own,) = fit_each_recording([prepare_windows(recorded([PLANT]))], BASE)
    along = np.array([[1.0, 1.0], [1.0, 1.0]]) * 1e-4

    def make_recording(number: int, value: float) -> RecordingFit:
        known = ComparedParameters(np.full(2, value), along, np.zeros(2))
        return replace(own, number=number, columns=own.columns[:2], estimates=known)

    assert np.isfinite(pool_fits([make_recording(1, 1.0), make_recording(2, 1.0)]).theta).all()
    assert find_disagreements([make_recording(1, 1.0), make_recording(2, 1.0), make_recording(3, 1.0)]) == ()
    assert [
        one.number
        for one in find_disagreements([make_recording(1, 1.0), make_recording(2, 1.0), make_recording(3, 2.0)])
    ] == [3]


@pytest.mark.parametrize("heavier", [0, 1, 2])
def test_the_one_recording_with_a_heavier_payload_is_named_and_measured(heavier):
    plants = [HEAVIER if j == heavier else PLANT for j in range(3)]
    (one,) = find_disagreements(fit_each_recording([prepare_windows(recorded(plants))], BASE))
    assert (one.number, one.recording, len(one.others)) == (heavier + 1, f"run {heavier}", 2)
    differences = {d.parameter: d for d in one.differences}
    assert differences.keys() == {"inertia", "gravity"}
    for difference in differences.values():
        assert difference.value / difference.others == pytest.approx(1.1, abs=0.01)
        assert abs(difference.value - 1.1 * difference.others) < 4 * difference.std + 0.005 * difference.others
    assert not one.is_turned and one.torque_factor is None and one.recording == f"run {heavier}"


@pytest.mark.slow
def test_a_missing_effect_is_found_beside_another_payload():
    hidden = {"quadratic_drag": {"drag": 0.04}}
    runs = recorded([replace(plant, effects=hidden) for plant in (PLANT, HEAVIER, PLANT)])
    found = diagnosed(runs, only=("quadratic_drag", "stribeck", "gravity_tilt"))
    assert found.selected == ("quadratic_drag",)
    assert [one.number for one in found.disagreements] == [2]


def test_a_held_out_recording_may_disagree_too():
    (one,) = diagnosed(recorded([PLANT]), recorded([PLANT, HEAVIER])[1:], only=["stribeck"]).disagreements
    assert (one.number, one.others) == (2, ("run 0",))


def test_what_is_no_other_plant_is_not_told():
    """A payload that changes within a recording, a recording that excites little, an effect that is missing."""
    changing = replace(PLANT, effects={"payload_change": {"pay_t": 5.0, "pay_I": 0.02, "pay_mgl": 0.4}})
    terms = (*BASE, effect("payload_change")(moment=5.0))
    assert find_disagreements(fit_each_recording([prepare_windows(recorded([PLANT, changing, PLANT]))], terms)) == ()
    short = recorded([HEAVIER], seconds=1.5)
    assert find_disagreements(fit_each_recording([prepare_windows([*recorded([PLANT, PLANT]), *short])], BASE)) == ()
    fits = fit_each_recording([prepare_windows(recorded([GEARED] * 3))], BASE)
    assert find_disagreements(fits) and find_disagreements(fits, only_if_all_fit=True) == find_misfits(fits) == ()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_an_effect_that_each_recording_alone_takes_for_its_own_friction_is_no_other_plant(order):
    """Torque of one size, up and down, makes friction under load dry friction, of another size under another torque."""
    small = [Experiment(500.0, 10.0, "prbs", scale=scale, seed=seed) for scale, seed in ((1.0, 1), (0.4, 2))]
    runs = [make_recording(run) for run in simulate([(GEARED, experiment) for experiment in small])]
    assert find_disagreements(fit_each_recording([prepare_windows(runs)], BASE), only_if_all_fit=True)
    found = diagnosed([runs[k] for k in order], only=["load_dependent_friction", "stribeck", "quadratic_drag"])
    assert (found.selected, found.disagreements) == (("load_dependent_friction",), ())
    theta = {name: found.model.estimates[name].value for name in ("coulomb", "load_dependent_friction")}
    assert theta == pytest.approx({"coulomb": PLANT.coulomb, "load_dependent_friction": 0.1}, rel=0.02)


def turned(recording: Recording) -> Recording:
    return replace(recording, torque=-recording.torque)


@pytest.mark.parametrize("plant", [PLANT, RUBBING], ids=["complete", "stribeck"])
@pytest.mark.parametrize("which", slow.but_first([0, 1]))
def test_a_recording_whose_torque_is_turned_round_is_named_whatever_else_is_missing(plant, which):
    runs = recorded([plant] * 2)
    runs[which] = turned(runs[which])
    (one,) = find_disagreements(fit_each_recording([prepare_windows(runs)], BASE), only_if_all_fit=True)
    assert (one.number, one.others) == (which + 1, (f"run {1 - which}",))
    assert one.is_turned
    assert one in identify(runs, schemes="energy").findings
    alike = [turned(run) for run in recorded([plant] * 2)]
    assert find_disagreements(fit_each_recording([prepare_windows(alike)], BASE), only_if_all_fit=True) == ()


def test_a_torque_in_other_units_is_told_from_another_plant():
    runs = recorded([PLANT] * 3)
    runs[1] = replace(runs[1], torque=2 * runs[1].torque)
    (one,) = find_disagreements(fit_each_recording([prepare_windows(runs)], BASE), only_if_all_fit=True)
    assert one.number == 2
    assert one.torque_factor == pytest.approx(2, rel=1e-3)


@pytest.mark.slow
def test_a_recording_that_no_parameters_fit_is_named_beside_good_ones():
    runs = recorded([PLANT] * 3)
    runs[2] = replace(runs[2], position=runs[2].position + 0.3)  # of another encoder zero
    found = identify(runs, schemes="energy").findings
    assert [own.recording for own in found if isinstance(own, Disagreement) and own.residual is not None] == ["run 2"]
    assert compare(identify(runs[:2], schemes="energy")["energy"].model, runs).disagreements[0].recording == "run 2"
    assert identify(runs[:2], schemes="energy").findings == ()


def test_comparison_names_the_recordings_of_another_plant_than_the_models():
    first, *others = recorded([PLANT, PLANT, HEAVIER])
    model = identify(first, schemes="filtered_dynamic")["filtered_dynamic"].model
    found = compare(model, others)
    (one,) = found.disagreements
    assert (one.number, one.recording, one.others) == (2, "run 2", ())
    assert {d.parameter for d in one.differences} == {"inertia", "gravity"}
    rubbing = recorded([RUBBING] * 3)  # what lacks an effect is of no other plant
    assert compare(identify(rubbing[0], schemes="energy")["energy"].model, rubbing).disagreements == ()
