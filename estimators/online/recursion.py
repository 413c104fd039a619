"""Recursive least squares, the paper's equation (6), for a batch of regressions: in square-root form or by filterpy."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from estimators.regression.recursive import PRIOR
from pendulum_env._typing import Array, Mask
from pendulum_env.physics.compiled import Machine, SymbolicStep
from pendulum_env.physics.symbols import make_symbols


@dataclass(frozen=True, eq=False)
class RecursionState:
    """State of (B, S) regressions with P parameters each after a sample.

    Attributes:
        theta: estimates (B, S, P).
        squares: sum of squared errors, with forgetting (B, S).
        count: number of equations, with forgetting (B, S).
        prior: P(0) on the diagonal.
        compute_P: function that computes P.
    """

    theta: Array
    squares: Array
    count: Array
    prior: float
    compute_P: Callable[[], Array]

    @cached_property
    def P(self) -> Array:
        """Covariance for unit noise (B, S, P, P)."""
        return self.compute_P()


class SquareRootLeastSquares:
    """theta and P of (B, S) regressions with P parameters each.

    P = S S' is stored as its factor S and stays symmetric and positive definite.
    Source: Potter's update, in Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, chapter II.

    Attributes:
        error: last a-priori errors (B, S), 0 for an unused equation.
        squares: sum of squared errors, with forgetting (B, S).
        count: number of equations, with forgetting (B, S).
        variance: variance of the last a-priori errors for unit noise, 1 + phi' P phi (B, S).
    """

    def __init__(self, batch: tuple[int, int], parameters: int, prior: float = PRIOR, forgetting: float = 1.0) -> None:
        """Create the recursions of a batch (B, S), with P(0) = prior on the diagonal and the factor lambda."""
        check_ranges(prior, forgetting)
        self.prior, self.forgetting = prior, forgetting
        self._machine = Machine(_write_update, (parameters, forgetting, prior), *batch[::-1])
        self.theta = np.zeros((*batch, parameters))
        self.root = np.sqrt(prior) * np.tile(np.eye(parameters), (*batch, 1, 1))
        self.error, self.squares, self.count, self.variance = np.zeros((4, *batch))
        self._n_updates = 0

    @property
    def theta(self) -> Array:
        """Return the estimates (B, S, P)."""
        return self._theta

    @theta.setter
    def theta(self, theta: Array) -> None:
        self._theta = np.array(theta)
        self._machine.states["theta"].T[:] = theta

    @property
    def root(self) -> Array:
        """Return the current factor of P for unit noise (B, S, P, P)."""
        return self._machine.states["root"].copy().transpose(3, 2, 0, 1)

    @root.setter
    def root(self, root: Array) -> None:
        self._machine.states["root"][:] = root.transpose(2, 3, 1, 0)

    def reset(self, which: Mask) -> None:
        """Restart plants (B,): theta and sums are 0, P is P(0)."""
        self._machine.reset(which)
        self._read_state()
        root = self.root
        root[which] = np.sqrt(self.prior) * np.eye(root.shape[-1])
        self.root = root

    @property
    def P(self) -> Array:
        """Return the covariance for unit noise (B, S, P, P)."""
        return self.state.P

    @property
    def state(self) -> RecursionState:
        """Return the current state, which later equations do not change."""
        compute_P = functools.partial(_multiply_by_transpose, self.root)
        return RecursionState(self.theta, self.squares, self.count, self.prior, compute_P)

    def take(self, phi: Array, y: Array, usable: Mask) -> None:
        """Update with one equation y = phi' theta each: phi (B, S, P), y (B, S); unusable ones are ignored."""
        inputs, size = self._machine.inputs, phi.shape[-1]
        inputs["phi"].T[:], inputs["y"].T[:], inputs["used"].T[:] = phi, y, usable
        if self.forgetting < 1:
            inputs["turn"][:] = 0.0
            inputs["turn"][self._n_updates % size] = 1.0
            self._n_updates += 1
        self._machine.step()
        self._read_state()

    def _read_state(self) -> None:
        now = self._machine.states
        # copies: returned arrays must not change
        self._theta, sums = now["theta"].copy().T, now["sums"].copy()
        self.error, self.squares, self.count, self.variance = sums.swapaxes(-1, -2)


class RootRecursion:
    """Roots S of the covariance P = S S' of one regression with M factors of forgetting.

    The update is that of `SquareRootLeastSquares`, which also has parameters and is compiled.

    Attributes:
        root: current roots for unit noise (M, P, P).
        forgetting: factors lambda (M,).
    """

    def __init__(self, root: Array, forgetting: Sequence[float]) -> None:
        """Begin with the same root (P, P) for all factors."""
        self.forgetting = np.array(forgetting)
        self.root = np.tile(root, (len(self.forgetting), 1, 1))
        self._share = len(root) * (1.0 - self.forgetting) / PRIOR  # see `_fade_information`
        self._n_updates = 0

    def compute_direction(self, phi: Array) -> Array:
        """Compute P phi / lambda for a row phi (P,) of the next equation (M, P)."""
        return np.asarray((self.root @ (phi @ self.root)[..., None])[..., 0] / self.forgetting[:, None])

    def take(self, phi: Array) -> None:
        """Update by an equation with the row phi (P,)."""
        # f = S' phi;  variance = lambda + f' f
        f, fade = phi @ self.root, self.forgetting
        variance = fade + np.einsum("mp,mp->m", f, f)
        # S = (S - S f f' / (variance + sqrt(lambda variance))) / sqrt(lambda)
        step = f / (variance + np.sqrt(fade * variance))[:, None]
        root = (self.root - (self.root @ f[..., None]) * step[:, None]) / np.sqrt(fade)[:, None, None]
        # the information along one parameter in turn returns to that of the prior
        f = np.sqrt(self._share)[:, None] * root[:, self._n_updates % len(phi)]
        total = 1.0 + np.einsum("mp,mp->m", f, f)
        self.root = root - (root @ f[..., None]) * (f / (total + np.sqrt(total))[:, None])[:, None]
        self._n_updates += 1


def expand_triangle(values: Array) -> Array:
    """Return symmetric matrices (..., N, N) of the elements of their upper triangles (..., N (N + 1) / 2)."""
    size = int(np.sqrt(2 * values.shape[-1]))
    place = np.zeros((size, size), dtype=int)
    place[np.triu_indices(size)] = np.arange(values.shape[-1])
    return values[..., np.maximum(place, place.T)]


def check_ranges(prior: float, forgetting: float) -> None:
    """Check the arguments of a recursion.

    Raises:
        ValueError: if prior or forgetting is out of its range.
    """
    if not 0 < prior < np.inf:
        raise ValueError(f"prior P(0) is {prior:g}: give a positive number")
    if not 0 < forgetting <= 1:
        raise ValueError(f"forgetting is {forgetting:g}: give 1, or slightly less")


@functools.cache
def _write_update(size: int, forgetting: float, prior: float) -> SymbolicStep:
    """Build the update by one equation y = phi' theta, in symbols; an unused equation has no effect."""
    inputs = {"phi": make_symbols("phi", size), "y": make_symbols("y"), "used": make_symbols("used")}
    theta, root, sums = make_symbols("theta", size), make_symbols("root", size, size), make_symbols("sums", 4)
    used = inputs["used"]
    row, fade = inputs["phi"] * used, 1.0 if forgetting == 1 else np.where(used > 0, forgetting, 1.0)
    # f = S' phi;  variance = lambda + phi' P phi = lambda + f' f
    f = row @ root
    variance = fade + f @ f
    P_phi = root @ f
    # e = y - phi' theta;  theta = theta + P phi e / variance
    error = inputs["y"] * used - row @ theta
    scaled_error = error / variance
    # S = (S - P phi f' / (variance + sqrt(lambda variance))) / sqrt(lambda)
    new_root = root - np.outer(P_phi, f / (variance + np.sqrt(fade * variance)))
    if forgetting < 1:
        inputs["turn"] = make_symbols("turn", size)
        new_root = _fade_information(new_root / np.sqrt(fade), inputs["turn"] * used, size * (1.0 - forgetting) / prior)
    _, squares, count, _ = sums
    new_sums = np.array([error, fade * (squares + error * scaled_error), fade * count + used, variance])
    after = {"theta": theta + P_phi * scaled_error, "root": new_root, "sums": new_sums}
    return SymbolicStep(inputs, {"theta": theta, "root": root, "sums": sums}, after)


def _fade_information(root: Any, direction: Any, share: float) -> Any:
    """Let the information J = 1 / P fade to lambda J + (1 - lambda) J(0): unexcited directions return to P(0).

    The caller scales J by lambda. This function adds `share` to the information along one unit vector `direction` (P,)
    at a time. Source: Gunnarsson, Combining tracking and regularization in recursive least squares identification, CDC
    1996.
    """
    f = np.sqrt(share) * (direction @ root)
    total = 1.0 + f @ f
    return root - np.outer(root @ f, f / (total + np.sqrt(total)))


def _multiply_by_transpose(root: Array) -> Array:
    """Return P = S S' of its factor S (..., P, P)."""
    return root @ np.swapaxes(root, -1, -2)


class KalmanLeastSquares:
    """theta and P of (B, S) regressions by the Kalman filter of filterpy; attributes as of `SquareRootLeastSquares`.

    theta is a constant state: the transition is F = 1 without process noise, a row phi is the measurement matrix H, and
    the error variance is R = 1. Forgetting is the fading memory of filterpy, P / lambda before each equation; unlike in
    `SquareRootLeastSquares`, P does not return to P(0).

    Source: Labbe, Kalman and Bayesian Filters in Python, 2015, and its library filterpy; Simon, Optimal State
    Estimation, 2006, sections 3.3 and 7.4.
    """

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

    @property
    def state(self) -> RecursionState:
        """Return the current state, which later equations do not change."""
        return RecursionState(self.theta, self.squares, self.count, self.prior, functools.partial(np.asarray, self.P))

    def take(self, phi: Array, y: Array, usable: Mask) -> None:
        """Update with one equation y = phi' theta each: phi (B, S, P), y (B, S); unusable ones are ignored."""
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


Recursion = SquareRootLeastSquares | KalmanLeastSquares
SQUARE_ROOT = "SquareRootLeastSquares"
RECURSIONS: dict[str, type[Recursion]] = {SQUARE_ROOT: SquareRootLeastSquares, "KalmanFilter": KalmanLeastSquares}
