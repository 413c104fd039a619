"""Plots as plain data for Plotly; colours are CSS variables of the page such as `--measured`."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from pendulum_env._typing import JSON, Array, ArrayLike, Index
from pendulum_env.formatting import typeset

DIGITS = 5  # significant digits of plotted numbers
BROAD = 3.4  # width of a measured curve under those of models [px]
POINTS = 2400  # most points of a curve, more than the width of a screen
ROOM = 2.5  # least height of a plot [half widths of its noise band]


@dataclass(frozen=True)
class Figure:
    """Data and layout of one plot."""

    id: str  # unique on the page
    label: str  # description for screen readers
    data: list[JSON]  # traces for plotly.js
    layout: JSON  # layout for plotly.js
    height: int = 340  # [px]
    caption: str = ""  # above the plot


def round_numbers(values: Array) -> list[float | None]:
    """Round values to `DIGITS` significant digits, flattened to a list; non-finite values become None."""
    values = np.asarray(values, dtype=float)
    size = np.floor(np.log10(np.maximum(np.abs(np.nan_to_num(values)), 1e-30)))
    scale = 10.0 ** (DIGITS - 1 - np.clip(size, -12, 12))
    rounded = np.round(values * scale) / scale  # prints without trailing digits
    return [value if isfinite(value) else None for value in rounded.ravel().tolist()]


def select_samples(series: Array, max_count: int = POINTS) -> Index:
    """Return indices of about `max_count` samples of a series (N,): the minimum and maximum of equal parts."""
    if len(series) <= max_count:
        return np.arange(len(series))
    parts = np.array_split(np.arange(len(series)), max_count // 2)
    return np.unique([(part[np.argmin(series[part])], part[np.argmax(series[part])]) for part in parts])


def make_line(x: Array, y: Array, name: str, color: str, unit: str, **options: object) -> JSON:
    """Make the trace of a curve y (N,) over x (N,)."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": round_numbers(x),
        "y": round_numbers(y),
        "line": {"color": color, "width": 1.6},
        "hovertemplate": f"%{{y:.3g}} {typeset(unit)}",
        **options,
    }


def make_band(x: Array, half: Array, name: str, middle: ArrayLike = 0.0, **options: object) -> JSON:
    """Make the trace of a filled band from `middle - half` to `middle + half` (N,)."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": round_numbers(np.r_[x, x[::-1]]),
        "y": round_numbers(np.r_[middle + half, (middle - half)[::-1]]),
        "fill": "toself",
        "fillcolor": "--noise",
        "line": {"width": 0},
        "legendrank": 2000,
        "hoverinfo": "skip",
        **options,
    }


def measure_reach(values: Array, band: ArrayLike) -> float:
    """Return the height of a plot of values (N,): the largest of them, and room beside the noise band about zero."""
    return max(1.08 * float(np.nanmax(np.abs(values))), ROOM * float(np.median(band)))


def make_axis(title: str, **options: object) -> JSON:
    """Make an axis with a title."""
    return {"title": {"text": typeset(title)}, **options}


def insert_gaps(time: Array, indices: Index, *series: Array) -> tuple[Array, list[Array]]:
    """Select samples of time (N,) and series (N,) by index, with NaN wherever the time has a gap."""
    steps = np.diff(time)
    run = np.r_[0, np.cumsum(steps > 1.5 * np.median(steps))][indices] if len(steps) else np.zeros(len(indices))
    gaps = np.flatnonzero(np.diff(run)) + 1
    return np.insert(time[indices], gaps, np.nan), [np.insert(values[indices], gaps, np.nan) for values in series]


def make_stacked_layout(titles: Sequence[str]) -> JSON:
    """Make the layout of plots over time above each other, with one range and one cursor; `titles`: of ordinates."""
    count, gap = len(titles), 0.02
    time = make_axis("time [s]", anchor=f"y{count}", unifiedhovertitle={"text": "%{x:.3f} s"})
    layout = {"xaxis": time, "hovermode": "x unified", "hoversubplots": "axis"}
    for k, title in enumerate(titles):
        domain = [1 - (k + 1) / count + gap * (k + 1 < count), 1 - k / count - gap * (k > 0)]
        layout[f"yaxis{k + 1 if k else ''}"] = make_axis(title, domain=domain)
    return layout
