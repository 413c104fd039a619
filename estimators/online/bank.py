"""From rows to the equations of all schemes at once: gates, filters and running sums, in symbols."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.online.rows import VIEWS, Course
from estimators.schemes.six import Integral, LowPass, Scheme, forgets
from pendulum_env.physics.symbols import names


def guards_of(schemes: Sequence[Scheme]) -> tuple[float | None, ...]:
    """The guards that any scheme has [s]."""
    return tuple(dict.fromkeys(scheme.guard for scheme in schemes))


def gated(row: Any, gate: Any) -> Any:
    """A row (P,) where a gate is open, and zero where it is not, whatever a law comes to there."""
    return np.array([np.where(gate, value, 0.0) for value in row], dtype=object)


def windows_of(schemes: Sequence[Scheme], period: float) -> list[int]:
    """Rows over which the schemes that sum do so, 0 from the start on."""
    return [scheme.operator.samples(period) for scheme in schemes if isinstance(scheme.operator, Integral)]


def equations(
    schemes: Sequence[Scheme],
    views: Any,
    clear: Any,
    moving: Any,
    oldest: Any,
    index: Any,
    period: float,
    course: Course,
) -> tuple[Any, Any]:
    """Equations of S schemes after one more row, from rest, as their `regression` has them for whole recordings.

    Takes the row in each view (3, P + 1), whether it is clear of stick for each guard (G,), whether its sample moves,
    sums a window ago of each scheme that sums and the number of rows in them (K, P + 2), the index of the row in its
    run and the time between rows [s]. Returns phi and, in the last place, y (S, P + 1), and whether they may be used
    (S,).
    """
    guards, windows, width = guards_of(schemes), windows_of(schemes, period), views.shape[1]
    before, after = course.before, course.after
    before["clear"], after["clear"] = names("clear", len(guards)), clear
    before["moving"], after["moving"] = names("moving"), moving
    before["total"] = names("total", len(windows), width + 1)
    after["total"] = before["total"].copy()
    found, usable, sums = [], [], itertools.count()
    for place, scheme in enumerate(schemes):
        guard = guards.index(scheme.guard)
        gate = clear[guard]
        if scheme.view != "torque":  # over the step up to the sample
            gate = gate * before["clear"][guard]
        if scheme.view == "energy":
            gate = gate * moving * before["moving"]
        row = gated(views[VIEWS.index(scheme.view)], gate)
        if isinstance(scheme.operator, LowPass):
            gain = 1.0 - forgets(scheme.operator.cutoff, period)
            for stage in range(scheme.operator.order):
                label = f"filter.{place}.{stage}"
                before[label] = names(label, width)
                after[label] = row = before[label] + gain * (row - before[label])
        if isinstance(scheme.operator, Integral):
            k = next(sums)
            after["total"][k] = total = before["total"][k] + np.array([*row * period, gate], dtype=object)
            *row, used = total - (oldest[k] if windows[k] else 0.0)
            gate = (2 * used >= windows[k] if windows[k] else gate) & (index >= max(1, windows[k]))
        found.append(row)
        usable.append(gate)
    return np.array(found), np.array(usable, dtype=object)
