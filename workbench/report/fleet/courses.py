"""Parameters of each joint over time, and which of them drift."""

from __future__ import annotations

from datetime import UTC, datetime

from estimators.fleet import LEVEL, Course
from pendulum_env._typing import JSON
from workbench.report import words
from workbench.report.figure import Figure, axis, numbers
from workbench.report.section import Section
from workbench.survey.fleet import Fleet, Joint, Series
from workbench.survey.tables import by_chance, change, slope

SIGMAS = 2.0  # standard errors on either side
PLOTTED = 8  # parameters with a plot
SHOWN = 60  # joints in one plot: those that stand out, and others behind them
COLORS = ("--final", "--base", "--scheme-1", "--scheme-3", "--low", "--high")
ORDER = (Course.DRIFTS, Course.JUMPS, Course.SCATTERS, Course.STEADY)


def courses(fleet: Fleet) -> Section | None:
    """A plot for each parameter, and a table of all; nothing where no case was diagnosed."""
    if not fleet.joints:
        return None
    plotted = fleet.parameters[:PLOTTED]
    drifting = list(dict.fromkeys(series.parameter for _, series in (*fleet.drifting, *fleet.jumping)))
    plotted = [*drifting, *(name for name in plotted if name not in drifting)][: max(PLOTTED, len(drifting))]
    figures = [figure(fleet, name, number) for number, name in enumerate(plotted)]
    rows = [
        (joint, series, slope(series), by_chance(series.drift.chance), ORDER.index(series.course))
        for joint in fleet.joints
        for series in joint.series.values()
    ]
    rows.sort(key=lambda row: (row[4], row[0].label))
    content = {
        "figures": figures,
        "rows": rows,
        "drifting": fleet.drifting,
        "jumping": [(joint, series, change(series)) for joint, series in fleet.jumping],
        "sigmas": SIGMAS,
        "level": LEVEL,
    }
    return Section("courses", "Over time", "Parameters over time", content)


def figure(fleet: Fleet, parameter: str, number: int) -> Figure:
    """One parameter of all joints: those that drift in colours, with their lines."""
    having = [(joint, joint.series[parameter]) for joint in fleet.joints if parameter in joint.series]
    having.sort(key=lambda pair: ORDER.index(pair[1].course))
    data: list[JSON] = []
    colored = 0
    for joint, series in having[:SHOWN]:
        stands_out = series.course in (Course.DRIFTS, Course.JUMPS)
        color = COLORS[colored % len(COLORS)] if stands_out else "--train"
        colored += stands_out
        if series.course is Course.DRIFTS:
            data.append(_line(joint, series, color))
        data.append(_points(joint, series, color, stands_out))
    data.reverse()  # what stands out is drawn last
    unit = having[0][1].unit
    layout = {
        "xaxis": axis("", type="date"),
        "yaxis": axis(f"{parameter} [{words.unit(unit) or 1}]"),
        "hovermode": "closest",
    }
    layout["legend"] = {"traceorder": "reversed"}
    return Figure(f"course-{number}", f"{parameter} of every joint over time, with intervals", data, layout, 320)


def _points(joint: Joint, series: Series, color: str, stands_out: bool) -> JSON:
    return {
        "type": "scatter",
        "mode": "markers" if stands_out else "lines+markers",
        "line": {"color": color, "width": 0.8},
        "name": joint.label,
        "legendgroup": joint.label,
        "showlegend": stands_out,
        "x": [_date(stamp) for stamp in series.date],
        "y": numbers(series.value),
        "error_y": {
            "type": "data",
            "array": numbers(SIGMAS * series.error),
            "color": color,
            "thickness": 1.2,
            "width": 0,
        },
        "marker": {"color": color, "size": 6 if stands_out else 4},
        "opacity": 1.0 if stands_out else 0.45,
        "hovertemplate": f"{_escaped(joint.label)}<br>%{{x|%Y-%m-%d}}: %{{y:.4g}} {series.unit}<extra></extra>",
    }


def _line(joint: Joint, series: Series, color: str) -> JSON:
    ends = series.date.min(), series.date.max()
    weights = 1 / series.error**2
    centre = float(weights @ series.date / weights.sum())
    heights = [series.drift.level + series.drift.slope * (end - centre) / 86400 for end in ends]
    return {
        "type": "scatter",
        "mode": "lines",
        "legendgroup": joint.label,
        "showlegend": False,
        "x": [_date(end) for end in ends],
        "y": heights,
        "line": {"color": color, "width": 1.4},
        "hoverinfo": "skip",
    }


def _date(stamp: float) -> str:
    return f"{datetime.fromtimestamp(stamp, UTC):%Y-%m-%d %H:%M:%S}"


def _escaped(text: str) -> str:
    """Text in a label of plotly.js, which knows some HTML, and fills in what is in %{}."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("%{", "% {")
