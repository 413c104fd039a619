"""The page of the paper's experiment, section by section in the order in which they are read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from estimators.paper import PARAMETERS, TABLE_2, WAYS, Experiment
from estimators.paper.experiment import NINETY_FIVE, SHOWN, Norms
from pendulum_env._typing import JSON, Array
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.files import write_whole
from pendulum_env.physics import Column
from pendulum_env.plant import paper_plant
from pendulum_env.words import name, opening, unit
from workbench.report.figure import Figure, Section, View, axis, band, line, numbers, span, stacked, thin
from workbench.report.page import assemble

TARGET = 0.01  # median error that every scheme should stay below
SYMBOLS = dict(zip(PARAMETERS, ("I", "mgl", "b", "fc"), strict=True))
SETTLED = 0.1  # share of the run after which estimates are in the picture
FRAME = 0.75  # of half the picture's height, which they take up at most
GAP = 0.075  # between panels, share of the width
MODEL = "hamiltonian"  # of which figure 8 is drawn
CLOSE = 5.0  # [s] that are shown at first
BROAD = 3.4  # width of the measured curve, on which the simulated one is drawn
COLORS = dict(zip(SHOWN, ("--base", "--final"), strict=True))


# ------------------------------------------------------------------------------------------------ opening and tables


def setup(experiment: Experiment) -> Section:
    """The opening: result and experiment."""
    worst = experiment.worst_median("ours")
    good = worst < TARGET
    title = "All six schemes find the paper's pendulum" if good else "Not every scheme finds the paper's pendulum"
    content = {
        "experiment": experiment,
        "good": good,
        "target": TARGET,
        "ours": worst,
        "printed": experiment.worst_median("printed"),
        "disagreement": max(_disagreement(experiment).values()),
        "truth": {name: paper_plant().estimates[name] for name in PARAMETERS},
        "rate": experiment.example.rate,
        "counts": COUNTS,
        "noise": TORQUE_NOISE,
    }
    return Section("experiment", "Experiment", title, content)


def table(experiment: Experiment) -> Section:
    """Table 2: what the paper measured on its rig, and what both ways found in simulation, scheme by scheme."""
    rows = [
        {
            "scheme": scheme,
            "paper": paper,
            "printed": experiment.score("printed", scheme),
            "ours": experiment.score("ours", scheme),
            "coverage": experiment.coverage(scheme),
        }
        for scheme, paper in TABLE_2.items()
    ]
    content = {
        "rows": rows,
        "truth": paper_plant().theta.tolist(),
        "symbols": SYMBOLS,
        "units": [paper_plant().estimates[name].unit for name in PARAMETERS],
        "runs": experiment.runs,
        "spread_paper": _spread(list(TABLE_2.values())),
        "spread_printed": _spread([experiment.score("printed", scheme).theta.tolist() for scheme in TABLE_2]),
        "disagreement": _disagreement(experiment),
    }
    return Section("table-2", "Table 2", "Table 2, side by side", content)


def _disagreement(experiment: Experiment) -> dict[str, float]:
    return {scheme: experiment.disagreement(scheme) for scheme in TABLE_2 if "hamiltonian" in scheme}


def _spread(rows: Sequence[Sequence[float | None]]) -> tuple[str, float]:
    """Parameter on which schemes differ most from the dynamic model, the first row, and by which share."""
    theta = np.array(rows, dtype=float)  # (S, 4), NaN where it was given
    share = np.nanmax(np.abs(theta / theta[0] - 1), axis=0)
    most = int(np.argmax(share))
    return list(SYMBOLS.values())[most], float(share[most])


class Worst(NamedTuple):
    """The parameter that a scheme gets least right in one way of doing it, and its median error as a share."""

    symbol: str
    error: float


def cares(experiment: Experiment) -> Section:
    """What each care buys: the largest error of every scheme with one care left out at a time, and why."""

    def worst(way: str, scheme: str) -> Worst:
        error = experiment.score(way, scheme).median
        return Worst(list(SYMBOLS.values())[int(np.argmax(error))], float(error.max()))

    content = {
        "rows": {way.id: (way.text, {scheme: worst(way.id, scheme) for scheme in TABLE_2}) for way in WAYS},
        "schemes": list(TABLE_2),
        "anatomy": experiment.anatomy,
        # two differences of a rounded angle: sqrt(6) times the deviation of the rounding, over the period squared
        "quantisation": np.sqrt(6 / 12) * 2 * np.pi / COUNTS * experiment.example.rate**2,
        "inertia": float(experiment.truth[0]),
    }
    return Section("cares", "What it takes", "What each care buys", content)


def departures(experiment: Experiment) -> Section:
    """The slips of the paper, and how to do it again."""
    command = (
        f"pendulum-ident paper --runs {experiment.runs} --seconds {experiment.seconds:g} --seed {experiment.seed} "
        "--report paper.html"
    )
    return Section("departures", "Departures", "Where this departs from the paper", {"command": command})


# --------------------------------------------------------------------------------------- figures 2 to 7: convergence


def convergence(experiment: Experiment) -> Section:
    """How the estimates settle, ours and the printed ones: one figure for each scheme, in the paper's order."""
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
        data += [{**trace, "xaxis": f"x{place}", "yaxis": f"y{place}"} for trace in traces]
        width = (1 - 3 * GAP) / 4
        begin = k * (width + GAP)
        layout[f"xaxis{place}"] = axis("time [s]", domain=[begin, begin + width], anchor=f"y{place}")
        layout[f"yaxis{place}"] = {"range": limits, "anchor": f"x{place}", "nticks": 5, "automargin": False}
        above = {"x": begin, "xref": "paper", "xanchor": "left", "y": 1, "yref": "paper", "yanchor": "bottom"}
        heading = f"<b>{SYMBOLS[column.name]} [{unit(column.unit)}]</b>"
        layout["annotations"].append({"text": heading, "showarrow": False, **above})
    return Figure(f"figure-{number}", f"Estimates over time, {scheme} model", data, layout, 230)


def panel(experiment: Experiment, scheme: str, k: int, column: Column) -> tuple[list[JSON], list[float]]:
    """Curves of one parameter, and the range in which they are seen."""
    truth = float(experiment.truth[k])
    ours, printed = (experiment.found[0][way][scheme].convergence for way in ("ours", "printed"))
    time, theta = ours.time, ours.theta[:, k]
    dotted = {"color": "--measured", "width": 1, "dash": "dot"}
    traces = [
        band(time, NINETY_FIVE * ours.std[:, k], "ours, 95 % band", theta, fillcolor="--open"),
        line(time[[0, -1]], np.full(2, truth), "truth", "--measured", "", line=dotted),
        line(printed.time, printed.theta[:, k], "as printed", "--base", unit(column.unit)),
        line(time, theta, "ours", "--final", unit(column.unit)),
    ]
    late = [course.theta[course.time > SETTLED * course.time[-1], k] for course in (ours, printed)]
    reach = max(float(np.abs(np.concatenate(late) - truth).max()), 0.005 * truth) / FRAME
    return traces, [truth - reach, truth + reach]


# ------------------------------------------------------------------------------------------- figure 8: a fresh run


def following(experiment: Experiment) -> Section:
    """The Hamiltonian model in open loop under a fresh excitation, and the torque applied, measured and modelled."""
    content = {
        "position": position_figure(experiment),
        "torque": torque_figure(experiment),
        "rms": experiment.following[MODEL],
        "following": experiment.following,
        "seconds": experiment.seconds,
        "travel": float(np.ptp(experiment.fresh.position)),
        "printed_norm": experiment.norms("printed").models[MODEL],
        "our_norm": experiment.norms("ours").models[MODEL],
    }
    return Section("following", "Figure 8", "Open loop under a fresh excitation", content)


def position_figure(experiment: Experiment) -> Figure:
    """Measured and simulated position above their difference."""
    time, measured = experiment.fresh.time, experiment.fresh.position
    simulated = experiment.simulated_position[:, 1 + list(TABLE_2).index(MODEL)]
    error = simulated - measured
    at = np.union1d(thin(measured), thin(error))
    data = [
        line(time[at], measured[at], "measured", "--measured", "rad", line={"color": "--measured", "width": BROAD}),
        line(time[at], simulated[at], "simulated", "--final", "rad"),
        line(time[at], error[at], "simulated − measured", "--final", "rad", yaxis="y2", showlegend=False),
    ]
    layout = stacked("position [rad]", "error [rad]", "time [s]", 0.66)
    return viewed("figure-8a", "Measured and simulated position over time", data, layout, [measured, error], time)


def torque_figure(experiment: Experiment) -> Figure:
    """Applied torque, and what the model calculates from the motion, differentiated in both ways."""
    t, applied, printed = experiment.torque("printed", MODEL)
    time, _, ours = experiment.torque("ours", MODEL)
    at, kept = thin(printed), thin(np.nan_to_num(ours))
    data = [
        line(t[at], printed[at], "calculated by backward differences", "--base", "N m", opacity=0.75),
        line(t[at], applied[at], "applied", "--measured", "N m", line={"color": "--measured", "width": BROAD}),
        line(time[kept], ours[kept], "calculated, ours", "--final", "N m"),
    ]
    layout: JSON = {"xaxis": axis("time [s]"), "yaxis": axis("torque [N m]"), "hovermode": "x unified"}
    return viewed("figure-8b", "Applied and calculated torque over time", data, layout, [printed], t, 340)


def viewed(
    id: str, label: str, data: list[JSON], layout: JSON, series: Sequence[Array], time: Array, height: int = 460
) -> Figure:
    """Figure of a series (N,) in each of its plots that shows its first seconds, and all of it at a click."""

    def view(name: str, stop: float) -> View:
        ranges = {f"yaxis{k or ''}": span([values[time <= stop]]) for k, values in zip((0, 2), series, strict=False)}
        return View(name, {"xaxis": [float(time[0]), stop], **ranges})

    views = (view(f"First {CLOSE:g} s", min(CLOSE, float(time[-1]))), view("All", float(time[-1])))
    for place, limits in views[0].ranges.items():
        layout[place]["range"] = limits
    return Figure(id, label, data, layout, height, views)


# ------------------------------------------------------------------------------------------ figure 9: torque errors


def norms(experiment: Experiment) -> Section:
    """The norm (10) of every model's torque error, as the paper takes it and clear of stick, beside the truth's."""
    found = {way: experiment.norms(way) for way in SHOWN}
    least = min(found["printed"].models, key=lambda scheme: found["printed"].models[scheme])
    content = {
        "norms": found,
        "figures": {way: norm_figure(way, found[way]) for way in SHOWN},
        "least": least,
        "shrunk": 1.0 - float(experiment.found[0]["printed"][least].model.theta[0] / experiment.truth[0]),
        "beats_truth": found["printed"].models[least] < found["printed"].truth,
    }
    return Section("norms", "Figure 9", "The norm of the torque error", content)


def norm_figure(way: str, found: Norms) -> Figure:
    """A dot for each model, and a line where the true parameters are."""
    values = np.array(list(found.models.values()))
    labels = [opening(name(scheme)) for scheme in found.models]
    reach = 1.25 * max(float(np.abs(values - found.truth).max()), 0.005 * found.truth)
    dots: JSON = {
        "mode": "markers",
        "name": "model",
        "x": numbers(values),
        "y": labels,
        "hovertemplate": "%{x:.5g} N m",
    }
    ends: JSON = {"x": numbers(np.full(2, found.truth)), "y": [labels[0], labels[-1]], "hoverinfo": "skip"}
    data: list[JSON] = [
        {"type": "scatter", **dots, "marker": {"color": COLORS[way], "size": 11}},
        {
            "type": "scatter",
            "mode": "lines",
            "name": "true parameters",
            **ends,
            "line": {"color": "--measured", "width": 1.5, "dash": "dot"},
        },
    ]
    layout = {
        "xaxis": axis("L2 norm [N m]", range=[found.truth - reach, found.truth + reach], nticks=6),
        "yaxis": {"autorange": "reversed", "type": "category"},
        "margin": {"l": 130},
    }
    return Figure(f"figure-9-{way}", f"L2 norm of the torque error of six models, {way}", data, layout, 300)


SECTIONS: tuple[Callable[[Experiment], Section], ...] = (
    setup,
    table,
    cares,
    convergence,
    following,
    norms,
    departures,
)


def render(experiment: Experiment) -> str:
    """HTML of the page."""
    return assemble([make(experiment) for make in SECTIONS], "the paper's experiment, reproduced")


def write_paper_report(path: str | Path, experiment: Experiment) -> None:
    """Write the experiment as one self-contained HTML file, whole or not at all."""
    write_whole(path, render(experiment))
