"""Parameters with their uncertainty, from the base model to the final one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pendulum_env.physics import Estimate, Model
from pendulum_env.physics.table import Curve, Table
from pendulum_env.words import name, opening
from workbench.report.case import Case
from workbench.report.figure import DRAWING, Figure, Section, axis, band, line

if TYPE_CHECKING:  # Pinocchio is imported by who needs it
    from pendulum_env.arms.body import BaseParameter

WIDTH, ROW, MARGIN = 240.0, 14.0, 12.0  # of an interval plot [px]


def parameters(case: Case) -> Section:
    """Every parameter at every step."""
    steps = case.diagnosis.steps
    labels = [case.first if step.added is None else f"+ {name(step.added)}" for step in steps]
    return of_models([step.model for step in steps], labels)


def of_models(models: Sequence[Model], labels: Sequence[str], combined: Sequence[BaseParameter] = ()) -> Section:
    """Every parameter of the last of some models under each, and base parameters of an arm that combine several."""
    shown, final = [model.readable for model in models], models[-1]
    single = [k for k, label in enumerate(final.estimates) if label in shown[-1]]  # entries of tables have their figure
    correlation = final.correlation if len(single) <= DRAWING.correlated else ()
    names = list(final.estimates)
    content = {
        "rows": [_row(label, [known.get(label) for known in shown]) for label in shown[-1]],
        "labels": labels,
        "width": WIDTH,
        "sigmas": DRAWING.sigmas,
        "combined": combined,
        "names": [names[k] for k in single],
        "correlation": [[correlation[k][j] for j in single] for k in single] if correlation else (),
        "figures": [_drawn(term, curve) for term, curve in final.tables.values()],
    }
    return Section("parameters", "Parameters", "Parameters and how sure they are", content)


def _drawn(table: Table, curve: Curve) -> Figure:
    """A table as a function, with its band."""
    title = f"{opening(name(table.id))}, {table.law}"
    argument = "angle [rad]" if table.axis == "position" else "speed [rad/s]"
    data = [
        band(curve.x, DRAWING.sigmas * curve.std, f"± {DRAWING.sigmas:g} standard errors", curve.value),
        line(curve.x, curve.value, title, "--final", table.unit),
    ]
    return Figure(f"table-{table.id}", title, data, {"xaxis": axis(argument), "yaxis": axis(f"f [{table.unit}]")}, 320)


def _row(label: str, estimates: Sequence[Estimate | None]) -> dict[str, Any]:
    """A parameter under each model, and its intervals as drawn: low, middle and high end, height [px] and style."""
    known = [(k, e, DRAWING.sigmas * e.std) for k, e in enumerate(estimates) if e is not None]
    low, high = min(e.value - half for _, e, half in known), max(e.value + half for _, e, half in known)

    def place(value: float) -> float:
        return MARGIN + (WIDTH - 2 * MARGIN) * ((value - low) / (high - low) if high > low else 0.5)

    styles = ["base", *["between"] * (len(estimates) - 2), "final"]
    intervals = [
        (place(e.value - half), place(e.value), place(e.value + half), ROW * (k + 0.5), styles[k])
        for k, e, half in known
    ]
    return {
        "name": label,
        "unit": known[-1][1].unit,
        "estimates": estimates,
        "intervals": intervals,
        "height": ROW * len(estimates),
        "limits": (low, high),
    }
