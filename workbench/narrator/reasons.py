"""Reasons for verdicts in words: phrases whose subject is the effect."""

from collections.abc import Mapping

from estimators.diagnosis.result import Candidate
from estimators.findings import Finding, Kind, Quantity
from pendulum_env.formatting import format_p_value, join_words
from workbench.narrator.effects import find_description
from workbench.narrator.findings import describe_law, describe_untested, describe_violations, measure_change

REASONS = {
    Kind.ERRORS_FALL,
    Kind.ERROR_FALLS_AT_JOINT,
    Kind.TIES,
    Kind.IMITATES,
    Kind.IMITATES_TABLE,
    Kind.NOT_TESTED,
    Kind.NOT_EXCITED,
    Kind.GATE_FAILED,
    Kind.OTHERS_BETTER,
    Kind.LONG_STEPS,
    Kind.BY_CHANCE,
}
NOT_TRIED = {
    "earlier_effects": "not tried: a transmission is tried only as the first effect",
    "transmissions": "not tried: the model has a transmission already",
    "variants": "not tried: these data offer no variant of it",
}
HELD_OUT = {
    "holdout_in_loop": "error in the loop",
    "holdout_position": "error of free-running simulation",
    "holdout_torque": "torque error",
}
ERRORS = {"in_loop": "in the loop", "torque_rms": "torque", "position_rms": "position"}
FLOOR_SOURCES = {"in_loop": "the resolution of the encoder", "torque_rms": "the scatter between samples"}
FALLS = ERRORS | {"position_rms": "free-running position"}


def describe_reason(candidate: Candidate) -> str:
    """Return the reason for the verdict on a candidate, as a phrase."""
    found = candidate.reason
    if found.kind not in (Kind.NOT_TESTED, Kind.NOT_EXCITED):
        return describe_objection(found)
    needed = find_description(candidate.effect).informative_experiment
    text = "these data do not depend on it" if found.kind is Kind.NOT_EXCITED else describe_untested(found)
    return f"{text}; it needs {needed}" if needed else text


def describe_objection(found: Finding) -> str:
    """Return what speaks for or against an effect, as a phrase."""
    match found.kind:
        case Kind.ERRORS_FALL:
            return f"lowers the held-out {_describe_fall(found.numbers)}"
        case Kind.ERROR_FALLS_AT_JOINT:
            joints, share = join_words(found.joints), found.numbers["share"].value
            return f"lowers the held-out torque error of {joints} to {share:.1%}"
        case Kind.TIES:
            return f"predicts as well as {found.effects[0]}"
        case Kind.IMITATES:
            return f"imitates {found.effects[0]} in these data"
        case Kind.IMITATES_TABLE:
            return f"explains less than {describe_law(found)} as a table does"
        case Kind.OTHERS_BETTER:
            return "others explain it better"
        case Kind.LONG_STEPS:
            return "predicts no better with shorter steps of the integrator: it compensated for long ones"
        case Kind.BY_CHANCE:
            return "does not lower the held-out errors significantly"
    return _describe_gate(found)


def _describe_fall(numbers: Mapping[str, Quantity]) -> str:
    """Return the errors before and after."""
    kinds = [name.removesuffix(".after") for name in numbers if name.endswith(".after")]
    changes = [measure_change(numbers[f"{kind}.before"], numbers[f"{kind}.after"]) for kind in kinds]
    falls = (f"{FALLS[kind]} {change}" for kind, change in zip(kinds, changes, strict=True))
    return f"errors: {', '.join(falls)}"


def _describe_gate(found: Finding) -> str:
    """Return the gate that an effect failed."""
    name, _, at = found.parameters[0].partition("@")
    value, limit = found.numbers[found.parameters[0]], found.numbers[f"limit.{found.parameters[0]}"]
    if name in NOT_TRIED:
        return NOT_TRIED[name]
    if name == "residual_over_noise":
        return f"not tried: the residual is {value.value:.2g} times the noise floor, which counts as noise"
    if name in ("gain", "p_value"):
        gain, p_value = found.numbers["gain"], found.numbers["p_value"]
        std = f" ± {gain.std:.2g}" if gain.std else ""
        penalty, most = (found.numbers[f"limit.{own}"].value for own in ("gain", "p_value"))
        compared = "the selected effects" if found.effects else "the base model"
        limits = f"{format_p_value(p_value.value)} with a penalty of {penalty:.2g} nat, limit {most:.2g}"
        return f"gain of {gain.value:.3g}{std} nat over {compared}: {limits}"
    if name == "explained_share":
        share = f"{100 * value.value:.3g} % of the residual or of the motion error"
        return f"explains {share}, less than {100 * limit.value:.3g} %"
    if name == "known_parameters":
        return f"predicts no better than other values of the parameters that were given: {format_p_value(value.value)}"
    if name == "residual_in_loop":
        return f"leaves {value.value:.2g} times the noise floor: in a closed loop, it may fit the controller's answer"
    if name == "kept_gravity":
        return f"fits only with {value.value:.2g} times the gravity: both terms cancel and imitate a third law"
    if name == "kept_inertia":
        return f"fits only with {value.value:.2g} times the inertia, less than {limit.value:.0%}: it imitates inertia"
    if name in HELD_OUT:
        where = f" at {at}" if at else ""
        return f"does not lower the held-out {HELD_OUT[name]} ({measure_change(limit, value)}){where}"
    return f"would mean {join_words(describe_violations(found))}, which no body has"
