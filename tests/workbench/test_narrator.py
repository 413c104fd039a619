"""Sentences: each kind of finding has one, of short sentences, in the unit that is shown."""

import re

import pytest

from estimators.diagnosis.result import Detectable
from estimators.diagnosis.suggestion import Aim, Suggestion
from estimators.findings import Finding, Kind, Quantity
from estimators.signals.residual import Region, everywhere
from pendulum_env.excitation import excitation
from pendulum_env.physics import effects
from workbench.narrator.diagnosis import describe_detectable, describe_region, describe_suggestion
from workbench.narrator.findings import DESCRIBED, describe
from workbench.narrator.reasons import REASONS, describe_objection

CONSTANT = {"torque_constant": Quantity(0.5, 0.01, "N m/A"), "inverse": Quantity(2.0, 0.9, "A/(N m)")}
NUMBERS = CONSTANT | {
    "angle": Quantity(0.1, 0.001, "rad"),
    "back_emf": Quantity(0.3, unit="V s/rad"),
    "count": Quantity(12),
    "error": Quantity(0.05, unit="rad"),
    "delay": Quantity(0.0099, 4e-5, "s"),
    "factor": Quantity(2.0),
    "gain": Quantity(-3.0, unit="N m/rad"),
    "inertia": Quantity(0.01, unit="kg m^2"),
    "loads": Quantity(2),
    "number": Quantity(3),
    "rate": Quantity(50.0, unit="Hz"),
    "residual": Quantity(11.0),
    "disagreement": Quantity(8.5),
    "share": Quantity(0.95),
    "times": Quantity(5.0),
    "torque": Quantity(0.1, unit="N m"),
    "viscous": Quantity(1.12, 0.01, "N m s/rad"),
    "others.viscous": Quantity(1.0, unit="N m s/rad"),
}
ABOUT = {"parameters": ("viscous",), "effects": ("spring", "gravity"), "recordings": ("run 2", "run 0", "run 1")}


@pytest.mark.parametrize("kind", DESCRIBED)
def test_each_kind_has_whole_sentences_with_no_torque_in_newton_metres_where_a_current_is_shown(kind):
    text = describe(Finding(kind, NUMBERS, pairs=(("spring", "gravity"),), **ABOUT), "A")
    assert text.endswith((".", ")")) and text[0].isupper() | text.startswith(("run", "viscous", "spring"))
    assert "nan" not in text and not re.search(r"N m(?!/A|\))", text)
    assert all(len(sentence.split()) <= 40 for sentence in re.split(r"[.:;] ", text))


def test_every_kind_is_described():
    assert set(DESCRIBED) == set(Kind) - REASONS - {Kind.UNTESTED_RANGE}


@pytest.mark.parametrize(
    ("finding", "text"),
    [
        (
            Finding(Kind.INCOMPLETE, NUMBERS, ("coulomb",)),
            "The model is incomplete: the residual is 11 times the noise floor, and the schemes disagree on coulomb by "
            "8.5 standard errors.",
        ),
        (
            Finding(Kind.ACTS_LATE, {"delay": Quantity(0.01196, 2e-5, "s")}),
            "The torque acts 11.96 ± 0.02 ms after its time stamp. Possible causes: the drive (dead_time, actuator_lag"
            "), early time stamps, or a flexible joint. Log current or torque at the motor to distinguish them.",
        ),
        (
            Finding(Kind.OUTLIER_RECORDING, NUMBERS, ("viscous",), recordings=("run 2", "run 0", "run 1")),
            "Recording 3 (run 2) disagrees with the others: viscous 12 % higher.",
        ),
        (
            Finding(
                Kind.ZERO_SHIFTED, {"angle": Quantity(0.0524, 0.0018, "rad")}, remedies={"--columns q=a": ("run",)}
            ),
            "The zero of the position is 3.0 ± 0.1 degrees off, or the base is tilted by that angle (gravity_tilt). "
            "Read it with --columns q=a instead.",
        ),
        (
            Finding(Kind.BEYOND_LIMITS, {"torque": Quantity(6.0, unit="N m")}, pairs=(("spring", "gravity"),)),
            "No experiment within 6 A and the recorded angles and speeds would tell spring from gravity: allow more "
            "(--max-angle, --max-speed, --max-torque) if the rig bears it.",
        ),
        (
            Finding(Kind.UNIDENTIFIABLE, {"gravity": Quantity(2.0, 3.0, "N m")}, ("gravity",)),
            "The data do not determine gravity: the best fit is 2.0 ± 3.0 A. Record swings beyond 30 degrees, at more "
            "frequencies.",
        ),
    ],
)
def test_a_finding_in_words(finding, text):
    assert describe(finding, "A") == text


@pytest.mark.parametrize(
    ("region", "text"),
    [
        (
            Region("position", -1.0, 0.5, -0.2, 12.0, "rad"),
            "For q from -1 to 0.5 rad the joint needs 0.2 A less torque than the model says (12 standard errors).",
        ),
        (
            Region("velocity", -1.0, 0.5, 0.2, 900.0, "rad/s", slides=True),
            "For q' from -1 to 0.5 m/s the joint needs 0.2 N more force than the model says (more than 100 standard "
            "errors).",
        ),
        (
            Region("time", 0.0, 9.0, 0.2, 20.0, held_out=("run 4",)),
            "In the held-out data (run 4): everywhere the joint needs 0.2 A more torque than the model says (20 "
            "standard errors).",
        ),
        (
            Region("frequency", 2.9, 3.1, 0.2, 9.0, "Hz"),
            "Around 3 Hz the residual oscillates by 0.2 A (9 standard errors).",
        ),
        (everywhere(at="elbow"), ""),
    ],
)
def test_a_region_in_words(region, text):
    assert describe_region(region, "A") == text


GATES = {
    "gain": Quantity(3.0, 2.0),
    "limit.gain": Quantity(5.0),
    "p_value": Quantity(0.2),
    "limit.p_value": Quantity(1e-3),
}


@pytest.mark.parametrize(
    ("finding", "text"),
    [
        (
            Finding(Kind.GATE_FAILED, GATES, ("gain", "p_value")),
            "gain of 3 ± 2 nat over the base model: p = 0.2 with a penalty of 5 nat, limit 0.001",
        ),
        (
            Finding(
                Kind.GATE_FAILED,
                {"holdout_torque": Quantity(0.2, unit="N m"), "limit.holdout_torque": Quantity(0.1, unit="N m")},
                ("holdout_torque",),
            ),
            "does not lower the held-out torque error (0.1 -> 0.2 A)",
        ),
        (
            Finding(
                Kind.GATE_FAILED,
                {"negative_inertia": Quantity(-0.1), "limit.negative_inertia": Quantity(0.0)},
                ("negative_inertia",),
            ),
            "would mean a negative inertia, which no body has",
        ),
        (
            Finding(Kind.GATE_FAILED, {"variants": Quantity(0), "limit.variants": Quantity(0)}, ("variants",)),
            "not tried: these data offer no variant of it",
        ),
        (
            Finding(
                Kind.ERRORS_FALL,
                {
                    "torque_rms.before": Quantity(0.2, unit="N m"),
                    "torque_rms.after": Quantity(0.1, unit="N m"),
                    "position_rms.before": Quantity(0.02, unit="rad"),
                    "position_rms.after": Quantity(0.01, unit="rad"),
                },
            ),
            "lowers the held-out errors: torque 0.2 -> 0.1 A, free-running position 0.02 -> 0.01 rad",
        ),
        (Finding(Kind.TIES, effects=("spring",)), "predicts as well as spring, or nearly"),
        (Finding(Kind.OTHERS_BETTER), "others explain it better"),
        (Finding(Kind.BY_CHANCE), "lowers the held-out errors by no more than chance would"),
    ],
)
def test_a_reason_in_words(finding, text):
    assert describe_objection(finding, "A") == text


def test_untested_motion_of_a_term():
    stop = effects()["hard_stop"](lower=-0.9)
    ends = {"low": Quantity(-1.0), "high": Quantity(1.2)}
    assert "1.2 rad" in describe(Finding(Kind.UNTESTED_RANGE, ends, effects=("hard_stop",)), terms=[stop])


def test_sizes_that_would_have_shown():
    assert describe_detectable(Detectable("stribeck", 0.05, "N m"), "A") == "above 0.05 A"
    assert describe_detectable(Detectable("hard_stop", between=(-1.2, 0.9))) == "between -1.2 and 0.9 rad"


def test_a_suggestion_in_the_unit_of_the_recordings():
    found = Suggestion(excitation("paper", 0, 9), 20.0, (Aim("spring", "gravity"),), 1.2, (-1.0, 1.0), 3.0)
    assert describe_suggestion(found, "A").startswith("To tell spring from gravity: record 20 s of")
    assert "up to 1.2 A" in describe_suggestion(found, "A")
