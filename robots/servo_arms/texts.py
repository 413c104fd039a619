"""Texts of findings on arms of servos."""

from estimators.texts import FindingTexts
from pendulum_env.formatting import join_words
from robots.servo_arms.joining import AtJoint


def _describe_at_joint(finding: AtJoint) -> str:
    return f"Joint{'s' if len(finding.joints) > 1 else ''} {join_words(finding.joints)}: {finding.finding}"


TEXTS = FindingTexts({AtJoint: _describe_at_joint})
