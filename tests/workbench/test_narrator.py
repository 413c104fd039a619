"""Sentences: each kind of finding has one, of short sentences, with its numbers in the unit that is shown."""

import dataclasses
import json
import re
from typing import get_args

import pytest

from estimators.checks.alignment import TorqueTiming
from estimators.checks.closed_loop import Feedback
from estimators.checks.homogeneity import Difference, Disagreement
from estimators.checks.remedies import Remedy, UnevenClock, WrongColumn
from estimators.checks.signs import NegativeParameters
from estimators.checks.torque_constant import BackEmfInFriction, GearLosses, UnknownConstant
from estimators.data.calibration import RelativeToInertia
from estimators.data.regions import ResidualWithoutPlace
from estimators.data.standard_errors import StiffStop
from estimators.data.treatment import Action, Treatment
from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import ErrorFall
from estimators.decisions.gate import FailedGates, Gate
from estimators.diagnosis.caveats import FewWindows, PartOfTurn, UnknownScale
from estimators.diagnosis.completeness import Incomplete
from estimators.diagnosis.conclusion import NoKnownEffect, UnknownInertia
from estimators.diagnosis.contacts import Contact
from estimators.diagnosis.experiment import UnreachableAims
from estimators.diagnosis.ranking import Imitation, Tie
from estimators.diagnosis.result import Detectable
from estimators.diagnosis.small_effect import SmallEffect
from estimators.diagnosis.suggestion import Aim, Suggestion
from estimators.diagnosis.unexplained import ErrorNearReversals, HeldOutResidual
from estimators.diagnosis.untested import UntestedRange
from estimators.findings import Change, Finding, Quantity
from estimators.identification import CoarseEncoder, SlowedFilter
from estimators.schemes.identifiability import Gap, Undetermined
from estimators.selection.process_noise import UnloggedTorque
from estimators.selection.tables import ExplainingTable
from estimators.signals.residual import Region
from pendulum_env.excitation import excitation
from pendulum_env.physics import Description, Term, list_nameable
from pendulum_env.physics.description import Symptom
from pendulum_env.physics.effect_texts import EFFECTS, find_description, find_look_alikes, name_effect
from pendulum_env.physics.library import BUILT_IN
from pendulum_env.physics.table import TABLES, PowerOfSpeed
from pendulum_env.units import JointUnits, show_angles
from robots.arms.carried_payload import CarriedPayload
from robots.arms.conclusion import MissingRotors
from robots.servo_arms.joining import AtJoint
from robots.servos.conclusion import DoubtfulDrive, ResultOfLongSteps, ScaledTorque, UnknownSpeedRate
from robots.servos.in_loop.conventions import ControllerConvention, GoalConvention, UnseenCounts
from robots.servos.rest import RestBand
from workbench.narrator.diagnosis import describe_detectable, describe_region, describe_suggestion
from workbench.narrator.findings import describe

CURRENT, SLIDE = JointUnits("A"), JointUnits(is_prismatic=True)
TORQUE, ANGLE, NAMES = Quantity(0.1, unit="N m"), Quantity(0.1, 0.001, "rad"), ("run 0", "run 1")
EXAMPLES = (  # of every family, in the forms that have texts of their own
    *(Undetermined(gap, ("viscous",), Quantity(0.1, 0.2, "N m")) for gap in Gap),
    Undetermined(Gap.LARGE_ERROR, ("viscous",)),
    Undetermined(Gap.ACT_ALIKE, ("gap", "gravity"), combination={"gap": 1.0, "gravity": -0.6}),
    RelativeToInertia(NAMES),
    UnknownConstant("A", constant=Quantity(-0.5, 0.01, "N m/A"), by_load_torque=True),
    UnknownConstant("A", inverse=Quantity(2.0, 0.9, "A/(N m)")),
    UnknownConstant("A", has_integral=True),
    *(UnknownConstant("V", loads, moved) for loads, moved in ((0, 0), (1, 0), (2, 0), (2, 1))),
    *(GearLosses(Quantity(0.5, 0.01, "N m/A"), 0.95, is_braked) for is_braked in (False, True)),
    BackEmfInFriction(Quantity(0.3, unit="V s/rad")),
    *(TorqueTiming(is_late, Quantity(0.0099, 4e-5, "s"), rival_lag=Quantity(0.01, unit="s")) for is_late in (0, 1)),
    TorqueTiming(is_late=True, is_sampled=True, is_corrected=True, recordings=NAMES),
    *(Treatment(action, {"share": Quantity(0.5), "inertia": TORQUE, "before": TORQUE}, ("spring",), NAMES)
      for action in Action),
    CarriedPayload("elbow", Quantity(2.4, 0.01, "kg"), {"z": Quantity(0.1, unit="m")},
                   {"elbow": Change(TORQUE, TORQUE)}, NAMES),
    *(GoalConvention(is_held, gain, {"dead_time": Quantity(0.01, unit="s")})
      for is_held, gain in ((True, Quantity(3.0, 1.0)), (False, None))),
    *(ControllerConvention(settings, Quantity(3.0, 5.0)) for settings in ({"reads": "exact"}, {"windup": "stop"})),
    UnseenCounts(),
    Feedback(Quantity(-3.0, unit="N m/rad"), NAMES),
    Disagreement(3, "run 2", NAMES, (Difference("viscous", "N m s/rad", 1.12, 1.0, 0.01),)),
    Disagreement(3, "run 2", (), is_turned=True),
    Disagreement(3, "run 2", NAMES, torque_factor=2.0),
    Disagreement(3, "run 2", NAMES, inertia_factor=2.0),
    Disagreement(3, "run 2", NAMES[:1], residual=TORQUE, noise_ratio=5.0),
    UnevenClock("run 2", Quantity(0.2, unit="ms"), Quantity(2.0, unit="ms")),
    WrongColumn("load_torque", (Remedy({"load_torque": "-load"}, ("run 0",)),)),
    WrongColumn("torque", inertia=Quantity(-0.1, 0.01, "kg m^2")),
    WrongColumn("position", angle=ANGLE),
    WrongColumn("position"),
    NegativeParameters(("gravity", "spring.stiffness")),
    NegativeParameters(("viscous",)),
    StiffStop("hard_stop", ("hard_stop.stiffness",), ANGLE, ANGLE),
    SlowedFilter(Quantity(50.0, unit="Hz")),
    CoarseEncoder(),
    Incomplete(11.0, 8.5, ("viscous",), ("elbow",)),
    UnloggedTorque(TORQUE, TORQUE),
    DoubtfulDrive(),
    UnknownSpeedRate(Quantity(50.0, unit="Hz"), Quantity(0.01, unit="kg m^2")),
    ScaledTorque(2.0),
    FewWindows(12),
    PartOfTurn(ANGLE, ("spring",)),
    UnknownScale(0.95),
    SmallEffect("spring", 0.1, 0.2, 0.001),
    MissingRotors(("elbow",)),
    *(UntestedRange("hard_stop", low, high) for low, high in ((None, ANGLE), (ANGLE, None), (ANGLE, ANGLE))),
    Tie(("spring", "gravity")),
    ErrorNearReversals(ANGLE),
    ResidualWithoutPlace(TORQUE, 5.0, None, "run 0"),
    ResidualWithoutPlace(TORQUE, 5.0),
    AtJoint(("elbow", "wrist"), RestBand(ANGLE, ANGLE, ANGLE, 16.0, 4.5)),
    RestBand(ANGLE, ANGLE, ANGLE, 16.0, 4.5),
    HeldOutResidual(NAMES),
    Contact("elbow", 12, TORQUE, ANGLE, Quantity(17.7, unit="s"), "run 0"),
    ExplainingTable("friction_by_speed", {}),
    NoKnownEffect(),
    NoKnownEffect(("torque_by_angle", "friction_by_speed")),
    UnknownInertia(),
    UnreachableAims((Aim("stribeck"),), {"torque": TORQUE}),
    UnreachableAims((Aim("torque_offset", "coulomb_asymmetry"),)),
)  # fmt: skip
PHRASES = (
    ErrorFall({"torque_rms": Change(TORQUE, TORQUE)}),
    ErrorFall(joint="elbow", ratio=0.5),
    Imitation("spring"),
    Imitation(),
    ResultOfLongSteps(),
    FailedGates((Gate("explained_share", 0.1, 0.2, False),)),
)


@pytest.mark.parametrize("finding", EXAMPLES)
def test_each_finding_has_whole_sentences(finding):
    text = describe(finding)
    assert text.endswith((".", ")")) and text[0].isupper() | text.startswith(("run", "viscous", "spring", "gap"))
    assert not re.search(r"\bnan\b|None|[{}]", text)
    assert all(len(sentence.split()) <= 27 for sentence in re.split(r"(?<=[A-Za-z)`])[.:;] ", text))


@pytest.mark.parametrize("finding", PHRASES)
def test_each_reason_is_a_phrase(finding):
    text = describe(finding)
    assert not text.endswith(".") and text[0].islower() and "None" not in text


def test_every_family_has_an_example_and_a_record_for_json():
    """A new family of findings needs a template in `SENTENCES` or `REASONS`, and an example here."""
    missing = {*Finding.__subclasses__()} - {type(finding) for finding in (*EXAMPLES, *PHRASES)}
    assert not missing, f"add an example of {missing} here, and its text to SENTENCES or REASONS of the narrator"
    for finding in (*EXAMPLES, *PHRASES):
        record = json.loads(json.dumps(finding.json(), allow_nan=False))
        assert {*record} == {"family", "withheld", *(field.name for field in dataclasses.fields(finding))}


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


def limits(gate: str, value: float, limit: float, unit: str = "1") -> Finding:
    """A gate that was not passed."""
    return FailedGates((Gate(gate, value, limit, False, unit),))


def outlier(share: float) -> Finding:
    return Disagreement(3, "run 2", NAMES, (Difference("viscous", "N m s/rad", 1 + share, 1.0, 0.01),))


FALL = {kind: Change(Quantity(0.2, unit=unit), Quantity(0.1, unit=unit)) for kind, unit in
        (("torque_rms", "A"), ("position_rms", "rad"))}  # fmt: skip
AIM = (Aim("spring", "gravity"),)
SAID = [  # numbers as they are shown: their unit, sign and digits
    (describe, TorqueTiming(False, Quantity(0.01196, 2e-5, "s")), r"11\.96 ± 0\.02 ms after"),
    (describe, outlier(0.12), r"Recording 3 \(run 2\).*viscous 12 % higher"),
    (describe, WrongColumn("position", angle=Quantity(0.0524, 0.0018, "rad")), r"3\.0 ± 0\.1 degrees"),
    (describe, UnreachableAims(AIM, {"torque": Quantity(6.0, unit="A")}), "within 6 A .*max.torque.VALUE"),
    (describe, Undetermined(Gap.LARGE_ERROR, ("gravity",), Quantity(2.0, 3.0, "A")), r"2\.0 ± 3\.0 A"),
    (describe_region, Region("position", -1.0, 0.5, -0.2, 12.0, "rad", units=CURRENT), "0.5 rad .*0.2 A less torque"),
    (describe_region, Region("velocity", -1.0, 0.5, 0.2, 900.0, "m/s", units=SLIDE), "m/s .*0.2 N more force.* 100 "),
    (describe_region, Region("frequency", 2.9, 3.1, 0.2, 9.0, "Hz", units=CURRENT), r"Around 3 Hz .* by 0\.2 A"),
    (describe, limits("holdout_torque", 0.2, 0.1, "A"), r"0\.1 -> 0\.2 A"),
    (describe, limits("explained_share", 0.1, Criterion.explained_share), r"10 % of the residual .* 20 %"),
    (describe, limits("share_above_floor", 0.3, Criterion.needed_share), r"30 % of the torque above .* 50 %"),
    (describe_detectable, Detectable("stribeck", 0.05, "A"), r"above 0\.05 A"),
    (
        describe_suggestion,
        Suggestion(excitation("paper", 0, 9), 20.0, (Aim("spring", "gravity"),), 1.2, (-1.0, 1.0), 3.0, units=CURRENT),
        r"To tell a spring from gravity: record 20 s of.* up to 1\.2 A",
    ),
]  # fmt: skip


IN_DEGREES = [  # positions and speeds of the joint; frequencies and what has torque in it stay in SI
    (describe, ErrorNearReversals(Quantity(0.05, unit="rad")), r"2\.9 deg"),
    (describe, Undetermined(Gap.LARGE_ERROR, ("gap",), Quantity(0.02, 0.01, "rad")), r"1\.15 ± 0\.57 deg"),
    (describe, Undetermined(Gap.LARGE_ERROR, ("f",), Quantity(6.0, 1.0, "rad/s")), r"6\.0 ± 1\.0 rad/s"),
    (describe, UnreachableAims(AIM, {"speed": Quantity(2.0, unit="rad/s")}), "within 115 deg/s"),
    (describe, Feedback(Quantity(-3.0, unit="N m/rad"), ()), "-3 N m/rad"),
    (describe, outlier(2.0), r"3 ?(N m s/rad)? instead of 1 N m s/rad"),
    (describe_region, Region("position", -1.0, 0.5, -0.2, 12.0, "rad"), r"-57\.3 to 28\.6 deg .*0\.2 N m less"),
    (describe_region, Region("velocity", -1.0, 0.5, 0.2, 12.0, "m/s", units=SLIDE), "-1 to 0.5 m/s"),
    (describe, ErrorFall(FALL), r"0\.2 -> 0\.1 A, .*11\.5 -> 5\.73 deg"),
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
    gates = Gate("gain", 3.0, 5.0, False, "nat", 2.0), Gate("p_value", 0.2, 1e-3, False)
    text = describe(FailedGates(gates))
    assert re.search(r"3 ± 2 nat .*p = 0\.2 .*5 nat, limit 0\.001", text)
