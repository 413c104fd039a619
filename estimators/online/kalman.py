"""The recursion by filterpy: each regression is a Kalman filter whose state is theta and stands still.

A parameter that stands still has the transition F = 1 and no process noise, a row phi of the regression is the
measurement matrix H, and errors of unit variance are R = 1: the filter is then recursive least squares. Forgetting is
filterpy's fading memory, P / lambda before each equation, alpha^2 = 1 / lambda; unlike ours it does not return to P(0).

Source: Labbe, Kalman and Bayesian Filters in Python, 2015, and its library filterpy; Simon, Optimal State Estimation,
2006, sections 3.3 and 7.4.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from estimators.online.recursion import SquareRootLeastSquares, check_ranges
from estimators.regression.recursive import PRIOR
from pendulum_env._typing import Array, Mask
from pendulum_env.lookup import find

OURS = SquareRootLeastSquares.__name__
FADING = ("KalmanFilter", "FadingKalmanFilter")  # those of filterpy that can forget
NAMES = (OURS, *FADING, "SquareRootKalmanFilter", "InformationFilter")


class Recursion(Protocol):
    """theta and P of (B, S) regressions with P parameters each; see `SquareRootLeastSquares` for the attributes."""

    prior: float
    theta: Array
    error: Array
    squares: Array
    count: Array

    @property
    def P(self) -> Array:
        """Covariance for unit noise (B, S, P, P)."""

    def spread(self) -> Callable[[], Array]:
        """What gives P of now, also later: few steps are looked at."""

    def reset(self, which: Mask) -> None:
        """Those of the B start anew."""

    def reset_covariance(self, which: Mask) -> None:
        """Those of the B keep their estimates and forget how sure they are."""

    def take(self, phi: Array, y: Array, usable: Mask) -> None:
        """Take in one equation y = phi' theta each: phi (B, S, P), y (B, S); those not usable change nothing."""

    def widen(self, increase: Array) -> None:
        """Add a diagonal (B, S, P) to P: the parameters may have moved since."""


def name_of(recursion: str | type) -> str:
    """Name of a recursion that was given by name or by class.

    Raises:
        ValueError: if there is none of that name.
    """
    name = recursion if isinstance(recursion, str) else recursion.__name__
    return find("recursion", name, {known: known for known in NAMES})


def recursion_of(name: str, batch: tuple[int, int], parameters: int, prior: float, forgetting: float) -> Recursion:
    """Recursion of that name for (B, S) regressions.

    Raises:
        ValueError: if prior or forgetting is out of its range, or the filter cannot forget.
    """
    if name == OURS:
        return SquareRootLeastSquares(batch, parameters, prior, forgetting)
    return KalmanLeastSquares(name, batch, parameters, prior, forgetting)


class KalmanLeastSquares:
    """theta and P of (B, S) regressions with P parameters each, by filters of filterpy; attributes as of ours."""

    def __init__(
        self, name: str, batch: tuple[int, int], parameters: int, prior: float = PRIOR, forgetting: float = 1.0
    ) -> None:
        """Take the filter's name, the shape (B, S), the number of parameters, P(0) and the forgetting factor.

        Raises:
            ValueError: if prior or forgetting is out of its range, or the filter cannot forget.
        """
        check_ranges(prior, forgetting)
        if forgetting < 1 and name not in FADING:
            raise ValueError(f"{name} has no fading memory: give forgetting=1, or one of {', '.join((OURS, *FADING))}")
        self.prior, self.forgetting = prior, forgetting
        self._name, self._shape, self._parameters = name, batch, parameters
        self.theta = np.zeros((*batch, parameters))
        self.error, self.squares, self.count = np.zeros((3, *batch))
        self._filters = [[self._fresh(np.zeros(parameters)) for _ in range(batch[1])] for _ in range(batch[0])]

    def _fresh(self, theta: Array) -> Any:
        """A filter that knows no more than P(0)."""
        from filterpy import kalman  # loads scipy.stats, for which who does not ask for it need not wait

        kind, size = getattr(kalman, self._name), self._parameters
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # FadingKalmanFilter recommends KalmanFilter
            if self._name == "FadingKalmanFilter":
                made = kind(alpha=self.forgetting**-0.5, dim_x=size, dim_z=1)
            elif self._name == "InformationFilter":  # its likelihood mixes the shapes of x and z
                made = kind(dim_x=size, dim_z=1, compute_log_likelihood=False)
            else:
                made = kind(dim_x=size, dim_z=1)
        made.x = theta[:, None].copy()
        if self._name == "KalmanFilter":
            made.alpha = self.forgetting**-0.5
        if self.forgetting < 1:
            made.Q = np.zeros((size, size))
        _set(made, self.prior * np.eye(size))
        return made

    def reset(self, which: Mask) -> None:
        """Those of the B start anew."""
        for name in ("theta", "error", "squares", "count"):
            series = getattr(self, name).copy()  # what was handed out stays as it is
            series[which] = 0.0
            setattr(self, name, series)
        self.reset_covariance(which)

    def reset_covariance(self, which: Mask) -> None:
        """Those of the B keep their estimates and forget how sure they are."""
        for b in np.flatnonzero(which):
            self._filters[b] = [self._fresh(theta) for theta in self.theta[b]]

    @property
    def P(self) -> Array:
        """Covariance for unit noise (B, S, P, P)."""
        return self.spread()()

    def spread(self) -> Callable[[], Array]:
        """What gives P of now, also later: few steps are looked at."""
        inverse = self._name == "InformationFilter"
        parts = [[one.P_inv if inverse else one.P for one in row] for row in self._filters]
        return functools.partial(_stacked, parts, inverse)

    def take(self, phi: Array, y: Array, usable: Mask) -> None:
        """Take in one equation y = phi' theta each: phi (B, S, P), y (B, S); those not usable change nothing."""
        theta, error = self.theta.copy(), np.zeros(self._shape)
        squares, count = self.squares.copy(), self.count.copy()
        for b, s in np.argwhere(usable):
            one, row, value = self._filters[b][s], phi[b, s][None], y[b, s]
            if self.forgetting < 1:
                one.predict()  # P = P / lambda
            one.H = row
            one.update(value)
            theta[b, s], error[b, s] = one.x[:, 0], np.ravel(one.y)[0]
            # a priori times a posteriori error: e^2 / (1 + phi' P phi)
            squares[b, s] = self.forgetting * squares[b, s] + error[b, s] * (value - row[0] @ theta[b, s])
            count[b, s] = self.forgetting * count[b, s] + 1.0
        self.theta, self.error, self.squares, self.count = theta, error, squares, count

    def widen(self, increase: Array) -> None:
        """Add a diagonal (B, S, P) to P: the parameters may have moved since."""
        for b, row in enumerate(self._filters):
            for s, one in enumerate(row):
                spread = np.array(one.P)
                room = np.maximum(self.prior - np.diag(spread), 0.0)  # no further than P(0)
                _set(one, spread + np.diag(np.minimum(increase[b, s], room)))


def _stacked(parts: list[list[Array]], inverse: bool) -> Array:
    return np.linalg.inv(np.array(parts)) if inverse else np.array(parts)


def _set(one: Any, P: Array) -> None:
    """Give a filter its covariance (P, P)."""
    if hasattr(one, "P_inv"):
        one.P_inv = np.linalg.inv(P)
    else:
        one.P = P
