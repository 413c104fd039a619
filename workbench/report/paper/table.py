"""Table 2: the paper's rows, its equations as printed, and ours, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
        Row(
            scheme=scheme,
            paper=paper,
            printed=experiment.score("printed", scheme),
            ours=experiment.score("ours", scheme),
            coverage=experiment.coverage(scheme),
        )
        for scheme, paper in TABLE_2.items()
    ]
    content = {
        "rows": rows,
        "truth": paper_plant().theta.tolist(),
        "symbols": SYMBOLS,
        "units": [paper_plant().estimates[name].unit for name in PARAMETERS],
        "runs": experiment.runs,
        "spread_paper": spread([row.paper for row in rows]),
        "spread_printed": spread([row.printed.theta.tolist() for row in rows]),
        "disagreement": {s: experiment.disagreement(s) for s in TABLE_2 if "hamiltonian" in s},
    }
    return Section("table-2", "Table 2", "Table 2, side by side", content)


def spread(rows: Sequence[Sequence[float | None]]) -> tuple[str, float]:
    """Parameter on which schemes differ most from the dynamic model, the first row, and by which share."""
    theta = np.array(rows, dtype=float)  # (S, 4), NaN where it was given
    share = np.nanmax(np.abs(theta / theta[0] - 1), axis=0)
    most = int(np.argmax(share))
    return list(SYMBOLS.values())[most], float(share[most])
