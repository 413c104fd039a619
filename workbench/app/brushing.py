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
from workbench.report.figure import Figure, axis, band, broken, line, numbers, span, stacked, thin
from workbench.report.sections.failures import planes

MAP, PHASE, TIME = "map", "phase", "time"
VIEWS = (MAP, PHASE, TIME)
LIT = 1500  # points of a selection that are drawn in one view
GLOW = "--brush"


@dataclass(frozen=True, eq=False)
class Points:
    """R windows of one recording under the models that are compared.

    Attributes:
        time, position, velocity, torque: at the windows' centres (R,), SI.
        residuals: measured minus modelled torque of each model, label and colour with it (R,) [N m].
        noise: torque error that measurement noise alone gives [N m].
    """

    time: Array
    position: Array
    velocity: Array
    torque: Array
    residuals: tuple[tuple[str, str, Array], ...]
    noise: float

    @classmethod
    def of(cls, case: Case, recording: Recording) -> Points:
        """Windows of one of the recordings, fitted and held-out ones alike."""
        parts = []
        for evidence in (case.training, case.testing):
            ends = np.cumsum([len(w.centers) for w in evidence.data.windows])[:-1]
            residuals = [np.split(residual, ends) for residual in case.residuals(evidence)]
            torque = np.split(evidence.data.torque(), ends)
            for k, w in enumerate(evidence.data.windows):
                if w.recording is recording:
                    x = w.at_centers()
                    parts.append((x.time, x.position, x.velocity, torque[k], *(own[k] for own in residuals)))
        time, position, velocity, torque_, *left = (np.concatenate(series) for series in zip(*parts, strict=True))
        labelled = tuple((label, color, own) for (label, color, _), own in zip(case.models, left, strict=True))
        return cls(time, position, velocity, torque_, labelled, case.diagnosis.noise_floor)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def samples(self) -> Samples:
        """What residuals are profiled over."""
        return Samples(self.time, self.position, self.velocity, self.torque)


def figures(points: Points, shown: int, name: str) -> dict[str, Figure]:
    """The three views; `shown` is the model whose residual the map shows."""
    residuals = [own for _, _, own in points.residuals]
    cells, map_layout = planes(points.position, points.velocity, residuals)[shown]
    label = points.residuals[shown][0]
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
    kept = thin(points.residuals[0][2])
    x, (measured, *left) = broken(points.time, kept, points.torque, *(own for _, _, own in points.residuals))
    data = [line(x, measured, "measured", "--measured", "N m", line={"color": "--measured", "width": 3})]
    data.append(band(points.time[[0, -1]], np.full(2, 2 * points.noise), "noise (±2σ)", yaxis="y2"))
    for (label, color, _), own in zip(points.residuals, left, strict=True):
        data.append(line(x, measured - own, label, color, "N m", legendgroup=label))
        data.append(line(x, own, label, color, "N m", legendgroup=label, yaxis="y2", showlegend=False))
    layout = stacked("torque [N m]", "residual [N m]", "time [s]")
    layout |= {"dragmode": "select", "selectdirection": "h", "hovermode": "closest"}
    # ranges of their own, so that nothing moves when a selection lights up
    layout["xaxis"]["range"] = span([points.time], 0.01)
    layout["yaxis"]["range"] = span([points.torque])
    layout["yaxis2"]["range"] = span([own for _, _, own in points.residuals])
    return Figure(TIME, f"Measured and modelled torque over time, and their difference, {name}", data, layout, 420)


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
    at = at[thin(points.residuals[shown][2][at], LIT)] if len(at) else at
    t, q, v = points.time[at], points.position[at], points.velocity[at]
    dots = {"hoverinfo": "skip", "name": "selected"}
    return {
        MAP: [_dots(wrapped(q), v, GLOW, 4, **dots)],
        PHASE: [_dots(q, v, GLOW, 4, **dots)],
        TIME: [
            _dots(t, points.torque[at], GLOW, 4, **dots),
            _dots(t, points.residuals[shown][2][at], GLOW, 4, yaxis="y2", **dots),
        ],
    }
