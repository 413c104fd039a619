"""Representations of results in a notebook."""

import numpy as np

from estimators import Addition, Comparison, Diagnosis, Identification
from estimators.decisions.errors import get_single
from estimators.diagnosis.suggestion import Suggestion
from estimators.findings import Finding
from estimators.online.estimates import SchemeEstimate, SchemeEstimates
from estimators.schemes.fitting import Identified
from estimators.signals.residual import Region
from pendulum_env.formatting import TextTable, capitalise, join_words, measure_range
from pendulum_env.notebook import BLUE, GREEN, ORANGE, render_html, render_text, summarise
from pendulum_env.physics import Model
from pendulum_env.recording import NEWTON_METRE, Note, Recording, TorqueConstant
from pendulum_env.units import to_shown_unit
from workbench.narrator import results
from workbench.narrator.diagnosis import (
    describe_addition,
    describe_comparison,
    describe_region,
    describe_result,
    describe_suggestion,
    list_laws,
)
from workbench.narrator.findings import describe
from workbench.narrator.html import PlotCurve, make_card, make_plot
from workbench.narrator.identification import explain_trust, list_warnings, tabulate_schemes
from workbench.narrator.notes import describe_note
from workbench.narrator.parts import format_parts
from workbench.narrator.tables import tabulate_parameters

summarise.register(Note, describe_note)
summarise.register(Comparison, describe_comparison)
summarise.register(Diagnosis, describe_result)
summarise.register(Addition, describe_addition)
summarise.register(Finding, describe)
summarise.register(Suggestion, describe_suggestion)
summarise.register(Region, describe_region)
render_text.register(Diagnosis, lambda diagnosis: format_parts([results.narrate_summary(diagnosis)]))
render_text.register(Comparison, lambda comparison: format_parts(results.narrate_comparison(comparison)))
render_text.register(Addition, lambda addition: format_parts(results.narrate_addition(addition)))


@summarise.register
def describe_identification(identification: Identification) -> str:
    """Return the estimates of the schemes as a plain-text table, and a line for each warning."""
    warnings = (f"warning: {text}" for text in list_warnings(identification))
    return "\n".join([str(tabulate_schemes(identification)), *warnings])


@render_html.register
def show_identification(identification: Identification) -> str:
    """Render the estimates of the schemes and warnings as HTML."""
    estimates = tabulate_schemes(identification)
    return make_card(
        f"Estimates from {join_words(identification.recordings)}",
        note_constant(identification.torque_constant),
        estimates,
        "± is one standard error of noise: where schemes differ by more, the model lacks something.",
        explain_trust(estimates),
        tuple(f"warning: {text}" for text in list_warnings(identification)),
    )


@render_html.register
def show_recording(recording: Recording) -> str:
    """Render a recording as HTML: summary, notes and curves."""
    signals = [
        ("position q", *to_shown_unit(recording.position, recording.units.unit("rad")), BLUE),
        (recording.units.name("torque"), recording.torque, recording.units.unit(NEWTON_METRE), ORANGE),
    ]
    if recording.velocity is not None:
        velocity = to_shown_unit(recording.velocity, recording.units.unit("rad/s"))
        signals.insert(1, ("velocity q'", *velocity, GREEN))
    lines = [describe_note(note) for note in recording.notes]
    if not recording.torque.any():
        lines.append("torque is never applied: only ratios of parameters can be known")
    plots = [
        make_plot(f"{label} [{symbol}] over {recording.duration:.3g} s", recording.time, curves)
        for label, values, symbol, color in signals
        for curves in [[PlotCurve(series, color) for series in np.atleast_2d(values.T)]]  # one curve for each joint
    ]
    return make_card(f"Recording {recording.name}", recording.summary, tuple(lines), *plots)


@render_html.register
def show_identified(identified: Identified) -> str:
    """Render the estimates of one scheme as HTML."""
    rows = [(name, e.shown.text, e.shown.unit) for name, e in identified.model.estimates.items()]
    count, all_of_them = identified.used
    return make_card(
        f"Estimates by the scheme {identified.scheme}",
        TextTable(("parameter", "estimate", "unit"), rows, left=("unit",)),
        f"residual {identified.residual_rms:.3g} {identified.unit}, {count} of {all_of_them} samples used",
    )


@render_html.register
def show_model(model: Model) -> str:
    """Render the torque balance and the parameters of a model as HTML."""
    law = " + ".join(term.law for term in model.terms)
    title = f"Model with {join_words([term.id for term in model.terms])}"
    return make_card(title, f"torque = {law}", tabulate_parameters(model))


@render_html.register
def show_estimates(estimates: SchemeEstimates) -> str:
    """Render the estimates of several schemes as HTML; for a batch, those of the first plant."""
    schemes = {id: scheme for id, scheme in estimates.items() if isinstance(scheme, SchemeEstimate)}
    units = {name: unit for scheme in schemes.values() for name, unit in scheme.units.items()}
    values = {id: scheme.format() for id, scheme in schemes.items()}
    rows = [(id, *(texts.get(name, "") for name in units)) for id, texts in values.items()]
    batch = [scheme.count for scheme in schemes.values() if scheme.count is not None]
    return make_card(
        "Online estimates",
        TextTable(("scheme", *(f"{name} [{unit}]" for name, unit in units.items())), rows),
        f"of the first of {batch[0]} pendulums" if batch else "",
    )


@render_html.register
def show_comparison(comparison: Comparison) -> str:
    """Render the errors of a model and the regions of its residual as HTML."""
    units = comparison.model.units()
    torque = f"{units.name('torque')} [{units.unit(NEWTON_METRE)}]"
    plots = [
        make_plot(
            f"{'amplitude of the' if item.is_spectrum else 'mean'} residual {torque} "
            f"over {item.axis}, {measure_range(item.edges[0], item.edges[-1], item.unit)}",
            item.middle,
            [PlotCurve(item.mean, ORANGE)],
            noise=item.band,
        )
        for item in comparison.profiles
    ]
    return make_card(
        describe_comparison(comparison),
        note_constant(comparison.torque_constant),
        *results.narrate_comparison(comparison, is_drawn=True),
        *plots,
        "A mean outside the grey band exceeds the noise." if plots else "",
    )


@render_html.register
def show_diagnosis(diagnosis: Diagnosis) -> str:
    """Render a diagnosis as HTML: result, errors, parameters, ranking, unexplained residual and next step."""
    parts = [
        *results.narrate_disagreements(diagnosis.disagreements),
        *sorted(results.narrate_diagnosis(diagnosis), key=lambda part: not part.brief),
        *results.narrate_next_step(diagnosis),
    ]
    return make_card(
        describe_result(diagnosis), note_constant(diagnosis.torque_constant), tuple(list_laws(diagnosis)), *parts
    )


@render_html.register
def show_addition(addition: Addition) -> str:
    """Render an addition as HTML: errors before and after, conclusion, and parameters."""
    noise = results.describe_noise(addition.before, floor) if np.isfinite(floor := get_single(addition.floors)) else ""
    return make_card(f"The model with {addition.after.added}", noise, *results.narrate_addition(addition))


def note_constant(constant: TorqueConstant | None) -> str:
    """State the torque constant; empty without one."""
    return "" if constant is None else f"{capitalise(constant.text)}; standard errors include that of it."
