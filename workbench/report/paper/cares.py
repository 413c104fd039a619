"""What each care buys: the largest error of every scheme with one care left out at a time, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimators.paper import TABLE_2, WAYS, Experiment
from pendulum_env.backends.sensing import COUNTS
from workbench.report.paper.table import SYMBOLS
from workbench.report.section import Section


@dataclass(frozen=True)
class Cell:
    """The parameter that a scheme gets least right in one way of doing it, and its median error as a share."""

    symbol: str
    error: float


def cares(experiment: Experiment) -> Section:
    """One row for each way."""
    rows = {way.id: (way.text, row(experiment, way.id)) for way in WAYS}
    content = {
        "rows": rows,
        "schemes": list(TABLE_2),
        "anatomy": experiment.anatomy,
        # two differences of a rounded angle: sqrt(6) times the deviation of the rounding, over the period squared
        "quantisation": np.sqrt(6 / 12) * 2 * np.pi / COUNTS * experiment.example.rate**2,
        "inertia": float(experiment.truth[0]),
    }
    return Section("cares", "What it takes", "What each care buys", content)


def row(experiment: Experiment, way: str) -> Mapping[str, Cell]:
    """Cell of every scheme."""
    cells = {}
    for scheme in TABLE_2:
        errors = dict(zip(SYMBOLS.values(), experiment.score(way, scheme).median.tolist(), strict=True))
        symbol = max(errors, key=lambda key: errors[key])
        cells[scheme] = Cell(symbol, errors[symbol])
    return cells
