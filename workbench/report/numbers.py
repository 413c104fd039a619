"""Sections on errors of each step, parameters, and estimates of the schemes."""

from textwrap import wrap
from typing import Any

import numpy as np

from estimators.decisions.errors import get_single
from estimators.schemes.result import Identification
from pendulum_env._typing import JSON
from pendulum_env.formatting import capitalise, format_unit
from pendulum_env.physics.effect_texts import name_effect, name_parameter
from pendulum_env.physics.table import Table, TableCurve
from pendulum_env.units import JointUnits, to_shown_unit
from workbench.figure import Figure, make_axis, make_band, make_line
from workbench.narrator.identification import list_warnings, tabulate_schemes
from workbench.narrator.parts import Content, Legend
from workbench.narrator.results import narrate_errors
from workbench.narrator.tables import tabulate_parameters
from workbench.report.data import ReportData, Section

PARTS = (("train", "fitted data", "--train", "circle-open"), ("holdout", "held-out data", "--measured", "circle"))
SIGMAS = 2.0  # half width of bands [standard errors]
SETTLED = 0.25  # share of the time after which estimates set the plot's range
FRAME = 0.6  # share of the plot's height for these estimates
TICKS = [digit * 10.0**power for power in range(-9, 6) for digit in (1, 2, 3, 5, 7)]  # of errors
COLORS = ("--scheme-1", "--scheme-2", "--scheme-3")


def make_errors(case: ReportData) -> Section:
    """Make the section on errors after every step."""
    diagnosis, steps, units = case.diagnosis, case.diagnosis.steps, case.units
    is_simulated = np.isfinite([error.position_rms for step in steps for error in step.errors.values()]).all()
    plots = [plot_errors(case, "torque_rms", f"torque error [{units.unit('N m')}]", get_single(diagnosis.floors))]
    if is_simulated:
        factor, angle = case.angle
        plots.append(plot_errors(case, "position_rms", f"free-running position error [{angle}]", None, factor))
    figures = tuple(plots) if len(steps) > 1 else "No effect was added, so there is one step only."
    return Section("errors", "Errors", "The error after every step", [figures, *narrate_errors(diagnosis)])


def plot_errors(case: ReportData, quantity: str, title: str, floor: float | None, factor: float = 1.0) -> Figure:
    """Plot an error over the steps on a logarithmic axis; `factor`: from SI to the displayed unit."""
    steps = case.diagnosis.steps
    x, ends = np.arange(float(len(steps))), np.array([-0.3, len(steps) - 0.7])
    shades = ["--base", *["--between"] * (len(steps) - 2), "--final"]
    data: list[JSON] = []
    for part, label, color, symbol in PARTS:
        error = factor * np.array([getattr(step.errors[part], quantity) for step in steps])
        marker = {"color": shades, "size": 10, "symbol": symbol}
        data.append(make_line(x, error, label, color, "", mode="lines+markers", marker=marker))
    if floor is not None:
        dashed = {"color": "--muted", "width": 1.5, "dash": "dash"}
        data.append(make_line(ends, np.full(2, floor), "noise floor", "", "", line=dashed))
    labels = [f"+ {name_effect(step.added)}" if step.added else "base model" for step in steps]
    names = ["<br>".join(wrap(label, 14)) for label in labels]  # line width [characters]
    named = {"tickvals": x.tolist(), "ticktext": names, "ticklabeloverflow": "allow", "range": ends.tolist()}
    layout = {
        "xaxis": make_axis("", **named, showgrid=False, zeroline=False),
        "yaxis": make_axis(f"{title}, log scale", type="log", tickvals=TICKS, ticktext=[f"{tick:g}" for tick in TICKS]),
    }
    return Figure(f"ladder-{quantity}", f"{title} after every step", data, layout, 320)


def make_parameters(case: ReportData) -> Section:
    """Make the section on the parameters of the model at every step, and on combined parameters."""
    steps, misfit_ratio = case.diagnosis.steps, case.data.criterion.misfit_ratio
    models = [step.mark_bias(case.diagnosis.floors, misfit_ratio) for step in steps]
    labels = [case.first if step.added is None else f"+ {name_effect(step.added)}" for step in steps]
    final = steps[-1].model
    content: list[Any] = [
        "Value ± standard error after every step; biased where the residual is more than noise.",
        tabulate_parameters(*models, headers=labels),
    ]
    if final.mechanism.combinations:
        combined = tuple(f"{name} stands for {text}" for name, text in final.mechanism.combinations.items())
        content += [
            "The torque shows combinations of the links' masses and inertias, the base parameters, each named by its "
            "first part:",
            combined,
        ]
    content.append(tuple(_plot_table(term, curve, final.units(term.at)) for term, curve in final.tables.values()))
    return Section("parameters", "Parameters", "Parameters with standard errors", content)


def _plot_table(table: Table, curve: TableCurve, units: JointUnits) -> Figure:
    """Plot the function of a table with its confidence band."""
    title = f"{capitalise(name_effect(table.id))}, {table.law}"
    quantity, unit_of_quantity = ("angle", "rad") if table.axis == "position" else ("speed", "rad/s")
    (x, unit_of_axis), of_torque = to_shown_unit(curve.x, units.unit(unit_of_quantity)), units.unit(table.unit)
    argument = f"{units.name(quantity)} [{unit_of_axis}]"
    data = [
        make_band(x, SIGMAS * curve.std, f"± {SIGMAS:g} standard errors", curve.value),
        make_line(x, curve.value, title, "--final", of_torque),
    ]
    layout = {"xaxis": make_axis(argument), "yaxis": make_axis(f"f [{of_torque}]")}
    return Figure(f"table-{table.id}", title, data, layout, 320)


def make_schemes(case: ReportData) -> Section | None:
    """Make the section on the schemes and their convergence; None if the data do not suffice."""
    identification = case.schemes
    if identification is None:
        return None
    strokes = {id: choose_stroke(k, id) for k, id in enumerate(identification.schemes)}
    columns, units = next(iter(identification.schemes.values())).model.columns, case.units.unit
    content: Content = [
        "Each scheme turns the same recordings into its own regression. The plots show the recursive estimate as the "
        "recording goes on; filtered schemes are dashed.",
        tuple(list_warnings(identification)),
        tabulate_schemes(identification),
        Legend(tuple((f"stroke {stroke['dash']}", stroke["color"], name_effect(id)) for id, stroke in strokes.items())),
        tuple(plot_convergence(identification, k, strokes, units(column.unit)) for k, column in enumerate(columns)),
    ]
    return Section("schemes", "Schemes", "The schemes side by side", content)


def choose_stroke(place: int, scheme: str) -> JSON:
    """Return the line style of a scheme: a filtered scheme is dashed, in the colour of its unfiltered form."""
    families = (("dynamic",), ("energy", "power"), ("hamiltonian",))
    matches = (k for k, words in enumerate(families) if any(word in scheme for word in words))
    color = COLORS[next(matches, place % len(COLORS))]
    return {"color": color, "width": 1.8, "dash": "dash" if "filtered" in scheme else "solid"}


def plot_convergence(
    identification: Identification, column: int, strokes: dict[str, JSON], unit_of_parameter: str
) -> Figure:
    """Plot the estimates of one parameter over time by all schemes; early outliers are cut off."""
    parameter = next(iter(identification.schemes.values())).model.columns[column]
    data, late_estimates = [], []
    for id, result in identification.schemes.items():
        course = result.convergence
        estimate = course.theta[:, column]
        late = course.time >= course.time[0] + SETTLED * (course.time[-1] - course.time[0])
        late_estimates.append(estimate[late])
        data.append(
            make_line(course.time, estimate, name_effect(id), "", format_unit(unit_of_parameter), line=strokes[id])
        )
    values = np.concatenate(late_estimates)
    middle = float(np.median([result[-1] for result in late_estimates]))
    reach = max(float(np.max(np.abs(values - middle))), 0.01 * abs(middle), 1e-9) / FRAME
    unit = f" [{format_unit(unit_of_parameter)}]" if format_unit(unit_of_parameter) else ""
    title = "<br>".join(wrap(name_parameter(parameter.name) + unit, 26))  # line width [characters]
    between = {"color": "--muted", "width": 1, "dash": "dot"}  # between recordings
    layout = {
        "xaxis": make_axis("time [s]"),
        "yaxis": make_axis(title, range=[middle - reach, middle + reach]),
        "showlegend": False,
        "hovermode": "x unified",
        "margin": {"t": 12},
        "shapes": [
            {"type": "line", "x0": end, "x1": end, "y0": 0, "y1": 1, "line": between, "yref": "paper", "layer": "below"}
            for end in identification.ends[:-1]
        ],
    }
    return Figure(f"convergence-{column}", f"Estimates of {parameter.name} over time", data, layout, 260)
