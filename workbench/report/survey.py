"""Report on a survey: its tables, and the parameters that change over time."""

from collections.abc import Sequence
from html import escape

from estimators.figure import DRAWING, Figure, axis, numbers
from pendulum_env._typing import JSON
from workbench.report.page import assemble
from workbench.report.section import Section
from workbench.survey.table import LEVEL, Series, changes_table, recordings_table

COLORS = ("--final", "--base", "--scheme-1", "--scheme-2", "--scheme-3", "--low", "--high", "--train")


def render(rows: Sequence[JSON], series: Sequence[Series]) -> str:
    """Render a survey as one self-contained HTML page."""
    return assemble([section(rows, series)], f"survey of {len({row['recording'] for row in rows})} recordings")


def section(rows: Sequence[JSON], series: Sequence[Series]) -> Section:
    """Make the section with tables of recordings and of changes, and a plot."""
    changing = sorted((own for own in series if own.change), key=lambda own: own.trend.p_value)
    shown = (changing or series)[: len(COLORS)]
    content = {
        "recordings": recordings_table(rows),
        "changes": changes_table(changing),
        "level": LEVEL,
        "sigmas": DRAWING.sigmas,
        "figures": [over_time(shown)] if shown else [],
    }
    machines = len({own.machine for own in changing})
    title = f"Parameters change in {machines} machine{'s' * (machines != 1)}" if changing else "No parameter changes"
    return Section("survey", "Survey", title, content)


def over_time(series: Sequence[Series]) -> Figure:
    """Plot parameters over time, each relative to its mean."""
    data = []
    for own, color in zip(series, COLORS, strict=False):
        share = 100 / (abs(own.mean) or 1.0)
        data.append({
            "type": "scatter",
            "mode": "lines+markers",
            "name": escape(own.label),
            "x": (1000 * own.date).tolist(),  # [ms since 1970], as plotly.js takes dates
            "y": numbers(share * (own.value - own.mean)),
            "error_y": {
                **{"type": "data", "array": numbers(DRAWING.sigmas * share * own.std)},
                **{"color": color, "thickness": 1.2, "width": 0},
            },
            "marker": {"color": color, "size": 6},
            "line": {"color": color, "width": 0.8},
            "hovertemplate": "%{x|%Y-%m-%d}: %{y:.3g} %",
        })  # fmt: skip
    layout = {"xaxis": axis("", type="date"), "yaxis": axis("change from the mean [%]"), "showlegend": True}
    return Figure("trends", "Parameters over time, relative to their means", data, layout)
