"""Figure 8: the Hamiltonian model in open loop under a fresh excitation, and the torque applied."""

from __future__ import annotations

import numpy as np

from estimators.paper import TABLE_2, Experiment
from pendulum_env._typing import JSON, Array
from workbench.report.figure import Figure, View, line, span, stacked, thin
from workbench.report.section import Section

MODEL = "hamiltonian"
CLOSE = 5.0  # [s] that are shown at first
BROAD = 3.4  # width of the measured curve, on which the simulated one is drawn


def following(experiment: Experiment) -> Section:
    """Position and torque, measured and modelled."""
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
    broad: JSON = {"color": "--measured", "width": BROAD}
    data = [
        line(time[at], measured[at], "measured", "--measured", "rad", line=broad),
        line(time[at], simulated[at], "simulated", "--final", "rad"),
        line(time[at], error[at], "simulated − measured", "--final", "rad", yaxis="y2", showlegend=False),
    ]
    layout = stacked("position [rad]", "error [rad]", "time [s]", 0.66)
    return viewed("figure-8a", "Measured and simulated position over time", data, layout, [[measured], [error]], time)


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
    layout: JSON = {"xaxis": {"title": {"text": "time [s]"}}, "yaxis": {"title": {"text": "torque [N m]"}}}
    layout["hovermode"] = "x unified"
    return viewed("figure-8b", "Applied and calculated torque over time", data, layout, [[printed]], t, 340)


def viewed(
    id: str, label: str, data: list[JSON], layout: JSON, series: list[list[Array]], time: Array, height: int = 460
) -> Figure:
    """Figure that shows its first seconds, and all of it at a click."""

    def view(name: str, stop: float) -> View:
        inside = time <= stop
        ranges = {"xaxis": [float(time[0]), stop]}
        for k, part in enumerate(series):
            ranges[f"yaxis{k + 1 if k else ''}"] = span([values[inside] for values in part])
        return View(name, ranges)

    views = (view(f"First {CLOSE:g} s", min(CLOSE, float(time[-1]))), view("All", float(time[-1])))
    for axis, limits in views[0].ranges.items():
        layout[axis]["range"] = limits
    return Figure(id, label, data, layout, height, views)
