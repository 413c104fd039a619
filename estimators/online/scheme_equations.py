"""Equations of all schemes from rows of the torque balance: gates, filters and running sums, in symbols."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.online.rows import VIEWS, History
from estimators.schemes.six import Integral, LowPass, Scheme, compute_decay
from pendulum_env.physics.symbols import make_symbols


def list_guards(schemes: Sequence[Scheme]) -> tuple[float | None, ...]:
    """List the different guards of schemes [s]."""
    return tuple(dict.fromkeys(scheme.guard for scheme in schemes))


def apply_gate(row: Any, gate: Any) -> Any:
    """Set a row (P,) to zero where a gate is closed, also where the row is not finite."""
    return np.array([np.where(gate, value, 0.0) for value in row], dtype=object)


def list_windows(schemes: Sequence[Scheme], period: float) -> list[int]:
    """List the numbers of rows in the sums of integral schemes; 0 sums from the start."""
    return [scheme.operator.samples(period) for scheme in schemes if isinstance(scheme.operator, Integral)]


def scheme_equations(
    schemes: Sequence[Scheme],
    views: Any,
    clear: Any,
    moving: Any,
    oldest: Any,
    index: Any,
    period: float,
    history: History,
) -> tuple[Any, Any]:
    """Update the equations of S schemes with one row, starting from rest.

    For a whole recording, the equations equal those of `Scheme.regression`.

    Args:
        schemes: S of them.
        views: the row in each view (3, P + 1).
        clear: whether the row is clear of stick, for each guard (G,).
        moving: whether the joint moves at the sample.
        oldest: sums of integral schemes one window ago, with their numbers of rows (K, P + 2).
        index: of the row since the start.
        period: between rows [s].
        history: states of the recurrence.

    Returns:
        phi and, in the last column, y (S, P + 1); and whether each equation is usable (S,).
    """
    guards, windows, width = list_guards(schemes), list_windows(schemes, period), views.shape[1]
    before, after = history.before, history.after
    before["clear"], after["clear"] = make_symbols("clear", len(guards)), clear
    before["moving"], after["moving"] = make_symbols("moving"), moving
    before["total"] = make_symbols("total", len(windows), width + 1)
    after["total"] = before["total"].copy()
    found, usable, sums = [], [], itertools.count()
    for place, scheme in enumerate(schemes):
        guard = guards.index(scheme.guard)
        gate = clear[guard]
        if scheme.view != "torque":  # over the step up to the sample
            gate = gate * before["clear"][guard]
        if scheme.view == "energy":
            gate = gate * moving * before["moving"]
        row = apply_gate(views[VIEWS.index(scheme.view)], gate)
        if isinstance(scheme.operator, LowPass):
            gain = 1.0 - compute_decay(scheme.operator.cutoff, period)
            for stage in range(scheme.operator.order):
                label = f"filter.{place}.{stage}"
                before[label] = make_symbols(label, width)
                after[label] = row = before[label] + gain * (row - before[label])
        if isinstance(scheme.operator, Integral):
            k = next(sums)
            after["total"][k] = total = before["total"][k] + np.array([*row * period, gate], dtype=object)
            *row, used = total - (oldest[k] if windows[k] else 0.0)
            gate = (2 * used >= windows[k] if windows[k] else gate) & (index >= max(1, windows[k]))
        found.append(row)
        usable.append(gate)
    return np.array(found), np.array(usable, dtype=object)
