"""Recursive least squares by the Kalman filter of filterpy, with theta as a constant state.

The transition is F = 1 without process noise, a row phi of the regression is the measurement matrix H, and the error
variance is R = 1. Forgetting is the fading memory of filterpy, P / lambda before each equation; unlike in
`SquareRootLeastSquares`, P does not return to P(0).

Source: Labbe, Kalman and Bayesian Filters in Python, 2015, and its library filterpy; Simon, Optimal State Estimation,
2006, sections 3.3 and 7.4.
"""

import functools
from collections.abc import Callable

import numpy as np

from estimators.online.recursion import check_ranges, inflate_covariance
from estimators.regression.recursive import PRIOR
from pendulum_env._typing import Array, Mask


class KalmanLeastSquares:
    """theta and P of (B, S) regressions, one after the other; attributes as of `SquareRootLeastSquares`."""

    def __init__(self, batch: tuple[int, int], parameters: int, prior: float = PRIOR, forgetting: float = 1.0) -> None:
        """Create the filters; arguments as of `SquareRootLeastSquares`.

        Raises:
            ValueError: if prior or forgetting is out of its range.
        """
        from filterpy.kalman import KalmanFilter  # loads scipy.stats, which is slow

        check_ranges(prior, forgetting)
        self.prior, self.forgetting = prior, forgetting
        self._filter = KalmanFilter(parameters, 1)  # F = 1 and R = 1
        self._filter.Q[:], self._filter.alpha = 0.0, forgetting**-0.5
        self.theta = np.zeros((*batch, parameters))
        self.P = np.tile(prior * np.eye(parameters), (*batch, 1, 1))
        self.error, self.squares, self.count = np.zeros((3, *batch))

    def reset(self, which: Mask) -> None:
        """Restart plants (B,)."""
        self.theta = np.where(which[:, None, None], 0.0, self.theta)
        self.error, self.squares, self.count = np.where(which[:, None], 0.0, [self.error, self.squares, self.count])
        self.P = np.where(which[:, None, None, None], self.prior * np.eye(self.P.shape[-1]), self.P)

    def unit_covariance(self) -> Callable[[], Array]:
        """Return a function that returns the current P, also later."""
        return functools.partial(np.asarray, self.P)

    def take(self, phi: Array, y: Array, usable: Mask) -> None:
        """Update with one equation y = phi' theta each: phi (B, S, P), y (B, S); unusable ones change nothing."""
        theta, P, error = self.theta.copy(), self.P.copy(), np.zeros_like(y)  # copies: returned arrays must not change
        for at in map(tuple, np.argwhere(usable)):
            self._filter.x, self._filter.P, self._filter.H = theta[at][:, None], P[at], phi[at][None]
            self._filter.predict()  # P = P / lambda
            self._filter.update(y[at])
            theta[at], P[at], error[at] = self._filter.x[:, 0], self._filter.P, self._filter.y.item()
        # a priori times a posteriori error: e^2 / (1 + phi' P phi)
        squares = error * (y - np.einsum("bsp,bsp->bs", phi, theta))
        self.squares = np.where(usable, self.forgetting * self.squares + squares, self.squares)
        self.count = np.where(usable, self.forgetting * self.count + 1.0, self.count)
        self.theta, self.P, self.error = theta, P, error

    def inflate(self, increase: Array) -> None:
        """Add a diagonal (B, S, P) to P."""
        self.P = inflate_covariance(self.P, increase, self.prior)
