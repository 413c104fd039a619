"""Texts of findings, with numbers in displayed units and options of the command line."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from estimators.arms.standard import Nearest
from estimators.diagnosis.result import Candidate
from estimators.findings import Finding, Kind, Quantity
from pendulum_env.formatting import capitalise, format_estimate, format_p_value, format_quantity, join_words
from pendulum_env.settings import Blank, format_setting
from pendulum_env.units import to_shown_unit
from workbench.narrator.effects import find_description, name_effect

LOGGED = {"A": "a current", "V": "a voltage", "duty": "a duty cycle"}
OTHER_LOAD = (
    "Record with another known load, or without any, and give `load` in the study; or log the torque at the output as "
    "`load_torque`."
)
PHRASES = {  # violated bounds by gate; other gates are parameters
    "negative_inertia": "a negative inertia",
    "driving_friction": "friction that drives",
    "soft_stop": "a stop that is pressed in by {}",
    "dry_friction": "dry friction of {}, more than the torque that moved the joint",
}
LIMITS = ("torque", "angle", "speed")
NOT_TRIED = {
    "earlier_effects": "not tried: a transmission is tried only as the first effect",
    "transmissions": "not tried: the model has a transmission already",
    "variants": "not tried: these data offer no variant of it",
}
SHARES = {
    "explained_share": "the residual or of the motion error",
    "share_above_floor": "the torque above the noise floor",
}
HELD_OUT = {
    "holdout_in_loop": "error in the loop",
    "holdout_position": "error of free-running simulation",
    "holdout_torque": "torque error",
}
ERRORS = {"in_loop": "in the loop", "torque_rms": "torque", "position_rms": "position"}
FLOOR_SOURCES = {"in_loop": "the resolution of the encoder", "torque_rms": "the scatter between samples"}
FALLS = ERRORS | {"position_rms": "free-running position"}


def describe(finding: Finding) -> str:
    """Describe a finding in one to three sentences; a reason for or against an effect is a phrase about it.

    Raises TypeError for other objects, for example a result with findings.
    """
    if not isinstance(finding, Finding):
        raise TypeError(f"describe takes one finding, not {type(finding).__name__}: give one of `findings` of a result")
    text = (REASONS if finding.kind in REASONS else DESCRIBED)[finding.kind]
    return text.format(**_collect_words(finding)) if isinstance(text, str) else text(finding)


class _Measured(Quantity):
    """Quantity in a text: `{angle}`, `{angle:2}` with two digits, `{angle.plain}` without its unit."""

    @property
    def plain(self) -> str:
        """Return value and standard error without the unit."""
        return format_estimate(self.value, self.std)

    def __format__(self, digits: str) -> str:
        return measure(self, int(digits or 3))


def _collect_words(finding: Finding) -> dict[str, Any]:
    """Return the values of the placeholders in `DESCRIBED`."""
    words: dict[str, Any] = {
        id: _Measured(quantity.value, quantity.std, quantity.unit) for id, quantity in finding.numbers.items()
    }
    words |= {kind: join_words(getattr(finding, kind)) for kind in ("parameters", "effects", "recordings")}
    words["by_joint"] = f" by {join_words(finding.joints)}" if finding.joints else ""
    words["fix_gravity"] = format_setting("fixed", {"gravity": Blank("VALUE")})
    words |= {"begin": _begin_sentence(finding), "without_torque": format_setting("columns", {"torque": "none"})}
    if "torque_constant" in finding.numbers:
        logged = finding.numbers["torque_constant"].unit.partition("/")[2]
        words["name"] = "torque constant" if logged == "A" else "torque gain"
        words["logged"], words["channel"] = logged, LOGGED.get(logged, logged)
        words["unknown"] = f"The {words['name']} is unknown, and every parameter is per {logged}"
    if "number" in finding.numbers:
        recording, *others = finding.recordings
        reference = "the others" if len(others) > 1 else f"'{others[0]}'" if others else "the model"
        words["disagrees"] = f"Recording {finding.numbers['number'].value:g} ({recording}) disagrees with {reference}"
    return words


def _begin_sentence(finding: Finding) -> str:
    """Return the beginning of a sentence about the recordings of a finding."""
    return f"{join_words(finding.recordings)}: the" if finding.recordings else "The"


def advise_inertia() -> str:
    """Return the remedy for an unknown inertia."""
    return f"Record faster reversals, or give its value ({format_setting('fixed', {'inertia': Blank('VALUE')})})."


def measure(quantity: Quantity, digits: int = 3, is_parameter: bool = False) -> str:
    """Format a quantity in its displayed unit, with its standard error if known."""
    factor, unit = to_shown_unit(1.0, quantity.unit, is_parameter)
    value, std = factor * quantity.value, factor * quantity.std
    text = format_estimate(value, std) if std else format_quantity(value, digits)
    return f"{text} {unit}".rstrip()


def measure_change(before: Quantity, after: Quantity, digits: int = 3) -> str:
    """Format two values in one unit: `0.2 -> 0.1 rad`."""
    value, _ = to_shown_unit(before.value, before.unit)
    return f"{format_quantity(value, digits)} -> {measure(after, digits)}"


def measure_range(low: float, high: float, unit: str, digits: int = 3) -> str:
    """Format a range in its displayed unit: `-1.2 to 0.9 rad`."""
    ends = [to_shown_unit(end, unit) for end in (low, high)]
    return f"{ends[0][0]:.{digits}g} to {ends[1][0]:.{digits}g} {ends[0][1]}".rstrip()


def format_milliseconds(quantity: Quantity) -> str:
    """Format a time [s] in ms, with its standard error to one digit: `9.90 ± 0.04 ms`."""
    value, std = 1e3 * abs(quantity.value), 1e3 * quantity.std
    digits = min(3, max(0, -int(np.floor(np.log10(max(std, 1e-3)))))) if np.isfinite(std) else 3
    return f"{value:.{digits}f} ± {std:.{digits}f} ms"


def _describe_unidentifiable(finding: Finding) -> str:
    names, first = join_words(finding.parameters), finding.parameters[0].partition(".")[0]
    if not finding.numbers:
        return f"The data do not determine {names}. Move all joints faster, wider and together."
    best = ", ".join(measure(finding.numbers[name], is_parameter=True) for name in finding.parameters)
    return (
        f"The data do not determine {names}: the best fit is {best}. "
        f"Record {find_description(first).informative_experiment}, at more frequencies."
    )


def describe_late(finding: Finding, remedy: str = "") -> str:
    """Describe torque that is logged late or filtered; `remedy` is the last sentence."""
    delay, lag = finding.numbers.get("delay"), finding.numbers.get("lag")
    is_sampled = finding.kind in (Kind.TORQUE_SAMPLED, Kind.TORQUE_SAMPLED_CORRECTED)
    law = ["logged half a sample late"] if is_sampled and not delay else []
    law += [f"logged {format_milliseconds(delay)} late"] if delay else []
    law += [f"logged through a low-pass filter with a time constant of {format_milliseconds(lag)}"] if lag else []
    sampling = ". It was sampled like the position, and not held until the next sample" if is_sampled else ""
    is_corrected = finding.kind in (Kind.TORQUE_LATE_CORRECTED, Kind.TORQUE_SAMPLED_CORRECTED)
    remedy = remedy or (CORRECTED if is_corrected else CORRECT_IT)
    return f"{_begin_sentence(finding)} torque is {' and '.join(law)}{_describe_rival(finding)}{sampling}. {remedy}"


def _describe_lag(finding: Finding) -> str:
    delay = finding.numbers.get("delay")
    lag = f"with a lag of {format_milliseconds(finding.numbers['lag'])}" if delay is None else ""
    law = f"{format_milliseconds(delay)} after its time stamp" if delay else lag
    return (
        f"{_begin_sentence(finding)} torque acts {law}{_describe_rival(finding)}. Possible causes: the drive "
        "(dead_time, actuator_lag), early time stamps, or a flexible joint. Log current or torque at the motor to "
        "distinguish them."
    )


def _describe_rival(finding: Finding) -> str:
    """Describe the alternative law, delay or filter, if it fits equally; else empty."""
    lag = "with a lag" if finding.kind is Kind.ACTS_LATE else "through a low-pass filter with a time constant"
    for rival, law in (("rival_delay", "by a delay"), ("rival_lag", lag)):
        if rival in finding.numbers:
            size = f"{1e3 * abs(finding.numbers[rival].value):.3g} ms"
            return f" (or {law} of {size}; more steps of torque would distinguish them)"
    return ""


def _describe_differences(finding: Finding) -> str:
    parts = []
    for parameter in finding.parameters:
        value, reference = finding.numbers[parameter], finding.numbers[f"others.{parameter}"]
        share = (value.value - reference.value) / max(abs(reference.value), 1e-300)
        if abs(share) > 1:  # relative change of a parameter near zero
            plain = replace(value, std=0.0), replace(reference, std=0.0)
            texts = [measure(quantity, is_parameter=True) for quantity in plain]
            parts.append(f"{parameter} {' instead of '.join(texts)}")
        else:
            percent = float(f"{100 * abs(share):.2g}")
            parts.append(f"{parameter} {percent:g} % {'higher' if share > 0 else 'lower'}")
    return f"{_collect_words(finding)['disagrees']}: {', '.join(parts)}."


def _make_column_text(text: str, otherwise: str = "") -> Callable[[Finding], str]:
    """Make the function that adds to a text the options that read a column correctly, or `otherwise` without any."""

    def describe_column(finding: Finding) -> str:
        options = [
            f"Read {'it' if len(finding.remedies) == 1 else join_words(remedy.recordings)} with "
            f"{format_setting('columns', remedy.columns)} instead."
            for remedy in finding.remedies
        ]
        sentence = f"{text.format(**_collect_words(finding))}."
        return " ".join([sentence, *(options or filter(None, [otherwise]))])

    return describe_column


def _describe_zero(finding: Finding) -> str:
    angle = finding.numbers["angle"]
    size, error = abs(np.degrees(angle.value)), np.degrees(angle.std)
    digits = int(np.clip(-np.floor(np.log10(max(error, 1e-9))), 0, 3))
    text = (
        f"The zero of the position is {size:.{digits}f} ± {error:.{digits}f} degrees off, or the base is tilted by "
        "that angle (gravity_tilt)"
    )
    return _make_column_text(text)(finding)


def _describe_incomplete(finding: Finding) -> str:
    parts = []
    if "residual" in finding.numbers:
        size = f"{finding.numbers['residual'].value:.2g} times the noise floor"
        joints = f" ({join_words(finding.joints)})" if finding.joints else ""
        parts.append(f"the residual is {'up to ' * (len(finding.joints) > 1)}{size}{joints}")
    if "disagreement" in finding.numbers:
        size = f"{finding.numbers['disagreement'].value:.2g} standard errors"
        up_to = "up to " * (len(finding.parameters) > 1)
        parts.append(f"the schemes disagree on {join_words(finding.parameters)} by {up_to}{size}")
    return f"The model is incomplete: {', and '.join(parts)}. All estimates are biased."


def describe_violations(finding: Finding) -> list[str]:
    """Return a phrase for each violated physical bound, such as "a negative inertia"."""
    numbers = {name: measure(finding.numbers[name], is_parameter=True) for name in finding.parameters}
    return [PHRASES.get(name, f"{name} = {{}}").format(number) for name, number in numbers.items()]


def _describe_servo(finding: Finding) -> str:
    worst = finding.numbers.get("worst")
    worst_text = "" if worst is None else f", most of it in {join_words(finding.recordings)} ({measure(worst, 2)})"
    return (
        f"Simulated from its goal, the servo is off by {measure(finding.numbers['error'], 2)}, "
        f"{finding.numbers['times'].value:.2g} times the noise of the encoder{worst_text}."
    )


def _describe_tie(finding: Finding) -> str:
    text = f"{join_words(finding.effects)} look the same in these data"
    reveals = find_description(finding.effects[-1]).informative_experiment
    return f"{text}. To distinguish them, record {reveals}." if reveals else f"{text}."


def describe_untested(finding: Finding) -> str:
    """Return a phrase on the tested range of an effect."""
    ends = {end: measure(finding.numbers[end]) for end in ("low", "high") if end in finding.numbers}
    effect = name_effect(finding.effects[0]).removeprefix("a ")
    if len(ends) == 2:
        text = f"no {effect} was met from {ends['low']} to {ends['high']}"
    elif "low" in ends:
        text = f"no lower {effect} was met down to {ends['low']}"
    else:
        text = f"no upper {effect} was met up to {ends['high']}"
    return f"{text}, and contacts beyond cannot be seen"


def describe_law(finding: Finding) -> str:
    """Name the law that a table represents."""
    power = finding.numbers.get("power")
    return name_effect(finding.effects[0]) if power is None else f"friction that grows as |q'|^{power.value:.2g}"


def _describe_table(finding: Finding) -> str:
    first, *alternatives = finding.effects
    laws = f" Other laws: {join_words(alternatives)}." if alternatives else ""
    command = f"`pendulum-ident add MODEL.json {first} ...`"
    return f"Keep the unknown law as a table, which also shows its shape: {command}.{laws}"


def _describe_payload(finding: Finding) -> str:
    axes = [f"{axis} = {measure(finding.numbers[axis])}" for axis in "xyz" if axis in finding.numbers]
    center = f" Its centre is at {', '.join(axes)} in the frame of that joint." if axes else ""
    joints = [name.removesuffix(".before") for name in finding.numbers if name.endswith(".before")]
    pairs = [(at, finding.numbers[f"{at}.before"], finding.numbers[f"{at}.after"]) for at in joints]
    errors = [f"{at} {measure_change(before, after)}" for at, before, after in pairs]
    explained = f" Torque error there without and with it: {', '.join(errors)}." if errors else ""
    return (
        f"The arm carries a payload of {measure(finding.numbers['mass'])} in {join_words(finding.recordings)}, at the "
        f"link behind {join_words(finding.joints)}.{center}{explained}"
    )


def _describe_limits(finding: Finding) -> str:
    aims = describe_aims(finding.pairs, "or")
    place = finding.numbers.get("place")
    place_text = "" if place is None else f" and go to {measure(place, 2)}, where the residual is largest"
    torque = ", --max-torque" if "torque" in finding.numbers else ""  # a free swing has none
    limits = list_limits(finding.numbers)
    options = f"--max-angle, --max-speed{torque}"
    return f"No experiment within {limits} would {aims}{place_text}. Allow more ({options}) if the rig bears it."


def list_limits(numbers: Mapping[str, Quantity]) -> str:
    """List the limits of an experiment in a phrase: `0.5 N m, 2 rad/s and the recorded angles`."""
    limits = [measure(numbers[name]) for name in LIMITS if name in numbers and np.isfinite(numbers[name].value)]
    recorded = [f"{name}s" for name in ("angle", "speed") if name not in numbers]
    return join_words([*limits, *([f"the recorded {join_words(recorded)}"] if recorded else [])])


def describe_aims(pairs: Sequence[tuple[str, str | None]], conjunction: str = "and") -> str:
    """Describe the aims of an experiment: `tell spring from gravity_tilt and show whether stribeck is there`."""
    aims = [f"tell {effect} from {instead}" for effect, instead in pairs if instead]
    if undetermined := [effect for effect, instead in pairs if not instead]:
        aims.append(f"show whether {join_words(undetermined, 'or')} is there")
    return join_words(aims, conjunction)


def describe_nearest_body(nearest: Nearest) -> str:
    """State whether a physical body can have the identified parameters."""
    if nearest.exists:
        return f"a body can have these parameters, within {max(nearest.distance, 0.1):.1f} standard errors"
    off = f"{nearest.distance:.1f} standard errors off"
    return f"no body has these parameters: the nearest is {off}, in {nearest.farthest}"


CORRECT_IT = "Correct it with --align (`align(recordings).recordings` in Python)."
CORRECTED = "It is corrected here; other commands correct it with --align."
GEAR_LOSSES = (
    ". The losses of its gears and the {name} are then one number, {torque_constant.value:.4g} {torque_constant.unit}. "
    "To distinguish them, let a weight down slowly, so that it turns the motor."
)


def _compare_goals(finding: Finding, reading: str, alternative: str, key: str) -> str:
    if "gain" not in finding.numbers:  # decided by the selected effects
        return f"Goals are read as {reading}. Goals {alternative} predict worse."
    sizes = [f"{quantity.value * 1000:.1f} ms" for id, quantity in finding.numbers.items() if id != "gain"]
    late = f" with {name_effect(finding.effects[0])} of {sizes[0]}" if sizes else ""
    fit = _compare_fits(finding.numbers["gain"], f"The other reading, goals {alternative}{late},")
    return f'Goals are read as {reading}. {fit} If it is right, give `goal = "{key}"` in `[drive]`.'


def _compare_controllers(finding: Finding) -> str:
    settings = ", ".join(f'`{name} = "{value}"`' for name, value in finding.pairs)
    fit = _compare_fits(finding.numbers["gain"], "The likeliest other convention")
    return f"The controller is simulated with {settings}. {fit} Give the right one in `[drive]`."


def _compare_position_readings(finding: Finding) -> str:
    reading, alternative = "whole counts of its encoder", "the exact position"
    if ("reads", "exact") in finding.pairs:
        reading, alternative = alternative, reading
    fit = _compare_fits(finding.numbers["gain"], f"The other reading, {alternative},")
    return f"The controller is simulated with {reading}. {fit} Give the right one: `reads` in `[drive]`."


def _compare_fits(gain: Quantity, alternative: str) -> str:
    """State whether another convention fits worse; `gain`: of the chosen one [nat], with standard error."""
    times = gain.value / max(gain.std or 0.0, 1e-9)
    if times > 2:
        return f"{alternative} fits worse, by {times:.1f} standard errors."
    difference = f"the difference is {abs(times):.1f} standard errors"
    return f"{alternative} fits about as well: {difference}. The log does not decide."


def describe_reason(candidate: Candidate) -> str:
    """Return the reason for the verdict on a candidate, as a phrase about the effect."""
    text = describe(candidate.reason)
    experiment = find_description(candidate.effect).informative_experiment
    is_silent = candidate.reason.kind in (Kind.NOT_TESTED, Kind.NOT_EXCITED)
    return f"{text}; it needs {experiment}" if is_silent and experiment else text


def _describe_fall(finding: Finding) -> str:
    numbers = finding.numbers
    kinds = [name.removesuffix(".after") for name in numbers if name.endswith(".after")]
    changes = [measure_change(numbers[f"{kind}.before"], numbers[f"{kind}.after"]) for kind in kinds]
    falls = (f"{FALLS[kind]} {change}" for kind, change in zip(kinds, changes, strict=True))
    return f"lowers the held-out errors: {', '.join(falls)}"


def _describe_gate(finding: Finding) -> str:
    """Describe the gate that an effect failed, as a phrase about the effect."""
    name, _, at = finding.parameters[0].partition("@")
    value, limit = finding.numbers[finding.parameters[0]], finding.numbers[f"limit.{finding.parameters[0]}"]
    if name in NOT_TRIED:
        return NOT_TRIED[name]
    if name == "residual_over_noise":
        return f"not tried: the residual is {value.value:.2g} times the noise floor, which counts as noise"
    if name in ("gain", "p_value"):
        gain, p_value = finding.numbers["gain"], finding.numbers["p_value"]
        std = f" ± {gain.std:.2g}" if gain.std else ""
        penalty, limit_of_p = (finding.numbers[f"limit.{id}"].value for id in ("gain", "p_value"))
        compared = "the selected effects" if finding.effects else "the base model"
        limits = f"{format_p_value(p_value.value)} with a penalty of {penalty:.2g} nat, limit {limit_of_p:.2g}"
        return f"gain of {gain.value:.3g}{std} nat over {compared}: {limits}"
    if name in SHARES:
        return f"explains {100 * value.value:.3g} % of {SHARES[name]}, less than {100 * limit.value:.3g} %"
    if name == "known_parameters":
        return f"predicts no better than other values of the parameters that were given: {format_p_value(value.value)}"
    if name == "coefficients":
        return f"not determined: its coefficients may be zero, {format_p_value(value.value)}, limit {limit.value:.2g}"
    if name == "residual_in_loop":
        return f"leaves {value.value:.2g} times the noise floor: in a closed loop, it may fit the controller's answer"
    if name == "frequencies":
        return "not determined: the motion has one frequency, at which it is another inertia and viscous friction"
    if name == "kept_gravity":
        return f"fits only with {value.value:.2g} times the gravity: both terms cancel and imitate a third law"
    if name == "kept_inertia":
        return f"fits only with {value.value:.2g} times the inertia, less than {limit.value:.0%}: it imitates inertia"
    if name in HELD_OUT:
        place = f" at {at}" if at else ""
        return f"does not lower the held-out {HELD_OUT[name]} ({measure_change(limit, value)}){place}"
    return f"would mean {join_words(describe_violations(finding))}, which no body has"


DESCRIBED: Mapping[Kind, str | Callable[[Finding], str]] = {  # templates for `_collect_words`, or functions
    Kind.NO_MOTION: "The joint moves too little to identify any parameter. Record wider or faster motion.",
    Kind.TORQUE_IS_NOISE: (
        "The torque is noise alone, so only ratios of parameters are known. Read the file without it "
        "({without_torque})."
    ),
    Kind.TORQUE_IS_CONSTANT: (
        "The torque is constant at {torque}, and the motion does not follow it. Read the file without it "
        "({without_torque}), or look for an offset."
    ),
    Kind.TORQUE_FOLLOWS_DIRECTION: (
        "While the joint moves, the torque is {torque} along the velocity. One size of torque determines only ratios "
        "of the parameters. Record torques of several sizes, or sines."
    ),
    Kind.ONE_DIRECTION: (
        "The velocity never changes sign, so coulomb and torque_offset cannot be told apart. Record both directions."
    ),
    Kind.SMALL_ANGLES: (
        "The position stays small, within {angle:2}: gravity and a spring look the same. Record wider swings."
    ),
    Kind.NEVER_ACTS: "{parameters} never acts in these recordings. Record motion that reaches it.",
    Kind.INDISTINGUISHABLE: "{parameters} cannot be told apart: they act alike in these recordings.",
    Kind.UNIDENTIFIABLE: _describe_unidentifiable,
    Kind.RELATIVE_TO_INERTIA: lambda finding: (
        "No torque is applied: every parameter is relative to the inertia"
        f"{' of the joint with its known load' if finding.recordings else ''}, which is 1. A known value makes them "
        f"absolute ({format_setting('fixed', {'inertia': Blank('VALUE')})}). "
        "If a motor drives the joint, name the column of its torque."
    ),
    Kind.LOADS_UNKNOWN: (
        "{unknown}. The log has {channel} for the torque, and known loads that differ are needed. " + OTHER_LOAD
    ),
    Kind.LOADS_EQUAL: (
        "{unknown}. The log has {channel} for the torque, and all recordings have the same load. " + OTHER_LOAD
    ),
    Kind.CONSTANT_TOO_SHORT: (
        "{unknown}: too little of the motion is clear of the ends of the recordings. Record longer."
    ),
    Kind.ONE_LOAD_MOVED: (
        "{unknown}: of {loads.value:g} known loads only one was moved. Move the joint under each of them, clear of "
        "stick."
    ),
    Kind.CONSTANT_UNCERTAIN: (
        "{unknown}: the known loads give its inverse as {inverse.plain} {logged}/(N m). Take loads that differ more, "
        "or move further."
    ),
    Kind.CONSTANT_NEGATIVE: lambda finding: (
        "{unknown}: the known loads give {torque_constant.plain} {torque_constant.unit}, which is negative. Turn "
        f"{'load_torque, ' if finding.parameters else ''}torque or position round with a minus sign."
    ).format(**_collect_words(finding)),
    Kind.INTEGRAL_CONTROLLER: (
        "{unknown}: the controller has an integral, and known loads do not tell its torque. Give the drive a gain."
    ),
    Kind.GEAR_LOSS_UNKNOWN: "The motor pushes along the motion {share.value:.0%} of the time" + GEAR_LOSSES,
    Kind.LOAD_BRAKES: "The load torque nearly always opposes the motion" + GEAR_LOSSES,
    Kind.BACK_EMF: lambda finding: (
        f"The log has {LOGGED[finding.numbers['back_emf'].unit.partition(' ')[0]]}: back-EMF is part of the viscous "
        f"friction, and its constant k_e is at most {measure(finding.numbers['back_emf'])}."
    ),
    Kind.TORQUE_LATE: describe_late,
    Kind.TORQUE_LATE_CORRECTED: describe_late,
    Kind.TORQUE_SAMPLED: describe_late,
    Kind.TORQUE_SAMPLED_CORRECTED: describe_late,
    Kind.ACTS_LATE: _describe_lag,
    Kind.TORQUE_CONSTANT: "The known loads give the torque constant.",
    Kind.NARROWER_WINDOWS: "The windows have {share.value:g} of their length.",
    Kind.WINDOWS_BY_INERTIA: (
        "Window lengths and noise floor follow from the inertia {inertia:3} of the model, not from {before:3}."
    ),
    Kind.IMPACTS_INCLUDED: "Windows in contact with a stop, at reversals or at rest, are included.",
    Kind.RECORDINGS_EXCLUDED: "Left out: {recordings}.",
    Kind.TIMED_BESIDE: "Torque is timed beside {effects}.",
    Kind.TIMED_AS_LOGGED: "Torque keeps its time of the log.",
    Kind.PAYLOAD: _describe_payload,
    Kind.BACK_EMF_INCLUDED: "The base model has back-EMF.",
    Kind.GOALS_HELD: lambda finding: _compare_goals(
        finding, "held from row to row", "that run on between rows", "ramp"
    ),
    Kind.GOALS_RUN_ON: lambda finding: _compare_goals(
        finding, "running on between rows", "that are held from row to row", "held"
    ),
    Kind.STIFF_STOP: (
        "The stop at {angle:3} is pressed in by {depth:2} at most, at too few depths for the error of its end: its "
        "stiffness is unknown. Press it slowly at several torques."
    ),
    Kind.NOISE_NOT_LOGGED: (
        "Torque that is not logged moves the joint: white noise of {torque:2} per sample. A missing effect below "
        "{hidden:2} would not show. Log the torque at the motor, or record longer."
    ),
    Kind.SCALE_UNKNOWN: (
        "The torque drives {share.value:.0%} of the motion. Friction of mu times the torque, as in gears, would not "
        "show: all parameters would be 1 / (1 - mu) times too large. To see it, let gravity or a load turn the motor."
    ),
    Kind.CONTROLLER_READ: _compare_controllers,
    Kind.POSITION_READ: _compare_position_readings,
    Kind.COUNTS_UNSEEN: (
        "The log shows no step of an encoder: the controller is simulated with the exact position, though its drive "
        'has `reads = "counts"`. Log the position as the encoder counts it, without a filter.'
    ),
    Kind.SMALL_EFFECT: lambda finding: (
        f"{capitalise(name_effect(finding.effects[0]))} may be missing: it predicts better "
        f"({format_p_value(finding.numbers['p_value'].value)}), but explains only "
        f"{100 * finding.numbers['share'].value:.2g} % of the residual or of the motion error, less than "
        f"{100 * finding.numbers['least'].value:.2g} %."
    ),
    Kind.FEEDBACK: (
        "{begin} torque reacts to the motion ({gain:2} between samples). "
        "Reactions of a controller may be taken for physics. "
        "Record a planned torque, or describe the controller by `--drive`, with its goals in the column `reference`."
    ),
    Kind.OUTLIER_RECORDING: _describe_differences,
    Kind.SCALED_TORQUE: "{disagrees}: its torque is {factor.value:.3g} times what the same motion takes there.",
    Kind.SCALED_INERTIA: "{disagrees}: its inertia is {factor.value:.3g} times that there.",
    Kind.TURNED_ROUND: "{disagrees}: torque or position has the opposite sign in it.",
    Kind.MISFIT: (
        "{disagrees}: no parameters fit it. The residual is {residual:2}, {times.value:.2g} times the noise floor: "
        "something was changed, or an effect shows there only."
    ),
    Kind.FEW_STRETCHES: (
        "Only {count.value:g} stretches of motion are clear of stick, and many effects would not show. Record longer, "
        "faster or wider motion."
    ),
    Kind.CLOCK_UNEVEN: (
        "The clock may cause the residual: time steps in {recordings} scatter by {std:2} about {period:3}, and no "
        "uniform clock fits them. Log the time or the number of each sample where it is taken."
    ),
    Kind.FILTER_SLOWED: (
        "At {rate.value:.4g} Hz the filters would pass everything: their cutoff is lowered to {rate.value:.4g} rad/s."
    ),
    Kind.ENCODER_COARSE: (
        "Noise of the position has more than half of the acceleration's information: estimates of some schemes are "
        "biased. Record faster motion, or with a finer encoder."
    ),
    Kind.SPEED_RATE_UNKNOWN: (
        "If the drive computes its speed from two readings of its encoder, give the rate of the readings (`rate`). At "
        "{rate.value:g} readings a second, the inertia is {inertia:2} larger than stated here."
    ),
    Kind.TORQUE_SCALED: (
        "The logged torque is {factor.value:.2f} times the torque that the described drive asks for, and all "
        "parameters are by the drive. Check its gains and limit, and the unit of the torque column."
    ),
    Kind.LOAD_TORQUE_TURNED: _make_column_text(
        "The motion follows load_torque with the opposite sign: a load torque that drives the joint is positive"
    ),
    Kind.INERTIA_NEGATIVE: _make_column_text(
        "The inertia came out negative ({inertia:2}): torque and position have opposite signs",
        "Give one of them a minus sign.",
    ),
    Kind.ZERO_SHIFTED: _describe_zero,
    Kind.ZERO_UPRIGHT: _make_column_text(
        "The gravity came out negative: position 0 seems to be the upright position, and must be the hanging one"
    ),
    Kind.GRAVITY_BESIDE_SPRING: (
        "The gravity came out negative beside a spring: the two cancel, and neither is meaningful."
    ),
    Kind.FRICTION_NEGATIVE: "{parameters} came out negative, and no friction drives: another law acts in its place.",
    Kind.INCOMPLETE: _describe_incomplete,
    Kind.TIED: _describe_tie,
    Kind.PART_OF_TURN: (
        "The motion covers {angle:2}, less than a turn. Gravity is right only if the law of {effects} is exact: "
        "another law of the angle, or a wrong scale of the angle, fits alike. Record a whole turn, or give the value "
        "of gravity ({fix_gravity})."
    ),
    Kind.UNTESTED_RANGE: lambda finding: f"{capitalise(describe_untested(finding))}.",
    Kind.IMPOSSIBLE: lambda finding: (
        f"The best fit is unphysical: it has {join_words(describe_violations(finding))}. Check the signs of torque and "
        "position, or record a motion of more than one frequency."
    ),
    Kind.TABLE_EXPLAINS: lambda finding: (
        f"{capitalise(describe_law(finding))} would explain most of the residual. No effect of the library "
        "explains it in these data."
    ),
    Kind.NEAR_REVERSALS: (
        "The torque fits where the joint moves freely, but free-running simulation of the fitted data errs by "
        "{error:2}: something acts near reversals or at rest."
    ),
    Kind.CONTACT: (
        "A stop or a blow was met{by_joint} at {angle:3} ({recordings}, {time:3}): {torque:2} more than the model "
        "predicts. No effect explains the contacts ({count.value:g}). To identify a stop, press against it slowly at "
        "several torques; else keep away from it."
    ),
    Kind.NOWHERE: (
        "The residual is {residual:2}, {times.value:.2g} times the noise floor, at no one speed, angle or time. "
        "Something acts faster than the windows resolve, or rarely."
    ),
    Kind.SERVO_OFF: _describe_servo,
    Kind.TABLE_HELPS: _describe_table,
    Kind.ROTORS_MISSING: lambda finding: (
        f"The robot file lacks the inertia of the motors at {join_words(finding.joints)}. Fit all rotors: "
        f"{format_setting('rotors', True)}."
    ),
    Kind.NO_EFFECT_OPEN: "No library effect explains the rest of the residual. Write your own effect, or keep a table.",
    Kind.FIT_HELD_OUT: (
        "The model explains the fitted data, but not the held-out data ({recordings}). If both are of one machine, "
        "fit both."
    ),
    Kind.INERTIA_UNKNOWN: lambda finding: (
        f"The motion of an experiment cannot be predicted without the inertia. {advise_inertia()}"
    ),
    Kind.BEYOND_LIMITS: _describe_limits,
    Kind.CHECK_DRIVE: (
        "No effect that was tried explains the residual. Check the drive: kp, kd and ki in the units of `output`, "
        "`limit`, `supply`, `rate`, `delay`, and how it integrates and differentiates. Then record under more gains."
    ),
}
REASONS: Mapping[Kind, str | Callable[[Finding], str]] = {  # phrases about an effect
    Kind.ERRORS_FALL: _describe_fall,
    Kind.ERROR_FALLS_AT_JOINT: lambda finding: (
        f"lowers the held-out torque error of {join_words(finding.joints)} to {finding.numbers['share'].value:.1%}"
    ),
    Kind.TIES: lambda finding: f"predicts as well as {finding.effects[0]}",
    Kind.IMITATES: lambda finding: f"imitates {finding.effects[0]} in these data",
    Kind.IMITATES_TABLE: lambda finding: f"explains less than {describe_law(finding)} as a table does",
    Kind.NOT_TESTED: describe_untested,
    Kind.ONLY_CONTACTS: "may be met at {angle:3}, in contacts that do not determine it",
    Kind.NOT_EXCITED: "these data do not depend on it",
    Kind.GATE_FAILED: _describe_gate,
    Kind.OTHERS_BETTER: "others explain it better",
    Kind.LONG_STEPS: "with shorter steps of the integrator it predicts no better, or explains too little",
    Kind.BY_CHANCE: "does not lower the held-out errors significantly",
}
