"""Texts of comparisons, diagnoses and additions, and JSON content with texts."""

from collections.abc import Sequence

import numpy as np

from estimators.decisions.errors import Step
from estimators.diagnosis.contacts import Contact
from estimators.diagnosis.result import Addition, Detectable, Diagnosis, HorizonRefit, TriedTreatment
from estimators.diagnosis.small_effect import SmallEffect
from estimators.diagnosis.suggestion import Suggestion
from estimators.findings import Finding, Quantity, withhold_everything
from estimators.results import Comparison
from estimators.signals.residual import SPECTRA, SYMBOLS, Region
from pendulum_env._typing import JSON
from pendulum_env.excitation import encode_signal
from pendulum_env.formatting import capitalise, format_percent, join_words, measure, measure_change, measure_range
from pendulum_env.physics.effect_texts import find_description, name_effects
from pendulum_env.physics.term import list_loads
from pendulum_env.recording import NEWTON_METRE, NoteKind
from pendulum_env.units import show_angles, to_shown_unit
from workbench.narrator.findings import (
    ERRORS,
    advise_inertia,
    describe,
    describe_aims,
    describe_cause,
    describe_reason,
)

NO_EXPERIMENT = "No experiment is suggested."
CLOSE = 0.01  # largest error in the loop of a useful model, relative to the range of the motion
WRONG_DRIVE = 5.0  # error in the loop that indicates wrong settings of the drive [noise floors]
SIGNIFICANT = 3.0  # smallest significant size of a table [standard errors]
COUNTABLE = 100.0  # largest printed significance [standard errors]
BROAD = 1.5  # ratio of the ends of a broad range of frequencies


def describe_region(region: Region) -> str:
    """Describe the residual in a region; empty without a cause, a profile or held-out recordings."""
    texts = [] if region.cause is None else [describe(region.cause)]
    if region.is_profiled:
        texts.append(_describe_stretch(region))
    text = " ".join(texts)
    if not region.held_out_recordings:
        return text
    place = f"In the held-out data ({join_words(region.held_out_recordings)})"
    return f"{place}: {text[:1].lower()}{text[1:]}" if text else f"{place}, at no one speed, angle or time."


def _describe_stretch(region: Region) -> str:
    """Describe the residual of a profile between two values of its axis."""
    quantity, unit = region.units.name("torque"), region.units.unit(NEWTON_METRE)
    significance = f"{region.significance:.0f}" if region.significance <= COUNTABLE else f"more than {COUNTABLE:g}"
    size, error = f"{abs(region.residual):.3g} {unit}", f"({significance} standard errors)"
    if region.axis in SPECTRA:
        peak = 0.5 * (region.low + region.high) if region.peak is None else region.peak
        unit_at_peak = region.unit.replace("periods", "period") if peak == 1 else region.unit
        place = f"Around {peak:.3g} {unit_at_peak} the residual oscillates by {size} {error}"
        is_broad = region.high > BROAD * region.low
        among = measure_range(region.low, region.high, region.unit)
        return f"{place}, the largest amplitude from {among}." if is_broad else f"{place}."
    place = f"For {SYMBOLS[region.axis]} from {measure_range(region.low, region.high, region.unit)}"
    place = "Everywhere" if region.is_constant else place
    side = "more" if region.residual > 0 else "less"
    return f"{place} the joint needs {size} {side} {quantity} than the model says {error}."


def describe_unexplained(diagnosis: Diagnosis, region: Region) -> str:
    """Describe the unexplained residual in a region; for an arm with its size and joint."""
    text = describe_region(region)
    if region.at not in diagnosis.joint_residuals:
        return text
    unit = get_error_unit(diagnosis, region.at)
    residual = f"{diagnosis.joint_residuals[region.at]:.2g} {unit} at {region.at}"
    return f"{residual}; {text}" if text else residual


def describe_suggestion(suggestion: Suggestion) -> str:
    """Describe a suggested experiment."""
    units = suggestion.units
    aims = describe_aims(suggestion.settles)
    angle, speed = units.unit("rad"), measure(Quantity(suggestion.peak_speed, unit=units.unit("rad/s")), 2)
    if suggestion.signal is None:
        return (
            f"To {aims}: let the joint go at rest at {measure(Quantity(suggestion.release or 0.0, unit=angle))} and "
            f"record {suggestion.seconds:g} s without {units.name('torque')}, with up to {speed} to be expected."
        )
    kind = encode_signal(suggestion.signal)["kind"].replace("_", " ")
    return (
        f"To {aims}: record {suggestion.seconds:g} s of {kind} {units.name('torque')} up to "
        f"{suggestion.peak_torque:.2g} {units.unit(NEWTON_METRE)}, with {units.name('angle')}s from "
        f"{measure_range(*suggestion.reach, angle, 2)} and up to {speed} to be expected (`record --excitation "
        "suggested` plays it)."
    )


def has_searched(diagnosis: Diagnosis) -> bool:
    """Return whether effects were searched."""
    return bool(diagnosis.candidates or diagnosis.joint_residuals)


def get_error_unit(diagnosis: Diagnosis, joint: str) -> str:
    """Return the unit of the error at a joint: of torque, of current, or of motion in the loop."""
    return diagnosis.model.units(joint).unit(diagnosis.steps[0].errors["holdout"].unit)


def list_laws(diagnosis: Diagnosis) -> list[str]:
    """List the laws of the selected effects: `stribeck: fs exp(-|q'/vs|^n) sgn q'`."""
    known = {term.id: term.law for term in diagnosis.model.terms}
    return [f"{id}: {known[id]}" for id in diagnosis.selected if id in known]


def describe_result(diagnosis: Diagnosis) -> str:
    """State the result in a phrase: `Stribeck friction is missing`, `Cogging at elbow is missing`."""
    joints = join_words([at for at in dict.fromkeys(region.at for region in diagnosis.unexplained) if at])
    place = f" at {joints}" if joints else ""
    groups = [cause for finding in diagnosis.findings if (cause := describe_cause(finding))]
    unconfirmed = diagnosis.list_unconfirmed(diagnosis.selected)
    groups += [name_effects(group, "or") for group in diagnosis.effects if group[0] not in unconfirmed]
    if has_searched(diagnosis) and diagnosis.unexplained and diagnosis.steps[0].errors["holdout"].is_of_motion:
        before, after = (diagnosis.steps[k].errors["holdout"].motion_errors[0] for k in (0, -1))
        last, floors = diagnosis.steps[-1].errors["holdout"], diagnosis.floors
        sizes = {at: (last.get_joint_error(at), last.get_share(at) or 0.0) for at in floors}
        is_coarse = any(size > WRONG_DRIVE * floors[at] and share > CLOSE for at, (size, share) in sizes.items())
        if is_coarse and after > before / 3:  # effects do not explain wrong settings of the drive
            verb = "explains" if len(groups) == 1 else "explain"
            part = f". {capitalise(join_words(groups))} {verb} {1 - after / before:.0%} of the error" if groups else ""
            return f"The servo as described does not reproduce the log{_name_worst_joint(diagnosis)}{part}"
    if withhold_everything(diagnosis.findings) or diagnosis.model.is_undetermined:
        return "These recordings do not determine the parameters"
    if groups and not has_searched(diagnosis):
        return describe_fall(diagnosis)
    contacts = [finding for finding in diagnosis.findings if isinstance(finding, Contact)]
    places = [f"{f' by {contact.joint}' * bool(contact.joint)} at {measure(contact.angle)}" for contact in contacts]
    met = [f"a stop or a blow was met{where_met}" for where_met in places]
    if groups:
        place += _name_worst_joint(diagnosis)
        remainder = f", and more{place} that no known effect explains" if diagnosis.unexplained else ""
        remainder = remainder or "".join(f", and {text}" for text in met)
        return f"{capitalise(join_words(groups))} {'is' if len(groups) == 1 else 'are'} missing{remainder}"
    if met:
        remainder = "no known effect explains the rest" if diagnosis.unexplained else "nothing else is missing"
        return f"{capitalise(join_words(met))}, and {remainder}"
    if not diagnosis.unexplained:
        return "Nothing is missing" if has_searched(diagnosis) else "The model explains what was measured"
    if has_searched(diagnosis):
        return f"Something is missing{place}{_name_worst_joint(diagnosis)}, and no known effect explains it"
    return f"Something is missing{place or ' in this model'}"


def describe_unconfirmed(diagnosis: Diagnosis, effects: Sequence[str]) -> str:
    """State which effects in a model a search did not select, as the end of a headline; empty without any."""
    names = diagnosis.list_unconfirmed(effects)
    return f"; the diagnosis does not confirm {name_effects(names)}, added by hand" if names else ""


def describe_fall(diagnosis: Diagnosis) -> str:
    """State in a phrase how the added effects change the held-out error, at the joint with the largest fall."""
    first, last = (diagnosis.steps[k].errors["holdout"] for k in (0, -1))
    ratio, joint = max((first.get_joint_error(at) / last.get_joint_error(at), at) for at in diagnosis.floors)
    smaller, at = measure(Quantity(max(ratio, 1.0)), 2), f" of {joint}" if joint else ""
    change = "not smaller" if smaller == "1" else f"{smaller} times smaller"
    return f"With {name_effects(diagnosis.selected)} the torque error{at} is {change}"


def _name_worst_joint(diagnosis: Diagnosis) -> str:
    """Name the joint of an arm of servos with the largest held-out error; empty for other machines."""
    last = diagnosis.steps[-1].errors["holdout"]
    if len(diagnosis.floors) < 2 or not last.is_of_motion:
        return ""
    worst = max(diagnosis.floors, key=last.get_joint_error)
    size = Quantity(last.get_joint_error(worst), unit=get_error_unit(diagnosis, worst))
    return f", most at {worst} ({measure(size, 2)})"


def describe_errors(diagnosis: Diagnosis) -> str:
    """State the held-out errors before and after with the noise floor, and the part held out by default."""
    first, last = (step.errors["holdout"] for step in (diagnosis.steps[0], diagnosis.steps[-1]))
    kind, source = ("in the loop", "encoder noise") if last.is_of_motion else ("torque", "noise floor")

    def format_fall(before: float, after: float, unit: str) -> str:
        is_new = len(diagnosis.steps) > 1 and not (np.isnan(before) and np.isnan(after))
        old, new = Quantity(before, unit=unit), Quantity(after, unit="" if np.isnan(after) else unit)
        return measure_change(old, new, 4) if is_new else measure(new, 4)

    units = {at: get_error_unit(diagnosis, at) for at in diagnosis.floors}
    floors = {at: to_shown_unit(floor, units[at])[0] for at, floor in diagnosis.floors.items()}
    changes = {at: format_fall(first.get_joint_error(at), last.get_joint_error(at), unit) for at, unit in units.items()}
    shares = {at: last.get_share(at) if last.is_of_motion else None for at in floors}
    practical = {
        at: "" if share is None else f", {format_percent(share)} of the motion" for at, share in shares.items()
    }
    falls = [f"{at or kind} {changes[at]} ({source} {floor:.3g}{practical[at]})" for at, floor in floors.items()]
    if diagnosis.model.mechanism.can_simulate and not last.is_of_motion:
        angle = diagnosis.model.units().unit("rad")
        falls.append(f"free-running position {format_fall(first.position_rms, last.position_rms, angle)}")
    part = " (last 30 %)" if diagnosis.data is not None and not diagnosis.data.holdout else ""
    return f"held-out error{part}: {', '.join(falls)}"


def describe_refit(refit: HorizonRefit) -> str:
    """Describe a refit to free motion by its held-out errors, and whether it was kept."""
    unit, over = refit.before.model.units().unit("rad"), f"over {refit.seconds:g} s"
    before = Quantity(refit.before.errors["holdout"].position_rms, unit=unit)
    if refit.after is None:
        error_text = f"The held-out error of free motion {over} is {measure(before, 4)}"
        return f"{error_text}. Noise explains the error of the fitted motion, and the model is not refitted."
    after = Quantity(refit.after.errors["holdout"].position_rms, unit=unit)
    end = "was interrupted. It " if refit.is_interrupted else ""
    change = measure_change(before, after, 4)
    text = f"The refit to free motion {end}changes the held-out position error {over}: {change}"
    if refit.is_kept:
        return f"{text}. The final model is the refitted one."
    failed = next(gate for gate in refit.decision.gates if not gate.passed)
    reasons = {
        "loss_p_value": f"Held-out torque is predicted significantly worse (p = {failed.value:.2g})",
        "holdout_position": "The error is not lower",
    }
    return f"{text}. {reasons.get(failed.name, 'No body can have the parameters')}, and the model is not changed."


def describe_treatment(treatment: TriedTreatment) -> str:
    """Describe a treatment of the recordings, the test that decided on it, and whether it was kept."""
    decisive = next((gate for gate in treatment.decision.gates if not gate.passed), treatment.decision.gates[0])
    name, value, limit, _ = decisive.cells
    return (
        f"{describe(treatment.treatment)} With {treatment.assumptions} instead of {treatment.before} assumptions, "
        f"{name} is {value} (limit {limit}): {'kept' if treatment.is_kept else 'not kept'}."
    )


def describe_detectable(detectable: Detectable) -> str:
    """Return the detectable sizes: `above 0.05 N m`, `from -1.2 to 0.9 rad`, or `not excited`."""
    if not detectable.is_excited:
        return "not excited"
    if detectable.between is not None:
        return f"from {measure_range(*detectable.between, detectable.unit)}"
    unit = "" if detectable.unit == "1" else detectable.unit
    return f"above {measure(Quantity(detectable.above or 0.0, unit=unit), 2, is_parameter=True)}"


def describe_next_step(diagnosis: Diagnosis) -> str:
    """Describe the next experiment, or state why none is suggested."""
    if contacts := [describe(finding) for finding in diagnosis.findings if isinstance(finding, Contact)]:
        return contacts[0]
    if diagnosis.suggestion is not None:
        return describe_suggestion(diagnosis.suggestion)
    if diagnosis.no_experiment is not None:
        return describe(diagnosis.no_experiment)
    if any(isinstance(finding, SmallEffect) for finding in diagnosis.findings):
        return "Record again, and hold the new recording out: it shows whether the small effect repeats."
    if open_findings := [finding for finding in diagnosis.findings if finding.is_open]:
        return describe(open_findings[0])
    hidden = [size.effect for size in diagnosis.detectable if not size.is_excited]
    if hidden:
        experiments = join_words(list(dict.fromkeys(find_description(id).informative_experiment for id in hidden)))
        return f"These recordings cannot show {name_effects(hidden, 'or')}, whatever the size: record {experiments}."
    return NO_EXPERIMENT


def list_advice(diagnosis: Diagnosis) -> list[str]:
    """List the findings of a diagnosis and the suggested experiment, a text each."""
    texts = _list_implausible(diagnosis)
    texts += [describe(finding) for finding in diagnosis.findings if finding not in diagnosis.disagreements]
    texts += [describe_next_step(diagnosis)] if diagnosis.suggestion is not None else []
    texts += [describe(diagnosis.no_experiment)] if diagnosis.no_experiment is not None else []
    return list(dict.fromkeys(texts))


def _list_implausible(diagnosis: Diagnosis) -> list[str]:
    """List the notes of a search on implausible values in the recordings."""
    if not has_searched(diagnosis) or diagnosis.data is None:
        return []
    notes = [note for recording in diagnosis.data.recordings for note in recording.notes]
    return [note.text for note in notes if note.kind is NoteKind.IMPLAUSIBLE]


def list_remarks(diagnosis: Diagnosis) -> list[str]:
    """List the advice without the next step."""
    step = describe_next_step(diagnosis)
    return [text for text in list_advice(diagnosis) if text != step]


def describe_comparison(comparison: Comparison) -> str:
    """State the error of the model in one sentence."""
    errors = comparison.joint.errors
    times, at = max((errors.joints[at] / max(floor, 1e-300), at) for at, floor in comparison.joint.floors.items())
    units, place = comparison.model.units(at), f" at {at}" if at else ""
    error = f"{errors.joints[at]:.3g} {units.unit(NEWTON_METRE)}{place}"
    text = f"The model is off by {error}, {times:.2g} times the noise floor"
    if np.isnan(errors.position_rms):
        return text
    position = measure(Quantity(errors.position_rms, unit=units.unit("rad")))
    return f"{text}, and by {position} in free run over {comparison.horizon:g} s"


def describe_unstable(comparison: Comparison) -> str | None:
    """State which windows are left out of the free-running error, or that it is unknown; None if all count."""
    if not comparison.model.has_known_inertia:
        return f"The free-running position is unknown, as the inertia of the model is. {advise_inertia()}"
    share = comparison.joint.unstable
    if share == 0:
        return None
    windows = f"windows of {comparison.horizon:g} s"
    text = f"In {format_percent(share)} of the {windows} a small error grows tenfold, as with the arm upright"
    return f"{text}: there are no others." if share == 1 else f"{text}: these are not counted in free run."


def describe_loop(comparison: Comparison) -> str | None:
    """State the error in the loop; None if the loop was not simulated."""
    error = Quantity(comparison.joint.errors.total, unit=comparison.model.units().unit("rad"))
    text = f"Simulated from its goals alone, the model is off by {measure(error)} on average."
    return text if comparison.joint.errors.is_of_motion else None


def describe_addition(addition: Addition) -> str:
    """State whether the effect lowers the held-out errors."""
    if addition.objection is not None:
        objection = describe(addition.objection)
        return f"{addition.after.added} {objection}: these recordings give no reason to keep it."
    before, after = addition.before.errors["holdout"], addition.after.errors["holdout"]
    joint = next(iter(list_loads((addition.after.added or "").partition("@")[2])))
    shares = {kind: after.get_error(kind) / before.get_error(kind) for kind in after.kinds if kind in before.kinds}
    shares[next(iter(shares))] = after.get_joint_error(joint) / before.get_joint_error(joint)
    falls = [f"{ERRORS[kind]}{f' at {joint}' if joint else ''} to {share:.1%}" for kind, share in shares.items()]
    return f"{addition.after.added} lowers the held-out errors: {', '.join(falls)} of before."


def describe_table(step: Step) -> str | None:
    """State if an added table is insignificant, or coarse where data are few; None if neither, and for an effect."""
    tables = step.model.tables
    if step.added not in tables:
        return None
    table, curve = tables[step.added]
    if np.mean(curve.value**2) < (SIGNIFICANT * np.median(curve.std)) ** 2:  # median: errors may be large at the ends
        return f"The standard errors of {step.added} are nearly as large as the table itself."
    merged, knots = len(table.extent.merged), table.extent.pieces - 1
    return f"{step.added} leaves out {merged} of {knots} inner knots, where data are few." if merged else None


@show_angles("rad")
def write_comparison(comparison: Comparison) -> JSON:
    """Return the content of `compare --json`: results, with texts of regions and findings."""
    data = comparison.json()
    for entry, region in zip(data["regions"], comparison.regions, strict=True):
        entry["text"] = describe_region(region)
    _add_texts(data["findings"], comparison.findings)
    return data


def _add_texts(entries: Sequence[JSON], findings: Sequence[Finding]) -> None:
    """Add to entries of JSON the texts of their findings."""
    for entry, finding in zip(entries, findings, strict=True):
        entry["text"] = describe(finding)


@show_angles("rad")
def write_addition(addition: Addition) -> JSON:
    """Return the content of `add --json`: results, the conclusion in words, and findings with their texts."""
    data = addition.json() | {"text": describe_addition(addition)}
    _add_texts(data["findings"], addition.findings)
    return data


@show_angles("rad")
def write_diagnosis(diagnosis: Diagnosis) -> JSON:
    """Return the content of `diagnose --json`: results and findings with their texts."""
    data = diagnosis.json()
    for entry, candidate in zip(data["candidates"], diagnosis.candidates, strict=True):
        entry["reason"] = describe_reason(candidate)
    _add_texts(data["findings"], diagnosis.findings)
    _add_texts(data["treatments"], [tried.treatment for tried in diagnosis.treatments])
    data["notes"] = _list_implausible(diagnosis)
    if diagnosis.no_experiment is not None:
        data["no_experiment"]["text"] = describe(diagnosis.no_experiment)
    for entry, region in zip(data["regions"], diagnosis.unexplained, strict=True):
        entry["text"] = describe_region(region)
    data["unexplained"]["where"] = (
        "; ".join(describe_unexplained(diagnosis, region) for region in diagnosis.unexplained) or None
    )
    if diagnosis.suggestion is not None:
        data["suggestion"]["text"] = describe_suggestion(diagnosis.suggestion)
    if diagnosis.refit is not None:
        data["horizon"]["text"] = describe_refit(diagnosis.refit)
    return data
