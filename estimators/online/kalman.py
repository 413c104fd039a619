"""The recursion by filterpy: each regression is a Kalman filter whose state is theta and stands still.

A parameter that stands still has the transition F = 1 and no process noise, a row phi of the regression is the
measurement matrix H, and errors of unit variance are R = 1: the filter is then recursive least squares. Forgetting is
filterpy's fading memory, P / lambda before each equation; unlike ours it does not return to P(0).

Source: Labbe, Kalman and Bayesian Filters in Python, 2015, and its library filterpy; Simon, Optimal State Estimation,
2006, sections 3.3 and 7.4.
"""

import functools
from collections.abc import Callable

import numpy as np

from estimators.online.recursion import check_ranges, widened
from estimators.regression.recursive import PRIOR
from pendulum_env._typing import Array, Mask


class KalmanLeastSquares:
    """theta and P of (B, S) regressions with P parameters each, one after the other; attributes as of ours."""

    def __init__(self, batch: tuple[int, int], parameters: int, prior: float = PRIOR, forgetting: float = 1.0) -> None:
        """Take the shape (B, S), the number of parameters, P(0) on the diagonal and the forgetting factor.

        Raises:
            ValueError: if prior or forgetting is out of its range.
        """
        from filterpy.kalman import KalmanFilter  # loads scipy.stats, for which who does not ask for it need not wait

        check_ranges(prior, forgetting)
        self.prior, self.forgetting = prior, forgetting
        self._filter = KalmanFilter(parameters, 1)  # F = 1 and R = 1
        self._filter.Q[:], self._filter.alpha = 0.0, forgetting**-0.5
        self.theta = np.zeros((*batch, parameters))
        self.P = np.tile(prior * np.eye(parameters), (*batch, 1, 1))
        self.error, self.squares, self.count = np.zeros((3, *batch))

    def reset(self, which: Mask) -> None:
        """Those of the B start anew."""
        self.theta = np.where(which[:, None, None], 0.0, self.theta)
        self.error, self.squares, self.count = np.where(which[:, None], 0.0, [self.error, self.squares, self.count])
        self.P = np.where(which[:, None, None, None], self.prior * np.eye(self.P.shape[-1]), self.P)

    def spread(self) -> Callable[[], Array]:
        """What gives P of now, also later."""
        return functools.partial(np.asarray, self.P)

    def take(self, phi: Array, y: Array, usable: Mask) -> None:
        """Take in one equation y = phi' theta each: phi (B, S, P), y (B, S); those not usable change nothing."""
        theta, P, error = self.theta.copy(), self.P.copy(), np.zeros_like(y)  # what was handed out stays as it is
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

    def widen(self, increase: Array) -> None:
        """Add a diagonal (B, S, P) to P: the parameters may have moved since."""
        self.P = widened(self.P, increase, self.prior)
