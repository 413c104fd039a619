"""Reasons for the rejection of an effect, in words, from the gates that it met."""

from collections.abc import Sequence

from estimators.selection.gates import Gate
from pendulum_env.words import listing

FALLS = "({gate.limit:.3g} -> {gate.value:.3g} {gate.unit})"
REJECTIONS = {  # by the name of the first gate that failed
    "residual_over_noise": "not tried: the residual is {gate.value:.2g} times the noise floor, which counts as noise",
    "earlier_effects": "not tried: a transmission is tried only as the first effect",
    "transmissions": "not tried: the model has a transmission already",
    "variants": "not tried: these data offer no variant of it",
    "explained_share": "explains {gate.value:.0%} of the residual, less than {gate.limit:.0%}",
    "gravity_sign": "fits only with negative gravity: both terms cancel and imitate a third law",
    "holdout_in_loop": f"does not lower the held-out error in the loop {FALLS}",
    "holdout_position": f"does not lower the held-out error of free-running simulation {FALLS}",
    "holdout_torque": f"does not lower the held-out torque error {FALLS}",
}
VIOLATIONS = {  # of physical bounds; others are parameters outside their bounds
    "negative_inertia": "negative inertia",
    "driving_friction": "friction that drives",
    "dry_friction": "dry friction of {gate.value:.2g} N m, more than the {gate.limit:.2g} N m that moved the joint",
}


def describe_rejection(gates: Sequence[Gate], compared: str = "the base model") -> str | None:
    """Return the reason of the first gate that failed; None if all gates were passed.

    Args:
        gates: met by an effect, in order.
        compared: model to which the effect was added.
    """
    failed = [gate for gate in gates if not gate.passed]
    if not failed:
        return None
    name, _, at = failed[0].name.partition("@")
    if name in ("gain", "p_value"):
        gain, p_value = (next(gate for gate in gates if gate.name == own) for own in ("gain", "p_value"))
        limits = f"p = {p_value.value:.2g} with a penalty of {gain.limit:.2g} nat, limit {p_value.limit:.2g}"
        std = "" if gain.std is None else f" ± {gain.std:.2g}"
        return f"gain of {gain.value:.3g}{std} nat over {compared}: {limits}"
    if name in REJECTIONS:
        return REJECTIONS[name].format(gate=failed[0]) + (f" at {at}" if at else "")
    return f"would mean {listing(describe_violations(failed))}, which no body has"


def describe_violations(gates: Sequence[Gate]) -> list[str]:
    """Return phrases such as "negative inertia" for the gates of violated physical bounds."""
    found = []
    for gate in gates:
        end = ", the most that it may be" if gate.value == gate.limit else ""
        parameter = f"{gate.name} = {gate.value:.3g} {gate.unit}{end}"
        found.append(VIOLATIONS.get(gate.name, parameter).format(gate=gate))
    return found
