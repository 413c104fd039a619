"""Recursive least squares for many regressions at once, in square-root form.

P = S S' is kept as its factor S, so that it is symmetric and positive definite by construction, however many equations
come in; the estimates are those of the paper's (6), and of filterpy. Source: Potter's update, in Bierman, Factorization
Methods for Discrete Sequential Estimation, 1977, chapter II.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from estimators.regression.recursive import PRIOR
from pendulum_env._typing import Array, Mask


class SquareRootLeastSquares:
    """theta and P of (B, S) regressions with P parameters each.

    Attributes:
        theta: estimates (B, S, P).
        root: factor of P for unit noise (B, S, P, P).
        error: last a-priori errors (B, S), 0 where an equation was not used.
        squares: sum of squared errors, discounted like the equations (B, S).
        count: equations taken in, discounted likewise (B, S).
    """

    def __init__(self, batch: tuple[int, int], parameters: int, prior: float = PRIOR, forgetting: float = 1.0) -> None:
        """Take the shape (B, S), the number of parameters, P(0) on the diagonal and the forgetting factor.

        Raises:
            ValueError: if prior or forgetting is out of its range.
        """
        if not 0 < prior < np.inf:
            raise ValueError(f"the prior P(0) cannot be {prior:g}: give a positive number")
        if not 0 < forgetting <= 1:
            raise ValueError(f"the forgetting factor cannot be {forgetting:g}: give 1, or a little less")
        self.prior, self.forgetting = prior, forgetting
        self.theta = np.zeros((*batch, parameters))
        self.root = np.sqrt(prior) * np.tile(np.eye(parameters), (*batch, 1, 1))
        self.error, self.squares, self.count = np.zeros((3, *batch))
        self._turn = 0

    def reset(self, which: Mask) -> None:
        """Those of the B start anew."""
        for name in ("theta", "error", "squares", "count"):
            series = getattr(self, name).copy()  # what was handed out stays as it is
            series[which] = 0.0
            setattr(self, name, series)
        self.reset_covariance(which)

    def reset_covariance(self, which: Mask) -> None:
        """Those of the B keep their estimates and forget how sure they are."""
        self.root = self.root.copy()
        self.root[which] = np.sqrt(self.prior) * np.eye(self.theta.shape[-1])

    @property
    def P(self) -> Array:
        """Covariance for unit noise (B, S, P, P)."""
        return _square(self.root)

    def spread(self) -> Callable[[], Array]:
        """What gives P of now, also later: few steps are looked at."""
        return functools.partial(_square, self.root)

    def take(self, phi: Array, y: Array, usable: Mask) -> None:
        """Take in one equation y = phi' theta each: phi (B, S, P), y (B, S); those not usable change nothing."""
        used = usable.astype(float)
        row = (phi * used[..., None])[..., None, :]  # (B, S, 1, P)
        power = 1.0 if self.forgetting == 1 else np.where(usable, self.forgetting, 1.0)
        # f = S' phi;  lambda + phi' P phi = lambda + f' f;  raised = P phi
        f = row @ self.root
        turned = f.swapaxes(-1, -2)
        total = power + (f @ turned)[..., 0, 0]
        raised = self.root @ turned  # (B, S, P, 1)
        # e = y - phi' theta;  theta = theta + P phi e / (lambda + phi' P phi)
        error = y * used - (row @ self.theta[..., None])[..., 0, 0]
        relative = error / total
        self.theta = self.theta + raised[..., 0] * relative[..., None]
        # S = (S - raised f' / (total + sqrt(lambda total))) / sqrt(lambda)
        share = 1.0 / (total + np.sqrt(power * total))
        root = self.root - raised * (f * share[..., None, None])
        self.root = root if self.forgetting == 1 else self._forget(root, usable)
        self.error = error
        self.squares = power * (self.squares + error * relative)
        self.count = power * self.count + used

    def _forget(self, root: Array, usable: Mask) -> Array:
        """Let the information J = 1 / P fade to lambda J + (1 - lambda) J(0): what is not excited returns to P(0).

        The second part comes one direction at a time, each in its turn. Source: Gunnarsson, Combining tracking and
        regularization in recursive least squares identification, CDC 1996.
        """
        size = root.shape[-1]
        root = np.where(usable[..., None, None], root / np.sqrt(self.forgetting), root)
        turn = self._turn % size
        self._turn += 1
        f = np.sqrt(size * (1.0 - self.forgetting) / self.prior) * root[..., turn, :] * usable[..., None]
        total = 1.0 + np.einsum("...i,...i", f, f)
        share = 1.0 / (total + np.sqrt(total))
        raised = root @ f[..., None]
        faded: Array = root - raised * (f * share[..., None])[..., None, :]
        return faded

    def widen(self, increase: Array) -> None:
        """Add a diagonal (B, S, P) to P: the parameters may have moved since."""
        spread = self.P
        diagonal = np.einsum("...ii->...i", spread)  # a view
        diagonal += np.minimum(increase, np.maximum(self.prior - diagonal, 0.0))  # no further than P(0)
        self.root = np.linalg.cholesky(spread)


def _square(root: Array) -> Array:
    return root @ np.swapaxes(root, -1, -2)
