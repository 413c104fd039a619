"""What results show of themselves in a notebook: the numbers they hold, well-formed, and nothing that could run."""

from dataclasses import replace
from xml.etree import ElementTree

import gymnasium as gym
import numpy as np
import pytest

from estimators import Verdict, add, compare, diagnose, identify
from estimators.signals.residual import Region
from estimators.wrappers import EstimateParameters, EstimateParametersVector
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.formatting import format_estimate
from pendulum_env.physics import Model, effects
from pendulum_env.plant import make_plant
from pendulum_env.recording import Note, NoteKind, Recording
from tests.feeding import play_two_tones
from tests.terms import CubicDamping
from workbench.narrator import describe
from workbench.narrator.diagnosis import describe_region, describe_result
from workbench.printing import print_diagnosis
from workbench.terminal import Terminal

HOSTILE = "</div><script>alert('1')</script>&\"{{ 7 * 7 }}"
PENDULUM = "pendulum_env/DirectDrivePendulum-v0"


@pytest.fixture(scope="module")
def runs() -> tuple[Recording, Recording]:
    plant = make_plant(effects="stribeck=0.4")
    return tuple(
        record(plant, excitation("paper", seed, 8), 8, rate=500, rng=seed, name=f"{HOSTILE} {seed}") for seed in (1, 2)
    )


@pytest.fixture(scope="module")
def results(runs):
    """Every kind of result, by name."""
    few = {id: effects()[id] for id in ("stribeck", "quadratic_drag", "torque_offset")}
    diagnosis = diagnose(*runs, library=few)
    found = identify(runs[0])
    model = found["dynamic"].model
    return {
        "recording": runs[0],
        "model": diagnosis.model,
        "identification": found,
        "scheme": found["energy"],
        "comparison": compare(model, runs),
        "diagnosis": diagnosis,
        "addition": add(model, "stribeck", *runs),
        "estimates": online(gym.make(PENDULUM, rate=200)),
    }


def online(env):
    env = EstimateParameters(env, schemes=["energy"])
    env.reset(seed=0)
    return play_two_tones(env, 600)[-1]["estimates"]


def shown(result) -> str:
    """Text that a reader sees; what is not well-formed does not parse."""
    return " ".join("".join(ElementTree.fromstring(result._repr_html_()).itertext()).split())


KINDS = ("recording", "identification", "scheme", "comparison", "diagnosis", "addition", "model", "estimates")


@pytest.mark.parametrize("kind", KINDS)
def test_markup_is_well_formed_small_and_runs_nothing_and_plain_text_is_short(results, kind):
    markup = results[kind]._repr_html_()
    root = ElementTree.fromstring(markup)
    assert not [part for part in root.iter() if part.tag == "script" or {"src", "href", "onload"} & set(part.attrib)]
    assert len(markup) < 100_000 and "http" not in markup
    if kind in ("recording", "identification", "comparison"):
        assert HOSTILE in shown(results[kind])  # names are shown as they are
    if kind not in ("model", "estimates"):
        assert len(repr(results[kind])) < (2000 if kind == "identification" else 300)


def test_text_of_a_diagnosis_is_that_of_the_command_line(results, capsys):
    print_diagnosis(results["diagnosis"], Terminal(), hint="")
    lines = [line.rstrip() for line in capsys.readouterr().out.split("\n")]
    assert str(results["diagnosis"]).split("\n") == lines[1:-1]


@pytest.mark.parametrize("kind", ["comparison", "addition", "identification"])
def test_text_of_a_result_has_its_parameters_or_errors(results, kind):
    text = str(results[kind])
    error = results["comparison"].errors.torque_rms
    numbers = {
        "comparison": f"{error:.4g}",
        "addition": results["addition"].after.model.estimates["stribeck"].shown.text,
        "identification": results["scheme"].model.estimates["gravity"].shown.text,
    }
    assert numbers[kind] in text and "\n" in text


def test_a_verdict_is_found_by_the_name_of_its_effect(results):
    found = results["diagnosis"]
    assert found["stribeck"].verdict is Verdict.SELECTED and found["quadratic_drag"].decision.gates
    with pytest.raises(ValueError, match="did you mean quadratic_drag"):
        found["quadratic_dragg"]
    assert results["addition"].decision.passed and results["addition"].decision.gates


def test_text_of_a_finding_is_its_sentence(results):
    findings = results["identification"].findings
    assert findings and [str(finding) for finding in findings] == [describe(finding) for finding in findings]


def test_recording_tells_length_rate_notes_and_a_missing_torque(runs):
    text = shown(replace(runs[0], torque=0 * runs[0].torque, notes=(Note(NoteKind.FIRST_DATE, text="<Monday>"),)))
    assert "8 s at 500 Hz, 4000 samples" in text
    assert "time is counted from <Monday>" in text and "torque is never applied" in text
    assert "never applied" not in shown(runs[0])


def test_every_estimate_is_shown_with_its_error_and_every_region(results):
    text = shown(results["identification"])
    for result in results["identification"].schemes.values():
        for estimate in result.model.estimates.values():
            assert estimate.text in text
    for name, estimate in results["diagnosis"].model.estimates.items():
        assert f"{name}{format_estimate(estimate.value, estimate.std)}{estimate.unit}" in shown(results["model"])
    told, text = results["estimates"]["energy"], shown(results["estimates"])
    for pair in zip(told["theta"].values(), np.sqrt(np.diag(told["covariance"])), strict=True):
        assert "energy" in text and format_estimate(*pair) in text
    several = EstimateParametersVector(gym.make_vec(PENDULUM, num_envs=3), schemes=["dynamic"]).reset(seed=0)[1]
    assert "of the first of 3 pendulums" in shown(several["estimates"])
    regions, text = results["comparison"].regions, shown(results["comparison"])
    assert regions and all(describe_region(region) in text for region in regions)


def test_withheld_estimates_are_no_numbers(runs):
    one_way = replace(runs[0], position=np.linspace(0, 20, len(runs[0])) + 0.05 * np.sin(5 * runs[0].time))
    found = identify(one_way)
    assert "coulomb" in found["dynamic"].withheld
    value = found["dynamic"].model.estimates["coulomb"]
    assert format_estimate(value.value, value.std) not in shown(found["dynamic"])
    assert "unknown" in shown(found["dynamic"]) and "The velocity never changes sign" in shown(found)


def test_headline_says_no_more_than_was_looked_for(results):
    found = results["diagnosis"]
    base = replace(found, steps=found.steps[:1])
    region = Region("position", 0.1, 0.2, 0.05, 9.0, "rad")
    assert describe_result(base) == "Nothing is missing"
    assert (
        describe_result(replace(base, unexplained=(region,))) == "Something is missing, and no known effect explains it"
    )
    assert describe_result(replace(base, candidates=())) == "The model explains what was measured"
    assert describe_result(replace(base, candidates=(), unexplained=(region,))) == "Something is missing in this model"


def test_laws_of_users_are_escaped():
    own = type("Own", (CubicDamping,), {"law": "c <b>q'</b>"})
    assert "c <b>q'</b>" in shown(Model.build([own()], [1.0]))
