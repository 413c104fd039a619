"""Response of equations to perturbations of the torque, for laws that are not linear in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimators.regression.least_squares import SOLVER
from pendulum_env._typing import Array, Index, Mask

LEAST_SLOPE = 0.05  # lower limit of the derivative of an equation by the torque; keeps errors finite


@dataclass(frozen=True, eq=False)
class TorqueResponse:
    """Change of the left-hand sides of R equations under perturbations of the torque.

    Attributes:
        perturbations: perturbations in each equation (R, J) [N m], increasing, zero in the middle.
        change: change of the left-hand side under each (R, J) [N m], with the share of noise in the motion; equal to
            the perturbation for a linear equation.
        slope: derivative of the left-hand side by the torque (R,).
    """

    perturbations: Array
    change: Array
    slope: Array

    def __getitem__(self, rows: Mask) -> TorqueResponse:
        """Return the response of some equations (R,)."""
        return TorqueResponse(self.perturbations[rows], self.change[rows], self.slope[rows])

    @classmethod
    def join(cls, parts: Sequence[TorqueResponse]) -> TorqueResponse:
        """Join the responses of several sets of equations."""
        return cls(
            *(
                np.concatenate(series)
                for series in zip(*((p.perturbations, p.change, p.slope) for p in parts), strict=True)
            )
        )

    @property
    def reach(self) -> Array:
        """Half of the largest perturbation of each equation (R,) [N m]."""
        return 0.5 * self.perturbations[:, -1]

    @cached_property
    def slopes(self) -> tuple[Index, Array, Array]:
        """Indices (B,) of equations with a nonlinear response; its slopes over steps of perturbations.

        Returns:
            Indices, steps between perturbations (B, J - 1) [N m], slopes of the response over them (B, J - 1).
        """
        steps = np.diff(self.perturbations, axis=1)
        slopes = np.diff(self.change, axis=1) / steps
        curved = np.flatnonzero(np.abs(slopes - 1.0).max(axis=1) >= SOLVER.linear_response)
        return curved, steps[curved], slopes[curved]

    @cached_property
    def _steady_changes(self) -> tuple[Array, Array]:
        """Slopes and changes of the nonlinear equations by `_integrate_slopes`, if no column depends on the torque."""
        curved, steps, response_slopes = self.slopes
        return _integrate_slopes(steps, response_slopes, np.zeros(len(curved)))

    def find_errors(self, residual: Array, column_slope: Array | None) -> tuple[Index, Array, Array]:
        """Return indices of the nonlinear equations, their errors [N m], and their slopes there, (B,) each.

        `residual` (R,) is y - phi theta, `column_slope` (R,) the derivative of phi theta by the torque; None if zero.
        """
        curved, steps, response_slopes = self.slopes
        slopes, changes = (
            self._steady_changes
            if column_slope is None
            else _integrate_slopes(steps, response_slopes, column_slope[curved])
        )
        interval = np.clip(np.count_nonzero(changes < -residual[curved, None], axis=1) - 1, 0, steps.shape[1] - 1)
        rows = np.arange(len(curved))
        start, slope = self.perturbations[curved, interval], slopes[rows, interval]
        return curved, (residual[curved] + changes[rows, interval]) / slope - start, slope


def _integrate_slopes(steps: Array, response_slopes: Array, column_slope: Array) -> tuple[Array, Array]:
    """Return net slopes of equations between perturbations (B, J - 1), and net changes from zero to each (B, J) [N m].

    `steps` between perturbations (B, J - 1) [N m] have slopes of the response (B, J - 1). The derivative of phi theta
    by the torque, `column_slope` (B,), is subtracted; the net slope is at least `LEAST_SLOPE`.
    """
    slopes = np.maximum(response_slopes - column_slope[:, None], LEAST_SLOPE)
    changes = np.cumsum(np.column_stack([np.zeros(len(steps)), slopes * steps]), axis=1)
    return slopes, changes - changes[:, [steps.shape[1] // 2]]
