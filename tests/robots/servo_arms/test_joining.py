"""Findings on the joints of an arm of servos are one finding on several joints if they are equal."""

from estimators.findings import Quantity
from robots.servo_arms.joining import AtJoint, join_findings
from robots.servos.conclusion import ScaledTorque, UnknownSpeedRate


def test_equal_findings_of_joints_are_one_finding():
    scaled, rate = ScaledTorque(2.0), UnknownSpeedRate(Quantity(50.0, unit="Hz"), Quantity(0.01, unit="kg m^2"))
    joined = join_findings({"shoulder": (scaled,), "elbow": (rate, ScaledTorque(2.0)), "wrist": (ScaledTorque(3.0),)})
    assert joined == (
        AtJoint(("shoulder", "elbow"), scaled),
        AtJoint(("elbow",), rate),
        AtJoint(("wrist",), ScaledTorque(3.0)),
    )
