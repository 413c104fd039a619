"""Texts of findings and results on arms; the import registers those of results."""

from dataclasses import replace

from estimators.texts import FindingTexts
from pendulum_env.formatting import join_words, measure, measure_change
from pendulum_env.notebook import summarise
from pendulum_env.settings import format_setting
from robots.arms.carried_payload import CarriedPayload
from robots.arms.conclusion import MissingRotors
from robots.arms.standard import Nearest


def _describe_payload(finding: CarriedPayload) -> str:
    axes = [f"{axis} = {measure(size)}" for axis, size in finding.center.items()]
    center = f" Its centre is at {', '.join(axes)} in the frame of that joint." if axes else ""
    errors = [f"{at} {measure_change(change.before, change.after)}" for at, change in finding.torque_rms.items()]
    explained = f" Torque error there without and with it: {', '.join(errors)}." if errors else ""
    return (
        f"The arm carries a payload of {measure(finding.mass)} in {join_words(finding.recordings)}, at the "
        f"link behind {finding.joint}.{center}{explained}"
    )


@summarise.register
def describe_nearest_body(nearest: Nearest) -> str:
    """State whether a physical body can have the identified parameters."""
    if nearest.exists:
        return f"a body can have these parameters, within {max(nearest.distance, 0.1):.1f} standard errors"
    off = f"{nearest.distance:.1f} standard errors off"
    return f"no body has these parameters: the nearest is {off}, in {nearest.farthest}"


TEXTS = FindingTexts(
    {
        CarriedPayload: _describe_payload,
        MissingRotors: lambda finding: (
            f"The robot file lacks the inertia of the motors at {join_words(finding.joints)}. Fit all rotors: "
            f"{format_setting('rotors', True)}."
        ),
    },
    causes={
        CarriedPayload: lambda finding: (
            f"a payload of {measure(replace(finding.mass, std=0.0))} in {join_words(finding.recordings)}"
        ),
    },
)
