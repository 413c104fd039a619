"""Linked views of one recording: what is selected in one of them lights up in the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.checks.residual import Region, turns, wrapped
from pendulum_env._typing import JSON, Array, Mask
from pendulum_env.physics import Samples
from pendulum_env.recording import Recording
from workbench.report.case import Case
from workbench.report.figure import Figure, axis, band, broken, line, numbers, span, thin
from workbench.report.sections.comparison import before_and_after
from workbench.report.sections.failures import planes

MAP, PHASE, TIME = "map", "phase", "time"
VIEWS = (MAP, PHASE, TIME)
LIT = 1500  # points of a selection that are drawn in one view
GLOW = "--brush"


@dataclass(frozen=True, eq=False)
class Points:
    """R windows of one recording under the models that are compared.

    Attributes:
        case: the models, and what they were fitted to.
        time, position, velocity, torque: at the windows' centres (R,), SI.
        residuals: measured minus modelled torque of each model (R,) [N m].
    """

    case: Case
    time: Array
    position: Array
    velocity: Array
    torque: Array
    residuals: tuple[Array, ...]

    @classmethod
    def of(cls, case: Case, recording: Recording) -> Points:
        """Windows of one of the recordings, fitted and held-out ones alike."""
        parts = []
        for evidence in (case.training, case.testing):
            windows, x = evidence.data.windows, evidence.samples
            own = np.repeat([w.recording is recording for w in windows], [len(w.centers) for w in windows])
            series = (x.time, x.position, x.velocity, evidence.data.torque(), *case.residuals(evidence))
            parts.append([values[own] for values in series])
        time, position, velocity, torque, *residuals = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(case, time, position, velocity, torque, tuple(residuals))

    def __len__(self) -> int:
        return len(self.time)

    @property
    def noise(self) -> float:
        """Torque error that measurement noise alone gives [N m]."""
        return self.case.diagnosis.noise_floor

    @property
    def samples(self) -> Samples:
        """What residuals are profiled over."""
        return Samples(self.time, self.position, self.velocity, self.torque)


def figures(points: Points, shown: int, name: str) -> dict[str, Figure]:
    """The three views; `shown` is the model whose residual the map shows."""
    cells, map_layout = planes(points.position, points.velocity, points.residuals)[shown]
    label = points.case.models[shown][0]
    select = {"dragmode": "select", "margin": {"t": 12, "r": 8}}
    dots = thin(points.velocity, LIT)
    picked = _dots(wrapped(points.position[dots]), points.velocity[dots], "--text", 2, opacity=0.25, hoverinfo="skip")
    kept = thin(points.velocity, 2 * LIT)
    _, (q, v) = broken(points.time, kept, points.position, points.velocity)
    phase = line(q, v, "motion", "--train", "rad/s", line={"color": "--train", "width": 1}, hoverinfo="skip")
    return {
        MAP: Figure(
            MAP,
            f"Residual torque of the {label} over angle and velocity, {name}",
            [cells, picked],
            map_layout | select,
            380,
        ),
        PHASE: Figure(
            PHASE,
            f"Phase plane, {name}",
            [phase],
            {
                "xaxis": axis("angle q [rad]", range=span([points.position])),
                "yaxis": axis("velocity q' [rad/s]", range=span([points.velocity])),
                "showlegend": False,
                **select,
            },
            380,
        ),
        TIME: _over_time(points, name),
    }


def _over_time(points: Points, name: str) -> Figure:
    """Measured and modelled torque above what the models leave of it."""
    x, (measured, *left) = broken(points.time, thin(points.residuals[0]), points.torque, *points.residuals)
    label = f"Measured and modelled torque over time, and their difference, {name}"
    modelled = [measured - own for own in left]
    drawn = before_and_after(points.case, TIME, label, x, measured, modelled, left, ("torque", "residual", "N m"))
    noise = band(points.time[[0, -1]], np.full(2, 2 * points.noise), "noise (±2σ)", yaxis="y2")
    layout = drawn.layout | {"dragmode": "select", "selectdirection": "h", "hovermode": "closest"}
    # ranges of all of it, so that nothing moves when a selection lights up
    layout["xaxis"]["range"] = span([points.time], 0.01)
    layout["yaxis"]["range"] = span([points.torque])
    layout["yaxis2"]["range"] = span(points.residuals)
    return Figure(TIME, label, [noise, *drawn.data], layout, 420)


def _dots(x: Array, y: Array, color: str, size: float, **more: object) -> JSON:
    marker = {"color": color, "size": size}
    plain = {"type": "scatter", "mode": "markers", "x": numbers(x), "y": numbers(y), "marker": marker}
    return {**plain, "showlegend": False, **more}


def inside(points: Points, view: str, box: Mapping[str, Any]) -> Mask:
    """Windows within a box that was drawn in a view; `box` is what plotly.js calls a range."""
    ranges = {key: sorted(map(float, ends)) for key, ends in box.items() if len(ends) == 2}
    x = next((ends for key, ends in ranges.items() if key.startswith("x")), [-np.inf, np.inf])
    y = next((ends for key, ends in ranges.items() if key.startswith("y")), [-np.inf, np.inf])
    if view == TIME:
        return (points.time >= x[0]) & (points.time <= x[1])
    angle = wrapped(points.position) if view == MAP else points.position
    return (angle >= x[0]) & (angle <= x[1]) & (points.velocity >= y[0]) & (points.velocity <= y[1])


def within(points: Points, region: Region) -> Mask:
    """Windows within a region that stands out; none for a frequency, which is everywhere."""
    series = {name: getattr(points, name) for name in ("time", "position", "velocity", "torque")}
    if region.axis not in series:
        return np.zeros(len(points), dtype=bool)
    values = series[region.axis]
    if region.axis == "position" and turns(values):
        values = wrapped(values)
    return (values >= region.low) & (values <= region.high)


def lit(points: Points, selected: Mask, shown: int) -> dict[str, list[JSON]]:
    """Traces that each view shows on top of its own for a selection (R,)."""
    at = np.flatnonzero(selected)
    at = at[thin(points.residuals[shown][at], LIT)] if len(at) else at
    t, q, v = points.time[at], points.position[at], points.velocity[at]
    dots = {"hoverinfo": "skip", "name": "selected"}
    return {
        MAP: [_dots(wrapped(q), v, GLOW, 4, **dots)],
        PHASE: [_dots(q, v, GLOW, 4, **dots)],
        TIME: [
            _dots(t, points.torque[at], GLOW, 4, **dots),
            _dots(t, points.residuals[shown][at], GLOW, 4, yaxis="y2", **dots),
        ],
    }
