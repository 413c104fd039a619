"""Nonlinear least squares by damped Gauss-Newton, for all searches over parameters.

A place is a set of parameters. Near it the errors e are linear in a step s, e + J s. Each iteration solves

    (J' J + d D) s = -J' e,   D the diagonal of J' J, for each damping d,

tries these steps, and continues from the best place until the decrease of the cost is zero or small.

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
class LocalErrors(Generic[Known]):
    """Errors near a place, to first order.

    Attributes:
        known: the place, with data for trials of steps.
        cost: squared error, or negative log likelihood.
        error: weighted errors (R,).
        slopes: derivatives of the errors by a step of the S parameters, per unit of the step (R, S).
        at_least, at_most: masks of the parameters at their lower and upper bound (S,), which no step crosses.
    """

    known: Known
    cost: float
    error: Array
    slopes: Array
    at_least: Mask | None = None
    at_most: Mask | None = None

    def step(self, damping: float) -> Array:
        """Return the step (S,) under a damping d; zero for parameters at a bound that it would cross."""
        size = np.sqrt(damping) * np.linalg.norm(self.slopes, axis=0)
        rows = np.vstack([self.slopes, np.diag(size)]) if damping else self.slopes
        target = np.append(-self.error, np.zeros(len(rows) - len(self.error)))
        step, free = np.zeros(len(size)), np.ones(len(size), dtype=bool)
        while free.any():
            step[:] = 0.0
            step[free] = solve_least_squares(rows[:, free], target)
            leaves_bounds = np.zeros(len(size), dtype=bool)
            if self.at_least is not None and self.at_most is not None:
                leaves_bounds = (self.at_least & (step < 0)) | (self.at_most & (step > 0))
            if not leaves_bounds.any():
                break
            free &= ~leaves_bounds
        return step


@dataclass(frozen=True)
class StopRule:
    """Rule for the end of an iteration.

    Attributes:
        iterations: largest number of iterations.
        dampings: dampings of the steps in each iteration.
        by_offset: whether the iteration also ends if `is_converged` holds for the first step.
        least: limit of a small decrease of the cost.
        of_cost: limit of a small decrease, as a share of the cost.
        of_fall: limit of a small decrease, as a share of the decrease so far.
        patience: total number of small decreases after which the iteration ends.
    """

    iterations: int
    dampings: Sequence[float] = (0.0,)
    by_offset: bool = False
    least: float = 0.0
    of_cost: float = 0.0
    of_fall: float = 0.0
    patience: int = 1

    def compute_small_decrease(self, first: float, cost: float) -> float:
        """Return the limit of a small decrease, from the cost of the start and the present cost."""
        return max(self.least, self.of_cost * cost, self.of_fall * (first - cost))


def gauss_newton(
    place: Place,
    linearise: Callable[[Place], LocalErrors[Known]],
    choose_step: Callable[[LocalErrors[Known], list[Array]], tuple[Place, float]],
    rule: StopRule,
) -> Place:
    """Find a place of locally least cost; `place` itself if no step lowers its cost.

    Args:
        place: start.
        linearise: function from a place to the errors near it.
        choose_step: function from errors and steps (S,) to the next place and its cost; it may shorten steps.
        rule: end of the iteration.
    """
    first, n_small = None, 0
    for _ in range(rule.iterations):
        local = linearise(place)
        first = local.cost if first is None else first
        steps = [local.step(damping) for damping in rule.dampings]
        if rule.by_offset and is_converged(local.error, local.slopes @ steps[0]):
            break
        next_place, cost = choose_step(local, steps)
        if not cost < local.cost:
            break
        place = next_place
        n_small += local.cost - cost < rule.compute_small_decrease(first, local.cost)
        if n_small == rule.patience:
            break
    return place


def choose_least(places: Sequence[Place], costs: Sequence[float] | Array) -> tuple[Place, float]:
    """Return the place of least cost, and its cost."""
    k = int(np.argmin(costs))
    return places[k], float(costs[k])
