"""Parameters with their uncertainty, from the base model to the final one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pendulum_env.physics import Estimate, Model
from pendulum_env.physics.table import Curve, Table
from workbench.report.case import Case
from workbench.report.figure import Figure, axis, band, line
from workbench.report.section import Section
from workbench.report.words import name, opening

if TYPE_CHECKING:  # Pinocchio is imported by who needs it
    from pendulum_env.arms.body import BaseParameter

WIDTH, ROW, MARGIN = 240.0, 14.0, 12.0  # of an interval plot [px]
SIGMAS = 2.0  # standard errors on either side
MOST = 20  # parameters, of which a table of correlations can be read


@dataclass(frozen=True)
class Interval:
    """One estimate as drawn: ends and middle of its interval, and its height [px]."""

    low: float
    middle: float
    high: float
    y: float
    kind: str  # base, between or final


@dataclass(frozen=True)
class Row:
    """One parameter over all steps: an estimate for each step that has it, and the plot of their intervals."""

    name: str
    unit: str
    estimates: tuple[Estimate | None, ...]
    intervals: tuple[Interval, ...]
    height: float
    limits: tuple[float, float]


def parameters(case: Case) -> Section:
    """Every parameter at every step."""
    steps = case.diagnosis.steps
    labels = [case.first if step.added is None else f"+ {name(step.added)}" for step in steps]
    return of_models([step.model for step in steps], labels)


def of_models(models: Sequence[Model], labels: Sequence[str], combined: Sequence[BaseParameter] = ()) -> Section:
    """Every parameter of the last of some models under each, and base parameters of an arm that combine several."""
    shown, final = [model.readable for model in models], models[-1]
    single = [k for k, label in enumerate(final.estimates) if label in shown[-1]]  # entries of tables have their figure
    correlation = final.correlation if len(single) <= MOST else ()
    names = list(final.estimates)
    return Section(
        "parameters",
        "Parameters",
        "Parameters and how sure they are",
        {
            "rows": [row(label, [known.get(label) for known in shown]) for label in shown[-1]],
            "labels": labels,
            "width": WIDTH,
            "sigmas": SIGMAS,
            "combined": combined,
            "names": [names[k] for k in single],
            "correlation": [[correlation[k][j] for j in single] for k in single] if correlation else (),
            "figures": [drawn(term, curve) for term, curve in final.tables.values()],
        },
    )


def drawn(table: Table, curve: Curve) -> Figure:
    """A table as a function, with its band."""
    title = f"{opening(name(table.id))}, {table.law}"
    argument = "angle [rad]" if table.axis == "position" else "speed [rad/s]"
    data = [
        band(curve.x, SIGMAS * curve.std, f"± {SIGMAS:g} standard errors", curve.value),
        line(curve.x, curve.value, title, "--final", table.unit),
    ]
    return Figure(f"table-{table.id}", title, data, {"xaxis": axis(argument), "yaxis": axis(f"f [{table.unit}]")}, 320)


def row(label: str, estimates: Sequence[Estimate | None]) -> Row:
    """Table row and interval plot of one parameter."""
    known = [(k, e) for k, e in enumerate(estimates) if e is not None]
    low = min(e.value - SIGMAS * e.std for _, e in known)
    high = max(e.value + SIGMAS * e.std for _, e in known)
    span = (high - low) or abs(high) or 1.0

    def place(value: float) -> float:
        return MARGIN + (WIDTH - 2 * MARGIN) * ((value - low) / span if high > low else 0.5)

    intervals = tuple(
        Interval(
            place(e.value - SIGMAS * e.std),
            place(e.value),
            place(e.value + SIGMAS * e.std),
            ROW * (k + 0.5),
            "base" if k == 0 else "final" if k == len(estimates) - 1 else "between",
        )
        for k, e in known
    )
    return Row(label, known[-1][1].unit, tuple(estimates), intervals, ROW * len(estimates), (low, high))
