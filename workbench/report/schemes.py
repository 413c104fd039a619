"""The schemes side by side: what each finds, and how its estimates converge."""

import numpy as np

from estimators.schemes.identification import Identification
from estimators.show.story import kin
from pendulum_env._typing import JSON
from pendulum_env.words import name, unit
from workbench.report.case import Case
from workbench.report.figure import DRAWING, Figure, Section, axis, line, segment

COLORS = ("--scheme-1", "--scheme-2", "--scheme-3")


def schemes(case: Case) -> Section | None:
    """Estimates of every scheme and how they converge; None where recordings are too poor for them."""
    found = case.schemes
    if found is None:
        return None
    strokes = {id: stroke(k, id) for k, id in enumerate(found.schemes)}
    columns = next(iter(found.schemes.values())).model.columns
    content = {
        "found": found,
        "names": [column.name for column in columns],
        "units": [column.unit for column in columns],
        "strokes": strokes,
        "figures": [convergence_figure(found, k, strokes) for k in range(len(columns))],
    }
    return Section("schemes", "Schemes", "The schemes side by side", content)


def stroke(place: int, scheme: str) -> JSON:
    """Line of a scheme: one colour for the plain scheme and its filtered sister, which is dashed."""
    family, is_filtered = kin(scheme, place)
    return {"color": COLORS[family], "width": 1.8, "dash": "dash" if is_filtered else "solid"}


def convergence_figure(found: Identification, column: int, strokes: dict[str, JSON]) -> Figure:
    """Estimate of one parameter over time, every scheme; the wild start is out of the picture."""
    parameter = next(iter(found.schemes.values())).model.columns[column]
    data, settled = [], []
    for id, result in found.schemes.items():
        course = result.convergence
        estimate = course.theta[:, column]
        late = course.time >= course.time[0] + DRAWING.settled * (course.time[-1] - course.time[0])
        settled.append(estimate[late])
        data.append(line(course.time, estimate, name(id), "", unit(parameter.unit), line=strokes[id]))
    values = np.concatenate(settled)
    middle = float(np.median([result[-1] for result in settled]))
    reach = max(float(np.max(np.abs(values - middle))), 0.01 * abs(middle), 1e-9) / DRAWING.frame
    title = f"{parameter.name} [{unit(parameter.unit)}]" if unit(parameter.unit) else parameter.name
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
