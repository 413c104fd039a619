"""The next experiment: its torque over time, and what to expect of it."""

from __future__ import annotations

import numpy as np

from workbench.report.case import Case
from workbench.report.figure import Figure, axis, line
from workbench.report.section import Section


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
