"""The page about excitation policies: how soon the parameters are known, how surely, and what it takes."""

from collections.abc import Mapping

import numpy as np

from agents.evaluation import MOMENTS, Outcome
from agents.observer import COUNT, TICK
from pendulum_env._typing import JSON
from workbench.report.figure import Figure, Section, axis, line, numbers, segment
from workbench.report.page import assemble

COLORS = ("--base", "--final", "--low", "--high", "--measured", "--train")  # the baseline's first
DASHES = ("solid", "dash", "dot")
TICKS = (0.125, 0.25, 0.5, 1, 2, 4, 8)  # of the gains
SHOWN = 2  # s of torque and motion


def render(told: JSON, outcomes: Mapping[str, Outcome]) -> str:
    """HTML of the page, from what `agents.evaluation.evaluation_json` tells of outcomes, by name of the policy."""
    sections = [summary(told), course(told, outcomes), efficiency(told), behaviour(told, outcomes)]
    return assemble(sections, f"excitation policies under the constraint {told['constraint']}")


def summary(told: JSON) -> Section:
    """Gains over the baseline: a table and a plot of each with its interval."""
    gains = {name: figures["gain"] for name, figures in told["policies"].items()}
    others = [name for name in gains if name != told["baseline"]]
    best = max(others, key=lambda name: gains[name]["information"]["ratio"] or 0.0, default=None)
    title = "How soon the parameters are known"
    content = {
        "told": told,
        "gains": gains,
        "best": best,
        "figure": gain_figure(gains, told["baseline"]),
    }
    return Section("gains", "Gains", title, content)


def gain_figure(gains: Mapping[str, JSON], base: str) -> Figure:
    """One dot and one interval for each policy and measure."""
    data: list[JSON] = []
    for k, measure in enumerate(gains[base]):
        names = [name for name in gains if name != base and gains[name][measure]["ratio"] is not None]
        found = [gains[name][measure] for name in names]
        ratio, low, high = (
            np.array([np.nan if gain[what] is None else gain[what] for gain in found], dtype=float)
            for what in ("ratio", "low", "high")
        )
        data.append({
            "type": "scatter", "mode": "markers", "name": measure, "orientation": "h", "offsetgroup": measure,
            "x": numbers(ratio), "y": names,
            "error_x": {"type": "data", "symmetric": False, "array": numbers(high - ratio),
                        "arrayminus": numbers(ratio - low), "color": COLORS[k % len(COLORS)], "thickness": 1.4},
            "marker": {"color": COLORS[k % len(COLORS)], "size": 9, "symbol": k},
            "hovertemplate": "%{x:.3g} times",
        })  # fmt: skip
    layout = {
        "xaxis": axis(f"gain over {base}<br>right of 1 is better", type="log", tickvals=TICKS, ticktext=TICKS),
        "yaxis": {"autorange": "reversed", "type": "category", "automargin": True},
        "scattermode": "group",
        "shapes": [segment((1, 1), (0, 1), {"color": "--line"}, yref="paper")],
    }
    return Figure("gain", "Gains of every policy over the baseline", data, layout, 140 + 84 * len(gains))


def course(told: JSON, outcomes: Mapping[str, Outcome]) -> Section:
    """Error and information over time."""
    base = outcomes[told["baseline"]]
    time = TICK * np.arange(1.0, len(base.error) + 1)
    full = np.all([np.isfinite(outcome.log_det).all(axis=1) for outcome in outcomes.values()], axis=0)  # of full rank
    error, information = [], []
    for k, (name, outcome) in enumerate(outcomes.items()):
        style = {"color": COLORS[k % len(COLORS)], "width": 1.8, "dash": DASHES[k // len(COLORS) % len(DASHES)]}
        error.append(line(time, 100 * np.median(outcome.error, axis=1), name, "", "%", line=style))
        ratio = np.exp((outcome.log_det[full] - base.log_det[full]) / COUNT)
        information.append(line(time[full], np.median(ratio, axis=1), name, "", "times", line=style))
    layout = {"xaxis": axis("time [s]"), "hovermode": "x unified"}
    figures = [
        Figure("error-over-time", "Median error of the parameters over time", error,
               {**layout, "yaxis": axis("RMS error [%], median", type="log")}, 400),
        Figure("information-over-time", "Information over time relative to the baseline", information,
               {**layout, "yaxis": axis(f"information over that of {told['baseline']}")}),
    ]  # fmt: skip
    return Section("course", "Over time", "Errors and information while the arm moves", {"figures": figures})


def efficiency(told: JSON) -> Section:
    """Errors beside the Cramer-Rao bound, with quartiles."""
    content = {"policies": told["policies"], "moments": [f"{moment:g} s" for moment in MOMENTS]}
    return Section("efficiency", "Bound", "Errors beside the Cramér–Rao bound", content)


def behaviour(told: JSON, outcomes: Mapping[str, Outcome]) -> Section:
    """What each policy does: a stretch of torque and motion on the first plant, and what it takes of the drive."""
    count = round(SHOWN / TICK)
    time = TICK * np.arange(float(count))
    data: list[JSON] = []
    for k, (name, outcome) in enumerate(outcomes.items()):
        seen = True if k < 2 else "legendonly"
        color = COLORS[k % len(COLORS)]
        torque = {**line(time, outcome.torque[:count, 0], name, color, "N m"), "legendgroup": name, "visible": seen}
        torque["line"] = {"color": color, "width": 1.6, "shape": "hv"}
        motion = line(time + TICK, outcome.position[:count, 0], name, color, "rad")
        data += [torque, {**motion, "legendgroup": name, "visible": seen, "showlegend": False, "yaxis": "y2"}]
    layout = {
        "xaxis": axis("time [s]", anchor="y2"),
        "yaxis": axis("torque [N m]", domain=[0.54, 1]),
        "yaxis2": axis("angle [rad]", domain=[0, 0.46]),
    }
    figure = Figure("behaviour-plot", "Torque and angle on the first plant", data, layout, 460)
    content = {"figure": figure, "policies": told["policies"], "seconds": SHOWN}
    return Section("behaviour", "Behaviour", "What each policy does", content)
