"""Sentences: each kind of finding has one, of short sentences, with its numbers in the unit that is shown."""

import re
from functools import partial
from typing import get_args

import pytest

from estimators.decisions.criterion import Criterion
from estimators.diagnosis.result import Detectable
from estimators.diagnosis.suggestion import Aim, Suggestion
from estimators.findings import Finding, Kind, Quantity
from estimators.signals.residual import Region
from pendulum_env.excitation import excitation
from pendulum_env.physics import Description, Term, list_nameable
from pendulum_env.physics.description import Symptom
from pendulum_env.physics.library import BUILT_IN
from pendulum_env.physics.table import TABLES, PowerOfSpeed
from pendulum_env.units import JointUnits, show_angles
from workbench.narrator.diagnosis import describe_detectable, describe_region, describe_suggestion
from workbench.narrator.effects import EFFECTS, find_description, find_look_alikes, name_effect
from workbench.narrator.findings import DESCRIBED, REASONS, describe

CURRENT, SLIDE = JointUnits("A"), JointUnits(is_prismatic=True)
NUMBERS = {
    "torque_constant": Quantity(0.5, 0.01, "N m/A"),
    "p_value": Quantity(0.001),
    "least": Quantity(0.2),
    "inverse": Quantity(2.0, 0.9, "A/(N m)"),
    "angle": Quantity(0.1, 0.001, "rad"),
    "back_emf": Quantity(0.3, unit="V s/rad"),
    "count": Quantity(12),
    "depth": Quantity(0.002, unit="rad"),
    "error": Quantity(0.05, unit="rad"),
    "delay": Quantity(0.0099, 4e-5, "s"),
    "factor": Quantity(2.0),
    "gain": Quantity(-3.0, unit="N m/rad"),
    "high": Quantity(1.2, unit="rad"),
    "inertia": Quantity(0.01, unit="kg m^2"),
    "before": Quantity(0.02, unit="kg m^2"),
    "loads": Quantity(2),
    "mass": Quantity(2.4, 0.01, "kg"),
    "number": Quantity(3),
    "rate": Quantity(50.0, unit="Hz"),
    "residual": Quantity(11.0),
    "disagreement": Quantity(8.5),
    "period": Quantity(2.0, unit="ms"),
    "share": Quantity(0.95),
    "std": Quantity(0.2, unit="ms"),
    "time": Quantity(17.7, unit="s"),
    "times": Quantity(5.0),
    "hidden": Quantity(0.03, unit="N m"),
    "torque": Quantity(0.1, unit="N m"),
    "viscous": Quantity(1.12, 0.01, "N m s/rad"),
    "others.viscous": Quantity(1.0, unit="N m s/rad"),
}
ABOUT = {"parameters": ("viscous",), "effects": ("spring", "gravity"), "recordings": ("run 2", "run 0", "run 1"),
         "joints": ("elbow",)}  # fmt: skip
PAIR = (("spring", "gravity"),)


@pytest.mark.parametrize("kind", DESCRIBED)
def test_each_kind_has_whole_sentences(kind):
    text = describe(Finding(kind, NUMBERS, pairs=PAIR, **ABOUT))
    assert text.endswith((".", ")")) and text[0].isupper() | text.startswith(("run", "viscous", "spring"))
    assert "nan" not in text
    assert all(len(sentence.split()) <= 27 for sentence in re.split(r"(?<=[A-Za-z)`])[.:;] ", text))


def test_every_kind_is_described():
    assert set(DESCRIBED) == set(Kind) - set(REASONS)


def test_an_effect_is_confused_with_those_that_name_it():
    assert "temperature_dependent_friction" not in find_description("friction_drift").resembles
    assert find_look_alikes("friction_drift")[-1] == "temperature_dependent_friction"


def test_texts_are_of_terms_that_exist_and_show_every_symptom():
    assert list_nameable().keys() | TABLES.keys() <= EFFECTS.keys() | {PowerOfSpeed.id}
    assert {find_description(kind.id).symptom for kind in BUILT_IN} == set(get_args(Symptom))
    assert all(kind.id not in {*find_description(kind.id).resembles} <= EFFECTS.keys() for kind in BUILT_IN)


def test_a_user_s_effect_has_a_title_from_its_id_or_its_own_description():
    class Wobble(Term):
        id = "slow_wobble"

    class Seal(Term):
        id = "seal"
        description = Description(title="a seal that rubs", informative_experiment="slow motion")

    assert name_effect("slow_wobble@elbow") == "slow wobble at elbow" and find_description(Wobble.id) == Description()
    assert (
        name_effect(Seal.id) == "a seal that rubs"
        and find_description("seal@elbow").informative_experiment == "slow motion"
    )


def limits(gate: str, value: float, limit: float, unit: str = "") -> Finding:
    """A gate that was not passed."""
    numbers = {gate: Quantity(value, unit=unit), f"limit.{gate}": Quantity(limit, unit=unit)}
    return Finding(Kind.GATE_FAILED, numbers, (gate,))


def outlier(share: float) -> Finding:
    return Finding(Kind.OUTLIER_RECORDING, NUMBERS | {"viscous": Quantity(1 + share, 0.01, "N m s/rad")}, **ABOUT)


FALL = {f"{kind}.{end}": Quantity(size, unit=unit) for kind, unit in (("torque_rms", "A"), ("position_rms", "rad"))
        for end, size in (("before", 0.2), ("after", 0.1))}  # fmt: skip
SAID = [  # numbers as they are shown: their unit, sign and digits
    (describe, Finding(Kind.ACTS_LATE, {"delay": Quantity(0.01196, 2e-5, "s")}), r"11\.96 ± 0\.02 ms after"),
    (describe, outlier(0.12), r"Recording 3 \(run 2\).*viscous 12 % higher"),
    (describe, Finding(Kind.ZERO_SHIFTED, {"angle": Quantity(0.0524, 0.0018, "rad")}), r"3\.0 ± 0\.1 degrees"),
    (describe, Finding(Kind.BEYOND_LIMITS, {"torque": Quantity(6.0, unit="A")}, pairs=PAIR), "within 6 A .*--max-t"),
    (describe, Finding(Kind.UNIDENTIFIABLE, {"gravity": Quantity(2.0, 3.0, "A")}, ("gravity",)), r"2\.0 ± 3\.0 A"),
    (describe_region, Region("position", -1.0, 0.5, -0.2, 12.0, "rad", units=CURRENT), "0.5 rad .*0.2 A less torque"),
    (describe_region, Region("velocity", -1.0, 0.5, 0.2, 900.0, "m/s", units=SLIDE), "m/s .*0.2 N more force.* 100 "),
    (describe_region, Region("frequency", 2.9, 3.1, 0.2, 9.0, "Hz", units=CURRENT), r"Around 3 Hz .* by 0\.2 A"),
    (describe, limits("holdout_torque", 0.2, 0.1, "A"), r"0\.1 -> 0\.2 A"),
    (describe, limits("explained_share", 0.1, Criterion.explained_share), r"10 % of the residual .* 20 %"),
    (describe, limits("share_above_floor", 0.3, Criterion.needed_share), r"30 % of the torque above .* 50 %"),
    (describe_detectable, Detectable("stribeck", 0.05, "A"), r"above 0\.05 A"),
    (
        partial(describe_suggestion, units=CURRENT),
        Suggestion(excitation("paper", 0, 9), 20.0, (Aim("spring", "gravity"),), 1.2, (-1.0, 1.0), 3.0),
        r"To tell spring from gravity: record 20 s of.* up to 1\.2 A",
    ),
]  # fmt: skip


IN_DEGREES = [  # positions and speeds of the joint; frequencies and what has torque in it stay in SI
    (describe, Finding(Kind.NEAR_REVERSALS, {"error": Quantity(0.05, unit="rad")}), r"2\.9 deg"),
    (describe, Finding(Kind.UNIDENTIFIABLE, {"gap": Quantity(0.02, 0.01, "rad")}, ("gap",)), r"1\.15 ± 0\.57 deg"),
    (describe, Finding(Kind.UNIDENTIFIABLE, {"f": Quantity(6.0, 1.0, "rad/s")}, ("f",)), r"6\.0 ± 1\.0 rad/s"),
    (describe, Finding(Kind.BEYOND_LIMITS, {"speed": Quantity(2.0, unit="rad/s")}, pairs=PAIR), "within 115 deg/s"),
    (describe, Finding(Kind.FEEDBACK, {"gain": Quantity(-3.0, unit="N m/rad")}), "-3 N m/rad"),
    (describe, outlier(2.0), r"3 ?(N m s/rad)? instead of 1 N m s/rad"),
    (describe_region, Region("position", -1.0, 0.5, -0.2, 12.0, "rad"), r"-57\.3 to 28\.6 deg .*0\.2 N m less"),
    (describe_region, Region("velocity", -1.0, 0.5, 0.2, 12.0, "m/s", units=SLIDE), "-1 to 0.5 m/s"),
    (describe, Finding(Kind.ERRORS_FALL, FALL), r"0\.2 -> 0\.1 A, .*11\.5 -> 5\.73 deg"),
    (describe_detectable, Detectable("hard_stop", between=(-1.2, 0.9)), r"-68\.8 to 51\.6 deg"),
]


@pytest.mark.parametrize(("narrate", "what", "said"), IN_DEGREES)
def test_angles_are_told_in_degrees_if_asked_for(narrate, what, said):
    with show_angles("deg"):
        told = narrate(what)
    assert re.search(said, told)
    assert "deg" not in narrate(what)


@pytest.mark.parametrize(("narrate", "what", "said"), SAID)
def test_numbers_are_told_in_the_unit_of_the_recordings(narrate, what, said):
    assert re.search(said, narrate(what))


def test_the_gate_of_a_gain_tells_its_error_its_penalty_and_its_significance():
    numbers = {"gain": Quantity(3.0, 2.0), "limit.gain": Quantity(5.0)}
    numbers |= {"p_value": Quantity(0.2), "limit.p_value": Quantity(1e-3)}
    text = describe(Finding(Kind.GATE_FAILED, numbers, ("gain", "p_value")))
    assert re.search(r"3 ± 2 nat .*p = 0\.2 .*5 nat, limit 0\.001", text)
