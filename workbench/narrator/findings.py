"""Texts of findings, with numbers in displayed units and options of the command line."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from estimators.checks.alignment import TorqueTiming
from estimators.checks.closed_loop import Feedback
from estimators.checks.homogeneity import Difference, Disagreement
from estimators.checks.remedies import UnevenClock, WrongColumn
from estimators.checks.signs import NegativeParameters
from estimators.checks.torque_constant import BackEmfInFriction, GearLosses, UnknownConstant
from estimators.data.calibration import RelativeToInertia
from estimators.data.regions import ResidualWithoutPlace
from estimators.data.standard_errors import StiffStop
from estimators.data.treatment import Action, Treatment
from estimators.decisions.errors import ErrorFall
from estimators.decisions.gate import FailedGates
from estimators.diagnosis.caveats import FewWindows, PartOfTurn, UnknownScale
from estimators.diagnosis.completeness import Incomplete
from estimators.diagnosis.conclusion import NoKnownEffect, UnknownInertia
from estimators.diagnosis.contacts import Contact
from estimators.diagnosis.experiment import UnreachableAims
from estimators.diagnosis.ranking import Imitation, Tie
from estimators.diagnosis.result import Candidate
from estimators.diagnosis.small_effect import SmallEffect
from estimators.diagnosis.suggestion import Aim
from estimators.diagnosis.unexplained import ErrorNearReversals, HeldOutResidual
from estimators.diagnosis.untested import UntestedRange
from estimators.findings import Finding, Quantity
from estimators.identification import CoarseEncoder, SlowedFilter
from estimators.schemes.identifiability import Gap, Undetermined
from estimators.selection.process_noise import UnloggedTorque
from estimators.selection.tables import ExplainingTable
from estimators.texts import Text, find_cause, find_text
from pendulum_env.formatting import (
    capitalise,
    format_estimate,
    format_p_value,
    format_percent,
    join_words,
    measure,
    measure_change,
)
from pendulum_env.physics.effect_texts import find_description, name_effect, name_effects
from pendulum_env.settings import Blank, format_setting

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
    return _write(SENTENCES if type(finding) in SENTENCES else REASONS, finding)


def describe_reason(candidate: Candidate) -> str:
    """Return the reason for the verdict on a candidate, as a phrase about the effect."""
    reason = candidate.reason
    text = _write(REASONS, reason)
    experiment = find_description(candidate.effect).informative_experiment
    is_silent = isinstance(reason, UntestedRange) or (isinstance(reason, FailedGates) and reason.has_gate("excitation"))
    return f"{text}; it needs {experiment}" if is_silent and experiment else text


def _write(texts: Mapping[type[Finding], Text], finding: Finding) -> str:
    """Write the text of a finding by the template or function of its family, here or in another package."""
    return _apply(texts.get(type(finding)) or find_text(type(finding)) or _list_fields, finding)


def _apply(text: Text, finding: Finding) -> str:
    """Write a text on a finding by a template or function."""
    return _fill(text, finding) if isinstance(text, str) else text(finding)


def describe_cause(finding: Finding) -> str:
    """Describe a missing part of the machine in a phrase, as "a payload of 2 kg"; empty for other findings."""
    text = find_cause(type(finding))
    return "" if text is None else _apply(text, finding)


def _list_fields(finding: Finding) -> str:
    """List family and fields of a finding without a text."""
    values = {field.name: getattr(finding, field.name) for field in fields(finding)}  # type: ignore[arg-type]
    texts = [f"{name} {measure(value) if isinstance(value, Quantity) else value}" for name, value in values.items()]
    return f"{capitalise(finding.family.replace('_', ' '))}{': ' * bool(texts)}{', '.join(texts)}."


class _Measured(Quantity):
    """Quantity in a text: `{angle}`, `{angle:2}` with two digits, `{angle.plain}` without its unit."""

    @property
    def plain(self) -> str:
        """Return value and standard error without the unit."""
        return format_estimate(self.value, self.std)

    def __format__(self, digits: str) -> str:
        return measure(self, int(digits or 3))


def _fill(template: str, finding: Finding) -> str:
    """Fill a template with the fields of a finding: quantities in displayed units, and lists of names as words."""
    values = {field.name: getattr(finding, field.name) for field in fields(finding)}  # type: ignore[arg-type]
    words: dict[str, Any] = {"begin": _begin_sentence(values.get("recordings", ()))}
    words["without_torque"] = format_setting("columns", {"torque": "none"})
    words["fix_gravity"] = format_setting("fixed", {"gravity": Blank("VALUE")})
    values |= values.pop("quantities", {})
    for name, value in values.items():
        is_names = isinstance(value, tuple) and all(isinstance(item, str) for item in value)
        join = name_effects if name == "effects" else join_words
        words[name] = join(value) if is_names else value
        if isinstance(value, Quantity):
            words[name] = _Measured(value.value, value.std, value.unit)
    return template.format(**words)


def _begin_sentence(recordings: Sequence[str]) -> str:
    """Return the beginning of a sentence about some recordings."""
    return f"{join_words(recordings)}: the" if recordings else "The"


def advise_inertia() -> str:
    """Return the remedy for an unknown inertia."""
    return f"Record faster reversals, or give its value ({format_setting('fixed', {'inertia': Blank('VALUE')})})."


def format_milliseconds(quantity: Quantity) -> str:
    """Format a time [s] in ms, with its standard error to one digit: `9.90 ± 0.04 ms`."""
    value, std = 1e3 * abs(quantity.value), 1e3 * quantity.std
    digits = min(3, max(0, -int(np.floor(np.log10(max(std, 1e-3)))))) if np.isfinite(std) else 3
    return f"{value:.{digits}f} ± {std:.{digits}f} ms"


def name_treatment(treatment: Finding) -> str:
    """Return the name of a treatment of recordings for a table: its action, or its family."""
    return str(treatment.action) if isinstance(treatment, Treatment) else treatment.family


def _describe_treatment(finding: Treatment) -> str:
    return _apply(TREATMENTS.get(finding.action) or find_text(finding.action) or _list_fields, finding)


def _describe_undetermined(finding: Undetermined) -> str:
    names = join_words(finding.parameters)
    if finding.combination:
        (first, _), (second, factor) = finding.combination.items()
        total = f"{first} {'+' if factor > 0 else '-'} {abs(factor):.3g} {second}".replace(" 1 ", " ")
        return f"{names} cannot be told apart: only {total} is determined by these recordings."
    if finding.gap is not Gap.LARGE_ERROR:
        return _fill(GAPS[finding.gap], finding)
    if finding.size is None:
        return f"The data do not determine {names}. Move all joints faster, wider and together."
    best, effect = measure(finding.size, is_parameter=True), finding.parameters[0].partition(".")[0]
    experiment = find_description(effect).informative_experiment
    return f"The data do not determine {names}: the best fit is {best}. Record {experiment}, at more frequencies."


def describe_timing(finding: TorqueTiming, remedy: str = "") -> str:
    """Describe the time of the torque; `remedy` is the last sentence on torque that is logged late or filtered."""
    begin, rival = _begin_sentence(finding.recordings), _describe_rival(finding)
    begin = f"{begin} {finding.joint}'s" if finding.joint else begin
    delay, lag = ("" if size is None else format_milliseconds(size) for size in (finding.delay, finding.lag))
    if not finding.is_late:
        return (
            f"{begin} torque acts {f'{delay} after its time stamp' if delay else f'with a lag of {lag}'}{rival}. "
            "Possible causes: the drive (dead time or lag), early time stamps, or a flexible joint. Log current "
            "or torque at the motor to distinguish them."
        )
    law = [f"logged {delay} late" if delay else "logged half a sample late"] if delay or finding.is_sampled else []
    law += [f"logged through a low-pass filter with a time constant of {lag}"] if lag else []
    sampling = ". It was sampled like the position, and not held until the next sample" if finding.is_sampled else ""
    remedy = remedy or (CORRECTED if finding.is_corrected else CORRECT_IT)
    return f"{begin} torque is {' and '.join(law)}{rival}{sampling}. {remedy}"


def _describe_rival(finding: TorqueTiming) -> str:
    """Describe the filter that fits as well as a delay; empty without one."""
    if finding.rival_lag is None:
        return ""
    law = "through a low-pass filter with a time constant" if finding.is_late else "with a lag"
    return f" (or {law} of {1e3 * abs(finding.rival_lag.value):.3g} ms; more steps of torque would distinguish them)"


def _describe_unknown_constant(finding: UnknownConstant) -> str:
    logged, name = finding.logged, "torque constant" if finding.logged == "A" else "torque gain"
    unknown = f"The {name} is unknown, and every parameter is per {logged}"
    if finding.constant is not None:
        column = "load_torque, " if finding.by_load_torque else ""
        value = f"{format_estimate(finding.constant.value, finding.constant.std)} {finding.constant.unit}"
        turn = f"Turn {column}torque or position round with a minus sign."
        return f"{unknown}: the known loads give {value}, which is negative. {turn}"
    if finding.inverse is not None:
        value = f"{format_estimate(finding.inverse.value, finding.inverse.std)} {logged}/(N m)"
        advice = "Take loads that differ more, or move further."
        return f"{unknown}: the known loads give its inverse as {value}. {advice}"
    if finding.has_integral:
        return (
            f"{unknown}: the controller has an integral, and known loads do not tell its torque. Give the drive a gain."
        )
    if finding.loads < 2 and not finding.by_load_torque:
        have = "known loads that differ are needed" if finding.loads == 0 else "all recordings have the same load"
        return f"{unknown}. The log has {LOGGED.get(logged, logged)} for the torque, and {have}. {OTHER_LOAD}"
    if finding.moved == 0:
        return f"{unknown}: too little of the motion is clear of the ends of the recordings. Record longer."
    return (
        f"{unknown}: the joint was moved under {finding.moved} of {finding.loads} known loads. Move it under each of "
        "them, clear of stick."
    )


def _describe_gear_losses(finding: GearLosses) -> str:
    constant = finding.constant
    name = "torque constant" if constant.unit.partition("/")[2] == "A" else "torque gain"
    driven = f"The motor pushes along the motion {finding.share:.0%} of the time"
    place = "The load torque nearly always opposes the motion" if finding.is_braked else driven
    return (
        f"{place}. The losses of its gears and the {name} "
        f"are then one number, {constant.value:.4g} {constant.unit}. To distinguish them, let a weight down slowly, so "
        "that it turns the motor."
    )


def _describe_disagreement(finding: Disagreement) -> str:
    others = finding.others
    reference = "the others" if len(others) > 1 else f"'{others[0]}'" if others else "the model"
    disagrees = f"Recording {finding.number} ({finding.recording}) disagrees with {reference}"
    if finding.residual is not None:
        return (
            f"{disagrees}: no parameters fit it. The residual is {measure(finding.residual, 2)}, "
            f"{finding.noise_ratio:.2g} times the noise floor: something was changed, or an effect shows there only."
        )
    if finding.is_turned:
        return f"{disagrees}: torque or position has the opposite sign in it."
    if finding.torque_factor is not None:
        return f"{disagrees}: its torque is {finding.torque_factor:.3g} times what the same motion takes there."
    if finding.inertia_factor is not None:
        return f"{disagrees}: its inertia is {finding.inertia_factor:.3g} times that there."
    return f"{disagrees}: {', '.join(map(_describe_difference, finding.differences))}."


def _describe_difference(difference: Difference) -> str:
    """Describe the parameter of a recording beside that of others: by a percentage, or by values near zero."""
    share = (difference.value - difference.others) / max(abs(difference.others), 1e-300)
    if abs(share) > 1:
        values = (Quantity(value, unit=difference.unit) for value in (difference.value, difference.others))
        texts = [measure(value, is_parameter=True) for value in values]
        return f"{difference.parameter} {' instead of '.join(texts)}"
    percent = float(f"{100 * abs(share):.2g}")
    return f"{difference.parameter} {percent:g} % {'higher' if share > 0 else 'lower'}"


def _describe_wrong_column(finding: WrongColumn) -> str:
    otherwise = ""
    if finding.column == "load_torque":
        text = "The motion follows load_torque with the opposite sign: a load torque that drives the joint is positive"
    elif finding.joint:
        wrong = "position and torque have the opposite sign of the robot file"
        if finding.angle is not None:
            error = abs(np.degrees(finding.angle.value))
            wrong = f"the zero of the position is {error:.4g} degrees off that of the robot file"
        text = f"{capitalise(finding.joint)}: {wrong}"
        otherwise = "Correct the recording."
    elif finding.inertia is not None:
        inertia, otherwise = measure(finding.inertia, 2), "Give one of them a minus sign."
        text = f"The inertia came out negative ({inertia}): torque and position have opposite signs"
    elif finding.angle is not None:
        text = _describe_zero(finding.angle)
    else:
        text = "The gravity came out negative: position 0 seems to be the upright position, and must be the hanging one"
    options = [
        f"Read {'it' if len(finding.remedies) == 1 else join_words(remedy.recordings)} with "
        f"{format_setting('columns', remedy.columns)} instead."
        for remedy in finding.remedies
    ]
    return " ".join([f"{text}.", *(options or filter(None, [otherwise]))])


def _describe_zero(angle: Quantity) -> str:
    size, error = abs(np.degrees(angle.value)), np.degrees(angle.std)
    digits = int(np.clip(-np.floor(np.log10(max(error, 1e-9))), 0, 3))
    return (
        f"The zero of the position is {size:.{digits}f} ± {error:.{digits}f} degrees off, or the base is tilted by "
        "that angle"
    )


def _describe_negative(finding: NegativeParameters) -> str:
    if "gravity" in finding.parameters:
        return "The gravity came out negative beside a spring: the two cancel, and neither is meaningful."
    names = join_words(finding.parameters)
    return f"{names} came out negative, and no friction drives: another law acts in its place."


def _describe_incomplete(finding: Incomplete) -> str:
    parts = []
    if finding.noise_ratio is not None:
        joints = f" ({join_words(finding.joints)})" if finding.joints else ""
        up_to = "up to " * (len(finding.joints) > 1)
        parts.append(f"the residual is {up_to}{finding.noise_ratio:.2g} times the noise floor{joints}")
    if finding.disagreement is not None:
        up_to = "up to " * (len(finding.parameters) > 1)
        size = f"{up_to}{finding.disagreement:.2g} standard errors"
        parts.append(f"the schemes disagree on {join_words(finding.parameters)} by {size}")
    return f"The model is incomplete: {', and '.join(parts)}. All estimates are biased."


def describe_violations(violations: Mapping[str, Quantity]) -> list[str]:
    """Return a phrase for each violated physical bound, such as "a negative inertia"."""
    sizes = {name: measure(size, is_parameter=True) for name, size in violations.items()}
    return [PHRASES.get(name, f"{name} = {{}}").format(size) for name, size in sizes.items()]


def _describe_residual(finding: ResidualWithoutPlace) -> str:
    size, times = measure(finding.residual, 2), f"{finding.noise_ratio:.2g} times the noise"
    if finding.recording:
        worst = f", most of it in {finding.recording} ({measure(finding.worst, 2)})" if finding.worst else ""
        share = "" if finding.share is None else f", {format_percent(finding.share)} of the motion"
        return f"Simulated from its goal, the servo is off by {size}{share}; this is {times} of the encoder{worst}."
    place = f"The residual is {size}, {times} floor, at no one speed, angle or time."
    return f"{place} Something acts faster than the windows resolve, or rarely."


def _describe_tie(finding: Tie) -> str:
    text = f"{capitalise(name_effects(finding.effects))} look the same in these data"
    reveals = find_description(finding.effects[-1]).informative_experiment
    return f"{text}. To distinguish them, record {reveals}." if reveals else f"{text}."


def describe_untested(finding: UntestedRange) -> str:
    """Return a phrase on the tested range of an effect."""
    low, high = (end and measure(end) for end in (finding.low, finding.high))
    effect = name_effect(finding.effect).removeprefix("a ")
    if low and high:
        text = f"no {effect} was met from {low} to {high}"
    else:
        text = f"no lower {effect} was met down to {low}" if low else f"no upper {effect} was met up to {high}"
    return f"{text}, and contacts beyond cannot be seen"


def describe_law(finding: ExplainingTable) -> str:
    """Name the law that a table represents."""
    power = finding.parameters.get("power")
    return name_effect(finding.table) if power is None else f"friction that grows as |q'|^{power:.2g}"


def _describe_no_known_effect(finding: NoKnownEffect) -> str:
    if not finding.tables:
        return "No library effect explains the rest of the residual. Write your own effect, or keep a table."
    first, *alternatives = finding.tables
    laws = f" Other laws: {join_words(alternatives)}." if alternatives else ""
    command = f"`pendulum-ident add MODEL.json {first} ...`"
    return f"Keep the unknown law as a table, which also shows its shape: {command}.{laws}"


def _describe_contact(finding: Contact) -> str:
    at = f" by {finding.joint}" if finding.joint else ""
    return _fill(
        f"A stop or a blow was met{at} at {{angle:3}} ({{recording}}, {{time:3}}): {{torque:2}} more than the model "
        "predicts. No effect explains the contacts ({count}). To identify a stop, press against it slowly at several "
        "torques; else keep away from it.",
        finding,
    )


def _describe_aims(finding: UnreachableAims) -> str:
    if finding.limits is None:
        return f"No torque would {describe_aims(finding.aims, 'or')}."
    place = "" if finding.place is None else f" and go to {measure(finding.place, 2)}, where the residual is largest"
    names = ["max_angle", "max_speed", *(["max_torque"] if "torque" in finding.limits else [])]  # a free swing has none
    options = ", ".join(format_setting(name, Blank("VALUE")) for name in names)
    return (
        f"No experiment within {list_limits(finding.limits)} would {describe_aims(finding.aims, 'or')}{place}. "
        f"Allow more ({options}) if the rig bears it."
    )


def list_limits(limits: Mapping[str, Quantity]) -> str:
    """List the limits of an experiment in a phrase: `0.5 N m, 2 rad/s and the recorded angles`."""
    sizes = [measure(limits[name]) for name in LIMITS if name in limits and np.isfinite(limits[name].value)]
    recorded = [f"{name}s" for name in ("angle", "speed") if name not in limits]
    return join_words([*sizes, *([f"the recorded {join_words(recorded)}"] if recorded else [])])


def describe_aims(aims: Sequence[Aim], conjunction: str = "and") -> str:
    """Describe the aims of an experiment: `tell a spring from tilted gravity and show whether there is cogging`."""
    texts = [f"tell {name_effect(aim.effect)} from {name_effect(aim.instead)}" for aim in aims if aim.instead]
    if undetermined := [aim.effect for aim in aims if not aim.instead]:
        texts.append(f"show whether there is {name_effects(undetermined, 'or')}")
    return join_words(texts, conjunction)


CORRECT_IT = "Correct it with --align (`align(recordings).recordings` in Python)."
CORRECTED = "It is corrected here; other commands correct it with --align."


def _describe_fall(finding: ErrorFall) -> str:
    if finding.ratio is not None:
        return f"lowers the held-out torque error of {finding.joint} to {finding.ratio:.1%}"
    falls = (f"{FALLS[kind]} {measure_change(change.before, change.after)}" for kind, change in finding.changes.items())
    return f"lowers the held-out errors: {', '.join(falls)}"


def _describe_gates(finding: FailedGates) -> str:
    """Describe the gate that an effect failed, as a phrase about the effect."""
    gates = {gate.name: gate for gate in finding.gates}
    gate = finding.gates[0]
    name, _, at = gate.name.partition("@")
    value, limit = gate.value, gate.limit
    if name in NOT_TRIED:
        return NOT_TRIED[name]
    if name == "residual_over_noise":
        return f"not tried: the residual is {value:.2g} times the noise floor, which counts as noise"
    if "gain" in gates:
        gain, p_value = gates["gain"], gates["p_value"]
        std = f" ± {gain.std:.2g}" if gain.std else ""
        compared = "the selected effects" if finding.selected else "the base model"
        limits = f"{format_p_value(p_value.value)} with a penalty of {gain.limit:.2g} nat, limit {p_value.limit:.2g}"
        return f"gain of {gain.value:.3g}{std} nat over {compared}: {limits}"
    if name == "p_value":
        return "does not lower the held-out errors significantly"
    if name == "excitation":
        return "these data do not depend on it"
    if name in SHARES:
        return f"explains {100 * value:.3g} % of {SHARES[name]}, less than {100 * limit:.3g} %"
    if name == "known_parameters":
        return f"predicts no better than other values of the parameters that were given: {format_p_value(value)}"
    if name == "coefficients":
        return f"not determined: its coefficients may be zero, {format_p_value(value)}, limit {limit:.2g}"
    if name == "residual_in_loop":
        return f"leaves {value:.2g} times the noise floor: in a closed loop, it may fit the controller's answer"
    if name == "frequencies":
        return "not determined: the motion has one frequency, at which it is another inertia and viscous friction"
    if name == "size":
        return "its best fit within physical bounds has zero size"
    if name == "loss_in_motion":
        return f"predicts free motion worse: {format_p_value(value)}, limit {limit:.2g}"
    if name == "kept_gravity":
        return f"fits only with {value:.2g} times the gravity: both terms cancel and imitate a third law"
    if name == "kept_inertia":
        return f"fits only with {value:.2g} times the inertia, less than {limit:.0%}: it imitates inertia"
    if name in HELD_OUT:
        change = measure_change(Quantity(limit, unit=gate.quantity.unit), gate.quantity)
        return f"does not lower the held-out {HELD_OUT[name]} ({change}){f' at {at}' if at else ''}"
    phrases = describe_violations({name: gate.quantity for name, gate in gates.items()})
    return f"would mean {join_words(phrases)}, which no body has"


GAPS: Mapping[Gap, str] = {
    Gap.NO_MOTION: "The joint moves too little to identify any parameter. Record wider or faster motion.",
    Gap.TORQUE_IS_NOISE: (
        "The torque is constant or noise, and the motion does not follow it: only ratios of parameters are known. Read "
        "the file without it ({without_torque})."
    ),
    Gap.TORQUE_FOLLOWS_DIRECTION: (
        "While the joint moves, the torque is {size} along the velocity. One size of torque determines only ratios "
        "of the parameters. Record torques of several sizes, or sines."
    ),
    Gap.ONE_DIRECTION: (
        "The velocity never changes sign, so coulomb and torque_offset cannot be told apart. Record both directions."
    ),
    Gap.SMALL_ANGLES: (
        "The position stays small, within {size:2}: gravity and a spring look the same. Record wider swings."
    ),
    Gap.NEVER_ACTS: "{parameters} never acts in these recordings. Record motion that reaches it.",
    Gap.ACT_ALIKE: "{parameters} cannot be told apart: they act alike in these recordings.",
}
TREATMENTS: Mapping[str, str] = {
    Action.TORQUE_CONSTANT: "The known loads give the torque constant.",
    Action.NARROWER_WINDOWS: "The windows have {share.value:g} of their length.",
    Action.WINDOWS_BY_INERTIA: (
        "Window lengths and noise floor follow from the inertia {inertia:3} of the model, not from {before:3}."
    ),
    Action.IMPACTS_INCLUDED: "Windows in contact with a stop, at reversals or at rest, are included.",
    Action.RECORDINGS_EXCLUDED: "Left out: {recordings}.",
    Action.TIMED_BY_MODEL: "Torque is timed by the fitted model.",
    Action.TIMED_AS_LOGGED: "Torque keeps its time of the log.",
}
SENTENCES: Mapping[type[Finding], Text] = {
    Undetermined: _describe_undetermined,
    RelativeToInertia: lambda finding: (
        "No torque is applied: every parameter is relative to the inertia"
        f"{' of the joint with its known load' if finding.recordings else ''}, which is 1. A known value makes them "
        f"absolute ({format_setting('fixed', {'inertia': Blank('VALUE')})}). "
        "If a motor drives the joint, name the column of its torque."
    ),
    UnknownConstant: _describe_unknown_constant,
    GearLosses: _describe_gear_losses,
    BackEmfInFriction: lambda finding: (
        f"The log has {LOGGED[finding.constant.unit.partition(' ')[0]]}: back-EMF is part of the viscous friction, and "
        f"its constant k_e is at most {measure(finding.constant)}."
    ),
    TorqueTiming: describe_timing,
    Treatment: _describe_treatment,
    StiffStop: (
        "The stop at {angle:3} is pressed in by {depth:2} at most, at too few depths for the error of its end: its "
        "stiffness is unknown. Press it slowly at several torques."
    ),
    UnloggedTorque: (
        "Torque that is not logged moves the joint: white noise of {torque:2} per sample. A missing effect below "
        "{hidden:2} would not show. Log the torque at the motor, or record longer."
    ),
    UnknownScale: (
        "The torque drives {share:.0%} of the motion. Friction of mu times the torque, as in gears, would not "
        "show: all parameters would be 1 / (1 - mu) times too large. To see it, let gravity or a load turn the motor."
    ),
    SmallEffect: lambda finding: (
        f"{capitalise(name_effect(finding.effect))} may be missing: it predicts better "
        f"({format_p_value(finding.p_value)}), but explains only {100 * finding.share:.2g} % of the residual or of the "
        f"motion error, less than {100 * finding.least:.2g} %."
    ),
    Feedback: (
        "{begin} torque reacts to the motion ({gain:2} between samples). "
        "Reactions of a controller may be taken for physics. "
        "Record a planned torque, or describe the controller by `--drive`, with its goals in the column `reference`."
    ),
    Disagreement: _describe_disagreement,
    FewWindows: (
        "Only {count} stretches of motion are clear of stick, and many effects would not show. Record longer, "
        "faster or wider motion."
    ),
    UnevenClock: (
        "The clock may cause the residual: time steps in {recording} scatter by {std:2} about {period:3}, and no "
        "uniform clock fits them. Log the time or the number of each sample where it is taken."
    ),
    SlowedFilter: (
        "At {rate.value:.4g} Hz the filters would pass everything: their cutoff is lowered to {rate.value:.4g} rad/s."
    ),
    CoarseEncoder: (
        "Noise of the position has more than half of the acceleration's information: estimates of some schemes are "
        "biased. Record faster motion, or with a finer encoder."
    ),
    WrongColumn: _describe_wrong_column,
    NegativeParameters: _describe_negative,
    Incomplete: _describe_incomplete,
    Tie: _describe_tie,
    PartOfTurn: (
        "The motion covers {angle:2}, less than a turn. Gravity is right only if the law of {effects} is exact: "
        "another law of the angle, or a wrong scale of the angle, fits alike. Record a whole turn, or give the value "
        "of gravity ({fix_gravity})."
    ),
    UntestedRange: lambda finding: f"{capitalise(describe_untested(finding))}.",
    ExplainingTable: lambda finding: (
        f"{capitalise(describe_law(finding))} would explain most of the residual. No effect of the library "
        "explains it in these data."
    ),
    ErrorNearReversals: (
        "The torque fits where the joint moves freely, but free-running simulation of the fitted data errs by "
        "{error:2}: something acts near reversals or at rest."
    ),
    Contact: _describe_contact,
    ResidualWithoutPlace: _describe_residual,
    NoKnownEffect: _describe_no_known_effect,
    HeldOutResidual: (
        "The model explains the fitted data, but not the held-out data ({recordings}). If both are of one machine, "
        "fit both."
    ),
    UnknownInertia: lambda finding: (
        f"The motion of an experiment cannot be predicted without the inertia. {advise_inertia()}"
    ),
    UnreachableAims: _describe_aims,
}
REASONS: Mapping[type[Finding], Text] = {  # phrases about an effect
    ErrorFall: _describe_fall,
    Tie: lambda finding: f"predicts as well as {name_effect(finding.effects[0])}",
    Imitation: lambda finding: (
        f"imitates {name_effect(finding.effect)} in these data" if finding.effect else "others explain it better"
    ),
    ExplainingTable: lambda finding: f"explains less than {describe_law(finding)} as a table does",
    UntestedRange: describe_untested,
    Contact: "may be met at {angle:3}, in contacts that do not determine it",
    FailedGates: _describe_gates,
}
