"""Ranking of the candidate effects, and the experiment that would settle what is open."""

from collections.abc import Sequence

import numpy as np

from estimators.diagnosis.result import Candidate, Detectable, Verdict
from pendulum_env.physics import nameable
from workbench.report.case import Case
from workbench.report.figure import Figure, Section, axis, line

ORDER = tuple(Verdict)  # of the column, the surest first


def candidates(case: Case) -> Section:
    """Every effect of the library with its verdict, score, error ratio and reason."""
    return ranked(case.diagnosis.candidates, case.diagnosis.detectable)


def ranked(found: Sequence[Candidate], detectable: Sequence[Detectable] = ()) -> Section:
    """The same of any candidates."""
    laws = {id: kind.law for id, kind in nameable().items()}
    rows = [(one, laws.get(one.effect.partition("@")[0], ""), ORDER.index(one.verdict)) for one in found]
    widest = max([1.25, *(min(one.error_ratio, 2.0) for one in found)])
    content = {"rows": rows, "widest": widest, "detectable": detectable}
    return Section("candidates", "Candidates", "What was considered", content)


def next_experiment(case: Case) -> Section | None:
    """The torque that would settle what is open; None if nothing is."""
    suggestion = case.diagnosis.suggestion
    if suggestion is None:
        return None
    time, torque = suggestion.samples()
    figure = Figure(
        "next-torque",
        "torque of the suggested experiment over time",
        [line(time, torque, "torque", "--final", "N m")],
        {"xaxis": axis("time [s]"), "yaxis": axis("torque [N m]"), "showlegend": False},
        height=220,
    )
    low, high = np.degrees(suggestion.reach)
    expected = f"angles from {low:.0f} to {high:.0f} degrees and speeds up to {suggestion.peak_speed:.2g} rad/s"
    content = {"figure": figure, "expected": expected, "aims": [aim.text for aim in suggestion.settles]}
    return Section("next", "What next", "The next experiment", content)
