"""Nonlinear least squares by damped Gauss-Newton: the one iteration of all searches that move parameters.

Near a place the errors e are linear in a step s of its parameters, e + J s. Each turn asks for the steps that solve

    (J' J + d D) s = -J' e,   D the diagonal of J' J, for each damping d,

tries where they lead, and goes on from the best place, until no step lowers the cost, or none by much.

Source: Nocedal and Wright, Numerical Optimization, 2nd edition, chapter 10.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from estimators.regression.least_squares import is_converged, solve_least_squares
from pendulum_env._typing import Array, Mask

Place = TypeVar("Place")
Known = TypeVar("Known")


@dataclass(frozen=True)
class Near(Generic[Known]):
    """Errors near a place, to first order.

    Attributes:
        known: what it was made of: the place, with what trials of steps from it need.
        cost: what is lowered, the squared error or a negative log likelihood.
        error: weighted (R,).
        slopes: their derivatives by a step of the S parameters, in the units that the step is in (R, S).
        at_least, at_most: parameters that are at a bound, which a step may not leave (S,); none if not given.
    """

    known: Known
    cost: float
    error: Array
    slopes: Array
    at_least: Mask | None = None
    at_most: Mask | None = None

    def step(self, damping: float) -> Array:
        """Return the step (S,) under a damping; a parameter that would leave its bounds stays."""
        size = np.sqrt(damping) * np.linalg.norm(self.slopes, axis=0)
        rows = np.vstack([self.slopes, np.diag(size)]) if damping else self.slopes
        target = np.append(-self.error, np.zeros(len(rows) - len(self.error)))
        step, free = np.zeros(len(size)), np.ones(len(size), dtype=bool)
        while free.any():
            step[:] = 0.0
            step[free] = solve_least_squares(rows[:, free], target)
            out = np.zeros(len(size), dtype=bool)
            if self.at_least is not None and self.at_most is not None:
                out = (self.at_least & (step < 0)) | (self.at_most & (step > 0))
            if not out.any():
                break
            free &= ~out
        return step


@dataclass(frozen=True)
class Rule:
    """When an iteration ends.

    Attributes:
        turns: largest number.
        dampings: of the steps that each turn asks for.
        by_offset: whether a step that is short against standard errors is not taken, see `is_converged`.
        least: fall of the cost in a turn at which it is the last,
        of_cost: or share of the cost,
        of_fall: or share of what the cost has fallen so far.
        patience: number of turns with so small a decrease after which the iteration ends.
    """

    turns: int
    dampings: Sequence[float] = (0.0,)
    by_offset: bool = False
    least: float = 0.0
    of_cost: float = 0.0
    of_fall: float = 0.0
    patience: int = 1

    def enough(self, first: float, cost: float) -> float:
        """Return the least fall of the cost for another turn, given the cost at first and now."""
        return max(self.least, self.of_cost * cost, self.of_fall * (first - cost))


def gauss_newton(
    place: Place,
    near: Callable[[Place], Near[Known]],
    best: Callable[[Near[Known], list[Array]], tuple[Place, float]],
    rule: Rule,
) -> Place:
    """Find the place of least cost near a place.

    Args:
        place: to start from.
        near: errors near a place.
        best: of the places that steps (S,) lead to, whole or in part, the one of least cost, and its cost.
        rule: when to end.
    """
    first, slow = None, 0
    for _ in range(rule.turns):
        local = near(place)
        first = local.cost if first is None else first
        steps = [local.step(damping) for damping in rule.dampings]
        if rule.by_offset and is_converged(local.error, local.slopes @ steps[0]):
            break
        found, cost = best(local, steps)
        if not cost < local.cost:
            break
        place = found
        slow += local.cost - cost < rule.enough(first, local.cost)
        if slow == rule.patience:
            break
    return place


def choose_least(places: Sequence[Place], costs: Sequence[float] | Array) -> tuple[Place, float]:
    """Return the place of least cost, and its cost."""
    k = int(np.argmin(costs))
    return places[k], float(costs[k])
