"""Ranking of the candidate effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimators.diagnosis.result import Candidate, Detectable, Verdict
from pendulum_env.physics import effects
from workbench.report.case import Case
from workbench.report.section import Section

VERDICTS = {
    Verdict.SELECTED: "selected",
    Verdict.AMBIGUOUS: "ambiguous",
    Verdict.REJECTED: "rejected",
    Verdict.NOT_EXCITED: "not excited",
}


@dataclass(frozen=True)
class Row:
    """A candidate with its law and rank."""

    rank: int
    candidate: Candidate
    law: str
    verdict: str
    order: int


def candidates(case: Case) -> Section:
    """Every effect of the library with its verdict, score, error ratio and reason."""
    return ranked(case.diagnosis.candidates, case.diagnosis.detectable)


def ranked(found: Sequence[Candidate], detectable: Sequence[Detectable] = ()) -> Section:
    """The same of any candidates."""
    library = effects()
    order = list(VERDICTS)
    rows = [
        Row(
            rank,
            candidate,
            library[kind].law if (kind := candidate.effect.partition("@")[0]) in library else "",
            VERDICTS[candidate.verdict],
            order.index(candidate.verdict),
        )
        for rank, candidate in enumerate(found, 1)
    ]
    widest = max([1.25, *(min(row.candidate.error_ratio, 2.0) for row in rows)])
    content = {"rows": rows, "widest": widest, "detectable": detectable}
    return Section("candidates", "Candidates", "What was considered", content)
