"""Table 2: the paper's rows, its equations as printed, and ours, side by side."""

from __future__ import annotations

from dataclasses import dataclass

from estimators.paper import PARAMETERS, TABLE_2, Experiment
from estimators.paper.experiment import Score
from pendulum_env.plant import paper_plant
from workbench.report.section import Section

SYMBOLS = dict(zip(PARAMETERS, ("I", "mgl", "b", "fc"), strict=True))


@dataclass(frozen=True)
class Row:
    """One scheme: what the paper measured on its rig, and what both ways found in simulation."""

    scheme: str
    paper: tuple[float | None, ...]
    printed: Score
    ours: Score
    coverage: float


def table(experiment: Experiment) -> Section:
    """Values and errors of every scheme."""
    rows = [
        Row(scheme, paper, experiment.score("printed", scheme), experiment.score("ours", scheme), coverage)
        for scheme, paper in TABLE_2.items()
        for coverage in [experiment.coverage(scheme)]
    ]
    content = {
        "rows": rows,
        "truth": paper_plant().theta.tolist(),
        "symbols": SYMBOLS,
        "units": [paper_plant().estimates[name].unit for name in PARAMETERS],
        "runs": experiment.runs,
        "spread_paper": spread([row.paper for row in rows]),
        "spread_printed": spread([tuple(row.printed.theta) for row in rows]),
        "disagreement": {s: experiment.disagreement(s) for s in TABLE_2 if "hamiltonian" in s},
    }
    return Section("table-2", "Table 2", "Table 2, side by side", content)


def spread(rows: list[tuple[float | None, ...]]) -> tuple[str, float]:
    """Parameter on which schemes differ most from the dynamic model, the first row, and by which share."""
    reference = rows[0]
    differences = {
        symbol: max(abs(row[k] / base - 1) for row in rows if (row[k] is not None))  # type: ignore[operator]
        for k, (symbol, base) in enumerate(zip(SYMBOLS.values(), reference, strict=True))
        if base is not None
    }
    symbol = max(differences, key=lambda key: differences[key])
    return symbol, differences[symbol]
