"""Results as they show themselves in a notebook."""

from __future__ import annotations

import numpy as np

from estimators.online.estimates import SchemeEstimate, SchemeEstimates
from estimators.schemes.fitting import Identified
from estimators.schemes.result import Identification
from pendulum_env.formatting import TextTable, format_estimate, format_unit, join_words
from pendulum_env.notebook import BLUE, GREEN, ORANGE, render_html
from pendulum_env.notebook import summarise as headlines
from pendulum_env.physics import Model
from pendulum_env.recording import NEWTON_METRE, Note
from pendulum_env.recording.record import Recording
from pendulum_env.units import to_shown_unit
from workbench.narrator.html import PlotCurve, make_bullets, make_card, make_note, make_paragraph, make_plot, make_table
from workbench.narrator.identification import explain_trust, list_warnings, tabulate_schemes
from workbench.narrator.notebook_results import note_constant
from workbench.narrator.notes import describe_note
from workbench.narrator.tables import tabulate_parameters

headlines.register(Note, describe_note)


@headlines.register
def describe_identification(found: Identification) -> str:
    """Write the estimates of the schemes as a table of text, and a line for each warning."""
    header, rows, _ = tabulate_schemes(found)
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    lines = ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in (header, *rows)]
    return "\n".join([*lines, *(f"warning: {text}" for text in list_warnings(found))])


@render_html.register
def show_identification(found: Identification) -> str:
    """Show the estimates of the schemes side by side, and what the recordings cannot tell."""
    estimates = tabulate_schemes(found)
    return make_card(
        f"Estimates from {join_words(found.recordings)}",
        *note_constant(found.torque_constant),
        make_table(estimates),
        make_note("± is one standard error of noise: where schemes differ by more, the model lacks something."),
        make_note(explain_trust(estimates)),
        make_bullets(f"warning: {text}" for text in list_warnings(found)),
    )


@render_html.register
def show_recording(recording: Recording) -> str:
    """Show a recording: length and rate, what was changed at reading, what it lacks, and its curves."""
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
        make_plot(f"{label} [{format_unit(symbol)}] over {recording.duration:.3g} s", recording.time, curves)
        for label, values, symbol, color in signals
        for curves in [[PlotCurve(own, color) for own in np.atleast_2d(values.T)]]  # a joint each
    ]
    return make_card(f"Recording {recording.name}", make_paragraph(recording.summary), make_bullets(lines), *plots)


@render_html.register
def show_identified(found: Identified) -> str:
    """Show the estimates of one scheme."""
    rows = [(name, e.shown.text, e.shown.unit) for name, e in found.model.estimates.items()]
    used, all_of_them = found.used
    return make_card(
        f"Estimates by the scheme {found.scheme}",
        make_table(TextTable(("parameter", "estimate", "unit"), rows, left=("unit",))),
        make_note(f"residual {found.residual_rms:.3g} {found.unit}, {used} of {all_of_them} samples used"),
    )


@render_html.register
def show_model(model: Model) -> str:
    """Show the torque balance and the parameters of a model."""
    law = " + ".join(term.law for term in model.terms)
    title = f"Model with {join_words([term.id for term in model.terms])}"
    return make_card(title, make_paragraph(f"torque = {law}"), make_table(tabulate_parameters(model)))


@render_html.register
def show_estimates(found: SchemeEstimates) -> str:
    """Render the estimates of several schemes; of a batch, those of the first plant."""
    schemes = {id: own for id, own in found.items() if isinstance(own, SchemeEstimate)}
    units = {name: of for own in schemes.values() for name, of in own.units.items()}
    rows = []
    for id, own in schemes.items():
        theta = np.atleast_2d(own["theta"])[0]
        variance = np.diagonal(own["covariance"], axis1=-2, axis2=-1).reshape(-1, len(theta))[0]
        std = np.sqrt(np.maximum(variance, 0.0))
        known = {name: format_estimate(*pair) for name, *pair in zip(own.units, theta, std, strict=True)}
        rows.append((id, *(known.get(name, "") for name in units)))
    batch = [len(own["theta"]) for own in schemes.values() if np.ndim(own["theta"]) > 1]
    return make_card(
        "Online estimates",
        make_table(TextTable(("scheme", *(f"{name} [{of}]" for name, of in units.items())), rows)),
        make_note(f"of the first of {batch[0]} pendulums" if batch else ""),
    )
