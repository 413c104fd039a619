"""The page of the paper's experiment: its figures; the templates take all other numbers from the experiment."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from estimators.paper import PARAMETERS, TABLE_2, WAYS, Experiment
from estimators.paper.experiment import NINETY_FIVE, SHOWN, Norms
from pendulum_env._typing import JSON
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.files import write_whole
from pendulum_env.plant import paper_plant
from pendulum_env.words import name, opening, unit
from workbench.report.figure import Figure, Section, axis, band, line, numbers, span, stacked, thin, views
from workbench.report.page import assemble

TARGET = 0.01  # median error that every scheme should stay below
SYMBOLS = dict(zip(PARAMETERS, ("I", "mgl", "b", "fc"), strict=True))
GAP = 0.075  # between panels, share of the width
MODEL = "hamiltonian"  # of which figure 8 is drawn
CLOSE = 5.0  # [s] of figure 8 that are shown at first
BROAD = {"color": "--measured", "width": 3.4}  # the measured curve, on which the simulated one is drawn
DOTTED = {"color": "--measured", "width": 1.5, "dash": "dot"}
SECTIONS = {
    "experiment": ("Experiment", ""),  # its title depends on the result
    "table-2": ("Table 2", "Table 2, side by side"),
    "cares": ("What it takes", "What each care buys"),
    "convergence": ("Figures 2–7", "How the estimates converge"),
    "following": ("Figure 8", "Open loop under a fresh excitation"),
    "norms": ("Figure 9", "The norm of the torque error"),
    "departures": ("Departures", "Where this departs from the paper"),
}


def render(experiment: Experiment) -> str:
    """HTML of the page."""
    good = experiment.worst_median("ours") < TARGET
    title = "All six schemes find the paper's pendulum" if good else "Not every scheme finds the paper's pendulum"
    norms = {way: experiment.norms(way) for way in SHOWN}
    content: dict[str, Any] = {
        "experiment": experiment,
        "good": good,
        "target": TARGET,
        "table": TABLE_2,
        "symbols": list(SYMBOLS.values()),
        "plant": paper_plant(),
        "ways": WAYS,
        "counts": COUNTS,
        "noise": TORQUE_NOISE,
        # two differences of a rounded angle: sqrt(6) times the deviation of the rounding, over the period squared
        "quantisation": np.sqrt(6 / 12) * 2 * np.pi / COUNTS * experiment.example.rate**2,
        "spread_paper": _spread(list(TABLE_2.values())),
        "spread_printed": _spread([experiment.score("printed", scheme).theta.tolist() for scheme in TABLE_2]),
        "convergence": {scheme: convergence(experiment, scheme, 2 + k) for k, scheme in enumerate(TABLE_2)},
        "model": MODEL,
        "position": position_figure(experiment),
        "torque": torque_figure(experiment),
        "norms": norms,
        "norm_figures": {way: norm_figure(way, found) for way, found in norms.items()},
    }
    sections = [Section(id, short, long or title, content) for id, (short, long) in SECTIONS.items()]
    return assemble(sections, "the paper's experiment, reproduced")


def write_paper_report(path: str | Path, experiment: Experiment) -> None:
    """Write the experiment as one self-contained HTML file, whole or not at all."""
    write_whole(path, render(experiment))


def _spread(rows: Sequence[Sequence[float | None]]) -> tuple[str, float]:
    """Parameter on which schemes differ most from the dynamic model, the first row, and by which share."""
    theta = np.array(rows, dtype=float)  # (S, 4), NaN where it was given
    share = np.nanmax(np.abs(theta / theta[0] - 1), axis=0)
    return list(SYMBOLS.values())[int(np.argmax(share))], float(share.max())


def convergence(experiment: Experiment, scheme: str, number: int) -> Figure:
    """Figures 2 to 7: how the estimates settle, ours and the printed ones, a panel for each parameter."""
    data: list[JSON] = []
    layout: JSON = {"showlegend": False, "hovermode": "closest", "annotations": [], "margin": {"t": 24}}
    ours, printed = (experiment.found[0][way][scheme].convergence for way in ("ours", "printed"))
    for k, column in enumerate(paper_plant().columns):
        place, label, truth = str(k + 1) if k else "", unit(column.unit), float(experiment.truth[k])
        traces = [
            band(ours.time, NINETY_FIVE * ours.std[:, k], "ours, 95 % band", ours.theta[:, k], fillcolor="--open"),
            line(ours.time[[0, -1]], np.full(2, truth), "truth", "--measured", "", line=DOTTED),
            line(printed.time, printed.theta[:, k], "as printed", "--base", label),
            line(ours.time, ours.theta[:, k], "ours", "--final", label),
        ]
        data += [{**trace, "xaxis": f"x{place}", "yaxis": f"y{place}"} for trace in traces]
        # the picture shows the last nine tenths of both courses, in three quarters of its height
        late = np.concatenate([own.theta[own.time > 0.1 * own.time[-1], k] for own in (ours, printed)])
        reach = max(float(np.abs(late - truth).max()), 0.005 * truth) / 0.75
        width = (1 - 3 * GAP) / 4
        begin = k * (width + GAP)
        layout[f"xaxis{place}"] = axis("time [s]", domain=[begin, begin + width], anchor=f"y{place}")
        layout[f"yaxis{place}"] = {"range": [truth - reach, truth + reach], "anchor": f"x{place}", "nticks": 5}
        layout[f"yaxis{place}"]["automargin"] = False
        above = {"x": begin, "xref": "paper", "xanchor": "left", "y": 1, "yref": "paper", "yanchor": "bottom"}
        heading = f"<b>{SYMBOLS[column.name]} [{label}]</b>"
        layout["annotations"].append({"text": heading, "showarrow": False, **above})
    return Figure(f"figure-{number}", f"Estimates over time, {scheme} model", data, layout, 230)


def position_figure(experiment: Experiment) -> Figure:
    """Figure 8 A: measured and simulated position above their difference."""
    time, measured = experiment.fresh.time, experiment.fresh.position
    simulated = experiment.simulated_position[:, 1 + list(TABLE_2).index(MODEL)]
    error = simulated - measured
    at = np.union1d(thin(measured), thin(error))
    data = [
        line(time[at], measured[at], "measured", "--measured", "rad", line=BROAD),
        line(time[at], simulated[at], "simulated", "--final", "rad"),
        line(time[at], error[at], "simulated − measured", "--final", "rad", yaxis="y2", showlegend=False),
    ]
    layout = stacked("position [rad]", "error [rad]", "time [s]", 0.66)
    shown = views(time, [measured], [error], CLOSE, True, "model")
    return Figure("figure-8a", "Measured and simulated position over time", data, layout, 460, shown)


def torque_figure(experiment: Experiment) -> Figure:
    """Figure 8 B: applied torque, and what the model calculates from the motion, differentiated in both ways."""
    t, applied, printed = experiment.torque("printed", MODEL)
    time, _, ours = experiment.torque("ours", MODEL)
    at, kept = thin(printed), thin(np.nan_to_num(ours))
    data = [
        line(t[at], printed[at], "calculated by backward differences", "--base", "N m", opacity=0.75),
        line(t[at], applied[at], "applied", "--measured", "N m", line=BROAD),
        line(time[kept], ours[kept], "calculated, ours", "--final", "N m"),
    ]
    close = [float(t[0]), min(CLOSE, float(t[-1]))]
    layout: JSON = {"xaxis": axis("time [s]", range=close), "hovermode": "x unified"}
    layout["yaxis"] = axis("torque [N m]", range=span([printed[t <= close[1]]]))
    return Figure("figure-8b", "Applied and calculated torque over time", data, layout)


def norm_figure(way: str, found: Norms) -> Figure:
    """Figure 9: a dot for each model, and a line where the true parameters are."""
    values = np.array(list(found.models.values()))
    labels = [opening(name(scheme)) for scheme in found.models]
    reach = 1.25 * max(float(np.abs(values - found.truth).max()), 0.005 * found.truth)
    marker = {"color": "--base" if way == "printed" else "--final", "size": 11}
    dots: JSON = {"type": "scatter", "mode": "markers", "name": "model", "x": numbers(values), "y": labels}
    dots |= {"hovertemplate": "%{x:.5g} N m", "marker": marker}
    truth: JSON = {"type": "scatter", "mode": "lines", "name": "true parameters", "hoverinfo": "skip", "line": DOTTED}
    truth |= {"x": numbers(np.full(2, found.truth)), "y": [labels[0], labels[-1]]}
    layout = {
        "xaxis": axis("L2 norm [N m]", range=[found.truth - reach, found.truth + reach], nticks=6),
        "yaxis": {"autorange": "reversed", "type": "category"},
        "margin": {"l": 130},
    }
    label = f"L2 norm of the torque error of six models, {way}"
    return Figure(f"figure-9-{way}", label, [dots, truth], layout, 300)
