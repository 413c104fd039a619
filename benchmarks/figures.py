"""Rates over bins and a confusion matrix, as tables and as one page of figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import plotly.graph_objects as go

from benchmarks.scoring import rate, wilson


@dataclass(frozen=True)
class Curve:
    """Share of successes among cases, by bins of some quantity.

    Attributes:
        quantity, success: what the cases are sorted by, and what counts.
        bins: lower and upper edge, number of successes and of cases, and mean of the quantity, empty bins left out.
    """

    quantity: str
    success: str
    bins: tuple[tuple[float, float, int, int, float], ...]

    @classmethod
    def of(cls, quantity: str, success: str, edges: Sequence[float], cases: Sequence[tuple[float, bool]]) -> Curve:
        """Sort cases (quantity, success) into bins between the edges."""
        bins = []
        for low, high in pairwise(edges):
            some = [case for case in cases if low <= case[0] < high]
            if some:
                mean = sum(value for value, _ in some) / len(some)
                bins.append((low, high, sum(success for _, success in some), len(some), mean))
        return cls(quantity, success, tuple(bins))

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Range, mean and rate of each bin."""
        return [
            (f"{low:g} to {high:g}", f"{mean:.3g}", rate(hits, count)) for low, high, hits, count, mean in self.bins
        ]

    def trace(self) -> go.Scatter:
        """Shares with their 95 % intervals over the means."""
        shares = [hits / count for _, _, hits, count, _ in self.bins]
        intervals = [wilson(hits, count) for _, _, hits, count, _ in self.bins]
        return go.Scatter(
            x=[mean for *_, mean in self.bins],
            y=shares,
            error_y={
                "array": [high - share for share, (_, high) in zip(shares, intervals, strict=True)],
                "arrayminus": [share - low for share, (low, _) in zip(shares, intervals, strict=True)],
            },
            text=[text for *_, text in self.rows],
            hovertemplate="%{x:.3g}: %{text}<extra></extra>",
            mode="lines+markers",
            showlegend=False,
        )


@dataclass(frozen=True)
class Confusion:
    """How often what is hidden (rows) was taken for what (columns)."""

    hidden: tuple[str, ...]
    selected: tuple[str, ...]
    counts: dict[tuple[str, str], int]

    def figure(self) -> go.Figure:
        """Heat map with the counts written in it."""
        table = [[self.counts.get((row, column), 0) for column in self.selected] for row in self.hidden]
        shares = [[count / max(1, sum(counts)) for count in counts] for counts in table]
        heat = go.Heatmap(
            x=self.selected,
            y=self.hidden,
            z=shares,
            text=[[str(count or "") for count in counts] for counts in table],
            texttemplate="%{text}",
            hovertemplate="%{y} taken for %{x}: %{text}<extra></extra>",
            colorscale="Blues",
            zmin=0,
            zmax=1,
            showscale=False,
        )
        figure = go.Figure(heat)
        title = {"text": "Hidden (rows) taken for (columns)", "y": 0.99}
        figure.update_layout(title=title, height=920, width=1100, margin={"t": 210})
        figure.update_yaxes(autorange="reversed", automargin=True)
        figure.update_xaxes(side="top", tickangle=-50, automargin=True)
        return figure


def write_page(path: Path, confusion: Confusion, power: Curve, reliability: Curve) -> None:
    """One self-contained HTML page."""
    figures = [confusion.figure()]
    for curve, scale in ((power, "log"), (reliability, "linear")):
        figure = go.Figure(curve.trace())
        figure.update_layout(title=f"{curve.success} by {curve.quantity}", height=420, width=720)
        figure.update_xaxes(title=curve.quantity, type=scale)
        figure.update_yaxes(title=f"share {curve.success}", range=[0, 1.05])
        figures.append(figure)
    figures[-1].add_scatter(x=[0, 1], y=[0, 1], mode="lines", line={"dash": "dot"}, hoverinfo="skip", showlegend=False)
    parts = [figure.to_html(full_html=False, include_plotlyjs=j == 0) for j, figure in enumerate(figures)]
    path.write_text(f"<!doctype html><meta charset=utf-8><title>Hidden effects</title>{''.join(parts)}\n")
