"""Ranking of the candidate effects."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.diagnosis.result import Candidate, Detectable, Verdict
from pendulum_env.physics import effects
from workbench.report.case import Case
from workbench.report.section import Section

ORDER = tuple(Verdict)  # of the column, the surest first


def candidates(case: Case) -> Section:
    """Every effect of the library with its verdict, score, error ratio and reason."""
    return ranked(case.diagnosis.candidates, case.diagnosis.detectable)


def ranked(found: Sequence[Candidate], detectable: Sequence[Detectable] = ()) -> Section:
    """The same of any candidates."""
    laws = {id: kind.law for id, kind in effects().items()}
    rows = [(one, laws.get(one.effect.partition("@")[0], ""), ORDER.index(one.verdict)) for one in found]
    widest = max([1.25, *(min(one.error_ratio, 2.0) for one in found)])
    content = {"rows": rows, "widest": widest, "detectable": detectable}
    return Section("candidates", "Candidates", "What was considered", content)
