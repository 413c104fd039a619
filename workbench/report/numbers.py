"""Numbers of models: how their errors fall step by step, their parameters, and what the schemes find side by side."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.figure import DRAWING, Figure, axis, band, line, segment
from estimators.schemes.result import Identification
from estimators.selection.criterion import Criterion
from pendulum_env._typing import JSON
from pendulum_env.formatting import capitalise, format_number, format_unit
from pendulum_env.physics import Estimate
from pendulum_env.physics.table import Table, TableCurve
from pendulum_env.units import JointUnits, to_shown_unit
from workbench.narrator.effects import name_effect
from workbench.narrator.results import classify_scheme
from workbench.report.data import ReportData, Section

PARTS = (("train", "fitted data", "--train", "circle-open"), ("holdout", "held-out data", "--measured", "circle"))
WIDTH, ROW, MARGIN = 240.0, 14.0, 12.0  # of an interval plot [px]
COLORS = ("--scheme-1", "--scheme-2", "--scheme-3")


def make_errors(case: ReportData) -> Section:
    """Make the section on errors after every step."""
    steps = case.diagnosis.steps
    is_simulated = np.isfinite([own.position_rms for step in steps for own in step.errors.values()]).all()
    unit_of_torque = case.units.unit("N m")
    content = {
        "steps": steps,
        "unit": unit_of_torque,
        "angle": case.angle,
        "noise_floor": case.diagnosis.noise_floor,
        "whiteness": [
            check_whiteness(f"{label}, {part}", case, prepared, k)
            for k, (label, _, _) in enumerate(case.models)
            for part, prepared in zip(("fitted", "held out"), case.data.parts, strict=True)
        ],
        "figures": [
            plot_errors(case, "torque_rms", f"torque error [{unit_of_torque}]", case.diagnosis.noise_floor),
            *(
                [
                    plot_errors(
                        case, "position_rms", f"free-running position error [{case.angle[1]}]", None, case.angle[0]
                    )
                ]
                if is_simulated
                else []
            ),
        ]
        if len(steps) > 1
        else [],
    }
    return Section("errors", "Errors", "How the error falls", content)


def check_whiteness(
    label: str, case: ReportData, prepared: RegressionData, drawn: int
) -> tuple[str, float, float, str]:
    """Test of the residual of a drawn model for correlation between neighbours, beyond what their overlap gives.

    Label, what they share [N m], the same in standard errors of white noise, and what that means.
    """
    residual, model = case.compute_residuals(prepared)[drawn], case.models[drawn][2]
    shared, significance, _ = prepared.data.structure(residual, abs(model.estimates["inertia"].value))
    small = ", below the noise floor" if shared < case.diagnosis.noise_floor else ": another term may explain it"
    return label, shared, significance, "white" if significance < Criterion().z_score else f"not white{small}"


def plot_errors(case: ReportData, quantity: str, title: str, floor: float | None, factor: float = 1.0) -> Figure:
    """Plot one kind of error over the steps, times a factor, on a logarithmic axis."""
    steps = case.diagnosis.steps
    labels = ["base model", *(f"+ {name_effect(step.added)}" for step in steps if step.added)]
    data: list[JSON] = []
    values = []
    shades = ["--base", *["--between"] * (len(steps) - 2), "--final"]
    for part, label, color, symbol in PARTS:
        error = factor * np.array([getattr(step.errors[part], quantity) for step in steps])
        values += [*error]
        marker = {"color": shades, "size": 10, "symbol": symbol}
        data.append(line(np.arange(float(len(steps))), error, label, color, "", mode="lines+markers", marker=marker))
    if floor is not None:
        values.append(floor)
        dashed = {"color": "--muted", "width": 1.5, "dash": "dash"}
        data.append(line(np.array([-0.3, len(steps) - 0.7]), np.full(2, floor), "noise floor", "", "", line=dashed))
    low, high = np.log10(min(values)) - 0.12, np.log10(max(values)) + 0.12
    marks = np.array([1, 2, 5] if high - low < 2 else [1]) * 10.0 ** np.arange(-15, 7)[:, None]  # 1-2-5 or decades
    ticks = [float(mark) for mark in marks.ravel() if low <= np.log10(mark) <= high]
    layout = {
        "xaxis": axis(
            "",
            tickvals=list(range(len(steps))),
            ticktext=["<br>".join(wrap(label, 14)) for label in labels],  # characters of a label's line
            ticklabeloverflow="allow",
            range=[-0.3, len(steps) - 0.7],
            showgrid=False,
            zeroline=False,
        ),
        "yaxis": axis(title, type="log", range=[low, high], tickvals=ticks, ticktext=[format_number(t) for t in ticks]),
    }
    return Figure(f"ladder-{quantity}", f"{title} after every step", data, layout, 320)


def make_parameters(case: ReportData) -> Section:
    """Make the section on the parameters of the last model at every step, and on combined parameters."""
    steps = case.diagnosis.steps
    labels = [case.first if step.added is None else f"+ {name_effect(step.added)}" for step in steps]
    models = [step.model for step in steps]
    shown, final = [model.readable for model in models], models[-1]
    single = [k for k, label in enumerate(final.estimates) if label in shown[-1]]  # entries of tables have their figure
    correlation = final.correlation if len(single) <= DRAWING.correlated else ()
    names = list(final.estimates)
    content = {
        "rows": [
            _make_row(label, [known[label].shown if label in known else None for known in shown]) for label in shown[-1]
        ],
        "labels": labels,
        "width": WIDTH,
        "sigmas": DRAWING.sigmas,
        "combined": final.body.combined,
        "names": [names[k] for k in single],
        "correlation": [[correlation[k][j] for j in single] for k in single] if correlation else (),
        "figures": [_plot_table(term, curve, final.units(term.at)) for term, curve in final.tables.values()],
    }
    return Section("parameters", "Parameters", "Parameters with standard errors", content)


def _plot_table(table: Table, curve: TableCurve, units: JointUnits) -> Figure:
    """Plot a table as a function, with its band."""
    title = f"{capitalise(name_effect(table.id))}, {table.law}"
    quantity, of = ("angle", "rad") if table.axis == "position" else ("speed", "rad/s")
    (x, along), of_torque = to_shown_unit(curve.x, units.unit(of)), units.unit(table.unit)
    argument = f"{units.name(quantity)} [{along}]"
    data = [
        band(x, DRAWING.sigmas * curve.std, f"± {DRAWING.sigmas:g} standard errors", curve.value),
        line(x, curve.value, title, "--final", of_torque),
    ]
    return Figure(f"table-{table.id}", title, data, {"xaxis": axis(argument), "yaxis": axis(f"f [{of_torque}]")}, 320)


def _make_row(label: str, estimates: Sequence[Estimate | None]) -> dict[str, Any]:
    """Make the row of a parameter: estimates, and intervals as low, middle and high end, height [px] and style."""
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


def make_schemes(case: ReportData) -> Section | None:
    """Make the section on the schemes and their convergence; None for recordings that are too poor."""
    found = case.schemes
    if found is None:
        return None
    strokes = {id: choose_stroke(k, id) for k, id in enumerate(found.schemes)}
    columns, units = next(iter(found.schemes.values())).model.columns, case.units.unit
    content = {
        "found": found,
        "names": [column.name for column in columns],
        "units": [units(column.unit) for column in columns],
        "strokes": strokes,
        "figures": [plot_convergence(found, k, strokes, units(columns[k].unit)) for k in range(len(columns))],
    }
    return Section("schemes", "Schemes", "The schemes side by side", content)


def choose_stroke(place: int, scheme: str) -> JSON:
    """Choose the line of a scheme: one colour for the plain scheme and its filtered sister, which is dashed."""
    family, is_filtered = classify_scheme(scheme, place)
    return {"color": COLORS[family], "width": 1.8, "dash": "dash" if is_filtered else "solid"}


def plot_convergence(found: Identification, column: int, strokes: dict[str, JSON], of: str) -> Figure:
    """Estimate of one parameter over time, in its unit, every scheme; the wild start is out of the picture."""
    parameter = next(iter(found.schemes.values())).model.columns[column]
    data, settled = [], []
    for id, result in found.schemes.items():
        course = result.convergence
        estimate = course.theta[:, column]
        late = course.time >= course.time[0] + DRAWING.settled * (course.time[-1] - course.time[0])
        settled.append(estimate[late])
        data.append(line(course.time, estimate, name_effect(id), "", format_unit(of), line=strokes[id]))
    values = np.concatenate(settled)
    middle = float(np.median([result[-1] for result in settled]))
    reach = max(float(np.max(np.abs(values - middle))), 0.01 * abs(middle), 1e-9) / DRAWING.frame
    title = f"{parameter.name} [{format_unit(of)}]" if format_unit(of) else parameter.name
    between = {"color": "--muted", "width": 1, "dash": "dot"}  # recordings
    layout = {
        "xaxis": axis("time [s]"),
        "yaxis": axis(title, range=[middle - reach, middle + reach]),
        "showlegend": False,
        "hovermode": "x unified",
        "margin": {"t": 12},
        "shapes": [segment((end, end), (0, 1), between, yref="paper", layer="below") for end in found.ends[:-1]],
    }
    return Figure(f"convergence-{column}", f"Estimates of {parameter.name} over time", data, layout, 260)
