"""What changed, once something has: the model fitted anew to what came since, as functions of its rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.online.binning import BLOCK
from estimators.selection.score import NU
from pendulum_env._typing import Array, Index

SIGNIFICANT = 4.0  # standard errors, from which on a change of a parameter is told
SPLITS = 24  # moments that are tried for the change
CELLS = 8  # of a quantity, in which errors are compared


@dataclass(frozen=True)
class Known:
    """What was known of a model while it predicted.

    Attributes:
        theta: its parameters (P,).
        P: their covariance for unit noise (P, P).
        sizes: of the parameters, by which they may change (P,).
        square: mean square of errors [(N m)^2].
    """

    theta: Array
    P: Array
    sizes: Array
    square: float

    def refit(self, phi: Array, y: Array) -> Array:
        """Parameters (P,) that fit rows (R, P), each held weakly where it was."""
        both = np.vstack([phi, self._weak]), np.concatenate([y, self._weak @ self.theta])
        return np.asarray(np.linalg.lstsq(*both, rcond=None)[0])

    def root(self, phi: Array) -> Array:
        """Factor of the covariance of such a fit for unit noise (P, P)."""
        return np.asarray(np.linalg.cholesky(np.linalg.inv(phi.T @ phi + self._weak**2)))

    @property
    def _weak(self) -> Array:
        return np.diag(np.sqrt(self.square) / self.sizes)

    def moment(self, phi: Array, y: Array, last: int) -> tuple[int, Array]:
        """Row of the change, up to a last one that it may be, and the parameters (P,) after it."""
        before = np.concatenate([[0.0], np.cumsum(density(y - phi @ self.theta, self.square))])

        def best(splits: Index) -> tuple[int, Array]:
            fits = [self.refit(phi[k:], y[k:]) for k in splits]
            gains = [
                before[k] + density(y[k:] - phi[k:] @ fit, self.square).sum()
                for k, fit in zip(splits, fits, strict=True)
            ]
            place = int(np.argmax(gains))
            return int(splits[place]), fits[place]

        k, _ = best(np.unique(np.linspace(0, last, SPLITS).astype(np.intp)))
        step = -(-last // (SPLITS - 1))
        return best(np.arange(max(0, k - step), min(last, k + step) + 1))

    def std(self, phi: Array, error: Array) -> Array:
        """Standard errors of changes (P,): of a fit whose errors are correlated over blocks, and of what was known."""
        bread = np.linalg.pinv(phi.T @ phi)
        scores = np.add.reduceat(phi * error[:, None], np.arange(0, len(error), BLOCK))
        fit = np.maximum(np.diag(bread @ (scores.T @ scores) @ bread), np.diag(bread) * self.square)
        return np.asarray(np.sqrt(fit + np.diag(self.P) * self.square))

    def changes(self, names: Sequence[str], theta: Array, std: Array) -> dict[str, tuple[float, float]]:
        """By how much other parameters surely differ, and with what error, by name, surest first."""
        delta = theta - self.theta
        order = np.argsort(-np.abs(delta) / std)
        return {names[j]: (float(delta[j]), float(std[j])) for j in order if abs(delta[j]) > SIGNIFICANT * std[j]}


def density(error: Array, square: Array | float) -> Array:
    """Log density of Student's t with a squared scale, but for its constant."""
    return np.asarray(-0.5 * np.log(square) - (NU + 1) / 2 * np.log1p(error**2 / (NU * square)))


def place_of(error: Array, position: Array, velocity: Array, torque: Array) -> dict[str, tuple[float, float]]:
    """The quantity whose value tells most of the errors, and its range where they are largest."""
    best, found = 0.0, {}
    angle = (position + np.pi) % (2 * np.pi) - np.pi
    for name, values in (("position", angle), ("velocity", velocity), ("torque", torque)):
        edges = np.quantile(values, np.linspace(0, 1, CELLS + 1))
        cell = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, CELLS - 1)
        count = np.maximum(np.bincount(cell, minlength=CELLS), 1)
        told = np.bincount(cell, error, CELLS) ** 2 / count
        if told.sum() > best:
            best, worst = float(told.sum()), int(np.argmax(told))
            found = {name: (float(edges[worst]), float(edges[worst + 1]))}
    return found
