"""Comparisons, diagnoses and additions as they show themselves in a notebook."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from estimators.diagnosis.result import Addition, Diagnosis
from estimators.results import Comparison
from estimators.selection.errors import get_single
from pendulum_env.formatting import TextTable, capitalise
from pendulum_env.notebook import ORANGE, render_html
from pendulum_env.notebook import summarise as headlines
from pendulum_env.recording import NEWTON_METRE, TorqueConstant
from workbench.narrator import comparison
from workbench.narrator.addition import describe_addition
from workbench.narrator.diagnosis import describe_next_step, describe_result, list_advice, list_remarks
from workbench.narrator.findings import measure_range
from workbench.narrator.html import (
    Html,
    PlotCurve,
    make_bullets,
    make_card,
    make_details,
    make_heading,
    make_note,
    make_plot,
    make_table,
)
from workbench.narrator.parts import Part
from workbench.narrator.results import (
    NEXT,
    describe_noise,
    narrate_addition,
    narrate_comparison,
    narrate_diagnosis,
    narrate_disagreements,
)

headlines.register(Comparison, comparison.describe_comparison)
headlines.register(Diagnosis, describe_result)
headlines.register(Addition, describe_addition)


@render_html.register
def show_comparison(found: Comparison) -> str:
    """Show the errors of a model, and where it fails."""
    units = found.model.units()
    torque = f"{units.name('torque')} [{units.unit(NEWTON_METRE)}]"
    plots = [
        make_plot(
            f"{'amplitude of the' if item.axis == 'frequency' else 'mean'} residual {torque} "
            f"over {item.axis}, {measure_range(item.edges[0], item.edges[-1], item.unit)}",
            0.5 * (item.edges[1:] + item.edges[:-1]),
            [PlotCurve(item.mean, ORANGE)],
            noise=2 * item.error,
        )
        for item in found.profiles
    ]
    return make_card(
        comparison.describe_comparison(found),
        *note_constant(found.torque_constant),
        *_render_parts(narrate_comparison(found, is_drawn=True)),
        *plots,
        make_note("The band is two standard errors of noise." if plots else ""),
    )


@render_html.register
def show_diagnosis(found: Diagnosis) -> str:
    """Show the story of a diagnosis: what is missing, how far the errors fall, parameters, ranking, what stays open."""
    laws = tuple(found.laws)
    texts = (describe_next_step(found), *list_remarks(found)) if found.candidates else tuple(list_advice(found))
    parts = [
        *narrate_disagreements(found.disagreements),
        *sorted(narrate_diagnosis(found), key=lambda part: not part.brief),
        *([Part(NEXT, [texts])] if texts else []),
    ]
    return make_card(
        describe_result(found), *note_constant(found.torque_constant), make_bullets(laws), *_render_parts(parts)
    )


@render_html.register
def show_addition(found: Addition) -> str:
    """Show the errors before and after, what follows from them, and the parameters."""
    noise = make_note(describe_noise(found.before, floor) if np.isfinite(floor := get_single(found.floors)) else "")
    title = f"The model with {found.after.added}"
    return make_card(title, noise, *_render_parts(narrate_addition(found)))


def note_constant(constant: TorqueConstant | None) -> tuple[Html, ...]:
    """Note the constant that turned a current into torque."""
    return () if constant is None else (make_note(f"{capitalise(constant.text)}; standard errors include that of it."),)


def _render_parts(parts: Sequence[Part]) -> Iterator[Html]:
    """Render the tables, small print and lists under their titles."""
    for part in parts:
        content = [
            make_table(item)
            if isinstance(item, TextTable)
            else make_bullets(capitalise(str(point)) for point in item)
            if isinstance(item, tuple)
            else make_note(str(item))
            for item in part.content
        ]
        yield from [make_heading(part.title), *content] if part.brief else [make_details(part.title, *content)]
