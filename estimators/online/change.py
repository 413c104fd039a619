"""Change of a model's parameters: fits to the rows before and after a moment, and the moment itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.regression.recursive import PRIOR
from estimators.selection.score import NU
from pendulum_env._typing import Array, Index


@dataclass(frozen=True)
class ChangeSettings:
    """Numbers that decide on a change; chosen on simulated plants by `benchmarks.online_diagnosis`."""

    suspect: float = 3.0  # nat, evidence of a change from which an alarm may be one
    judged: float = 1.0  # [s] of motion that models fitted since a change predict before they are judged
    sure: float = 2.0  # [s] of motion since a change, from which changed parameters are reported
    compare: float = 5.0  # [s] of motion, from which parameters are compared with given ones
    significant: float = 4.0  # standard errors, from which a change of a parameter is reported
    share: float = 0.5  # of the threshold of an alarm, evidence of an effect after a change
    splits: int = 24  # trial moments of a change


CHANGE = ChangeSettings()


@dataclass(frozen=True)
class Fit:
    """Estimates of parameters.

    Attributes:
        theta: values (P,).
        covariance: of their errors (P, P).
    """

    theta: Array
    covariance: Array


def fit(phi: Array, y: Array, block: int) -> Fit:
    """Fit rows y = phi' theta, phi (R, P), whose errors are correlated within blocks of so many rows."""
    theta, bread = _least_squares(phi, y)
    error = y - phi @ theta
    scores = np.add.reduceat(phi * error[:, None], np.arange(0, len(error), block))
    blocks, count = len(scores), len(theta)
    robust = bread @ (scores.T @ scores) @ bread * (blocks / max(blocks - count, 1))
    white = bread * float(np.mean(error**2))
    # a direction that is not excited has a small score, too: no variance is less than that of white errors
    scale = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(robust), 1e-300), 1.0))
    return Fit(theta, robust * np.outer(scale, scale))


@dataclass
class ParameterChange:
    """Change of parameters from former ones, of which more is known with each row since then.

    Attributes:
        names: of the parameters.
        before: their former values.
        fewest: rows, from which on they are compared.
        since: time of the change [s]; None if the former values were given.
        changed: significant changes and their standard errors, by name, the most significant first.
    """

    names: Sequence[str]
    before: Fit
    fewest: int
    since: float | None
    changed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    _rows: int = 0

    def is_due(self, rows: int) -> bool:
        """Whether so many rows tell more than those that were compared."""
        return rows >= max(self.fewest, self._rows + 1)

    def compare(self, phi: Array, y: Array, block: int) -> None:
        """Compare with the parameters of rows since the change; the other arguments are those of `fit`."""
        self._rows, after = len(y), fit(phi, y, block)
        delta = after.theta - self.before.theta
        std = np.sqrt(np.maximum(np.diag(self.before.covariance + after.covariance), 1e-300))
        order = np.argsort(-np.abs(delta) / std)
        significant = [j for j in order if abs(delta[j]) > CHANGE.significant * std[j]]
        self.changed = {self.names[j]: (float(delta[j]), float(std[j])) for j in significant}


def find_change(phi: Array, y: Array, first: int, last: int) -> int:
    """Find the row from which on another fit predicts best, from a first to a last possible one.

    Rows before the first possible one have the former parameters.
    """
    theta, _ = _least_squares(phi[:first], y[:first])
    error = y - phi @ theta
    before = np.concatenate([[0.0], np.cumsum(_density(error, error[:first]))])

    def best(splits: Index) -> int:
        gains = []
        for k in splits:
            later, _ = _least_squares(phi[k:], y[k:])
            error = y[k:] - phi[k:] @ later
            gains.append(before[k] + _density(error, error).sum())
        return int(splits[int(np.argmax(gains))])

    k = best(np.unique(np.linspace(first, last, CHANGE.splits).astype(np.intp)))
    step = -(-(last - first) // (CHANGE.splits - 1))
    return best(np.arange(max(first, k - step), min(last, k + step) + 1, dtype=np.intp))


def _least_squares(phi: Array, y: Array) -> tuple[Array, Array]:
    """Parameters (P,) of rows, and their covariance for unit noise (P, P), with P(0) as in a recursion."""
    bread = np.asarray(np.linalg.inv(phi.T @ phi + np.eye(phi.shape[1]) / PRIOR), dtype=float)
    return bread @ (phi.T @ y), bread


def _density(error: Array, known: Array) -> Array:
    """Log density of Student's t with the scale of known errors, except for its constant."""
    square = max(float(np.mean(known**2)), 1e-12)
    return np.asarray(-0.5 * np.log(square) - (NU + 1) / 2 * np.log1p(error**2 / (NU * square)))
