"""Figures 2 to 7: how the estimates of each scheme settle, ours and the printed one's."""

from __future__ import annotations

import numpy as np

from estimators.paper import TABLE_2, Experiment
from estimators.paper.experiment import NINETY_FIVE
from pendulum_env._typing import JSON
from pendulum_env.physics import Column
from pendulum_env.plant import paper_plant
from workbench.report.figure import Figure, axis, band, line
from workbench.report.paper.table import SYMBOLS
from workbench.report.section import Section
from workbench.report.words import unit

SETTLED = 0.1  # share of the run after which estimates are in the picture
FRAME = 0.75  # of half the picture's height, which they take up at most
GAP = 0.075  # between panels, share of the width


def convergence(experiment: Experiment) -> Section:
    """One figure for each scheme, in the paper's order."""
    figures = {scheme: scheme_figure(experiment, scheme, 2 + k) for k, scheme in enumerate(TABLE_2)}
    content = {"figures": figures, "seconds": experiment.seconds}
    return Section("convergence", "Figures 2–7", "How the estimates converge", content)


def scheme_figure(experiment: Experiment, scheme: str, number: int) -> Figure:
    """Four panels, one for each parameter."""
    data: list[JSON] = []
    layout: JSON = {"showlegend": False, "hovermode": "closest", "annotations": [], "margin": {"t": 24}}
    for k, column in enumerate(paper_plant().columns):
        place = "" if k == 0 else str(k + 1)
        traces, limits = panel(experiment, scheme, k, column)
        for trace in traces:
            data.append({**trace, "xaxis": f"x{place}", "yaxis": f"y{place}"})
        width = (1 - 3 * GAP) / 4
        begin = k * (width + GAP)
        layout[f"xaxis{place}"] = axis("time [s]", domain=[begin, begin + width], anchor=f"y{place}")
        layout[f"yaxis{place}"] = {"range": limits, "anchor": f"x{place}", "nticks": 5, "automargin": False}
        layout["annotations"].append(heading(f"{SYMBOLS[column.name]} [{unit(column.unit)}]", begin))
    return Figure(f"figure-{number}", f"Estimates over time, {scheme} model", data, layout, 230)


def panel(experiment: Experiment, scheme: str, k: int, column: Column) -> tuple[list[JSON], list[float]]:
    """Curves of one parameter, and the range in which they are seen."""
    truth = float(experiment.truth[k])
    ours, printed = (experiment.found[0][way][scheme].convergence for way in ("ours", "printed"))
    time, theta = ours.time, ours.theta[:, k]
    ends = time[[0, -1]]
    traces = [
        band(time, NINETY_FIVE * ours.std[:, k], "ours, 95 % band", theta, fillcolor="--open"),
        line(
            ends, np.full(2, truth), "truth", "--measured", "", line={"color": "--measured", "width": 1, "dash": "dot"}
        ),
        line(printed.time, printed.theta[:, k], "as printed", "--base", unit(column.unit)),
        line(time, theta, "ours", "--final", unit(column.unit)),
    ]
    late = [course.theta[course.time > SETTLED * course.time[-1], k] for course in (ours, printed)]
    reach = max(float(np.abs(np.concatenate(late) - truth).max()), 0.005 * truth) / FRAME
    return traces, [truth - reach, truth + reach]


def heading(text: str, x: float) -> JSON:
    """Text above a panel that begins at x."""
    place = {"x": x, "xref": "paper", "xanchor": "left", "y": 1, "yref": "paper", "yanchor": "bottom"}
    return {"text": f"<b>{text}</b>", "showarrow": False, **place}
