"""Texts of findings on arms of servos."""

from estimators.texts import FindingTexts
from robots.servo_arms.joining import AtJoint

TEXTS = FindingTexts({AtJoint: lambda finding: f"Joint {finding.joint}: {finding.finding}"})
