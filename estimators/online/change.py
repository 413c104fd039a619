"""Change of a model's parameters: fits to the rows before and after a moment, and the moment itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr, stdtrit

from estimators.regression.recursive import PRIOR
from estimators.selection.score import log_student
from pendulum_env._typing import Array, Index


@dataclass(frozen=True)
class ChangeSettings:
    """Numbers that decide on a change; chosen on simulated plants by `benchmarks.online_diagnosis`."""

    suspect: float = 3.0  # nat, evidence of a change from which an alarm may be one
    judged: float = 1.0  # [s] of motion that models fitted since a change predict before they are judged
    sure: float = 2.0  # [s] of motion since a change, from which changed parameters are reported
    compare: float = 5.0  # [s] of motion, from which parameters are compared with given ones
    significant: float = 4.0  # standard errors from which a change is reported, if many blocks tell them
    share: float = 0.5  # of the threshold of an alarm, evidence of an effect after a change
    splits: int = 24  # trial moments of a change


CHANGE = ChangeSettings()


@dataclass(frozen=True)
class Fit:
    """Estimates of parameters.

    Attributes:
        theta: values (P,).
        covariance: of their errors (P, P).
        freedom: degrees of freedom of the covariance.
    """

    theta: Array
    covariance: Array
    freedom: float = np.inf


def fit(phi: Array, y: Array, block: int) -> Fit:
    """Fit rows y = phi' theta, phi (R, P), whose errors are correlated within blocks of so many rows.

    Blocks no more than parameters do not tell the covariance: it is infinite.
    """
    theta, bread = _least_squares(phi, y)
    error = y - phi @ theta
    scores = np.add.reduceat(phi * error[:, None], np.arange(0, len(error), block))
    blocks, count = len(scores), len(theta)
    if blocks <= count:
        return Fit(theta, np.full((count, count), np.inf), 0.0)
    robust = bread @ (scores.T @ scores) @ bread * (blocks / (blocks - count))
    white = bread * float(np.mean(error**2))
    # a direction that is not excited has a small score, too: no variance is less than that of white errors
    scale = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(robust), 1e-300), 1.0))
    return Fit(theta, robust * np.outer(scale, scale), float(blocks - count))


@dataclass
class ParameterChange:
    """Change of parameters from former ones, estimated better with each row since then.

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
    changed: Mapping[str, tuple[float, float]] = field(default_factory=dict, init=False)
    _rows: int = field(default=0, init=False)

    def is_due(self, rows: int) -> bool:
        """Return whether a number of rows exceeds that of the last comparison."""
        return rows >= max(self.fewest, self._rows + 1)

    def compare(self, phi: Array, y: Array, block: int) -> None:
        """Compare the former parameters with those of rows since the change; the arguments are those of `fit`."""
        self._rows, after = len(y), fit(phi, y, block)
        delta = after.theta - self.before.theta
        std = np.sqrt(np.maximum(np.diag(self.before.covariance + after.covariance), 1e-300))
        order = np.argsort(-np.abs(delta) / std)
        # Student's t, as few blocks tell a standard error roughly
        limit = -stdtrit(max(1.0, min(self.before.freedom, after.freedom)), ndtr(-CHANGE.significant))
        significant = [j for j in order if abs(delta[j]) > limit * std[j]]
        self.changed = {self.names[j]: (float(delta[j]), float(std[j])) for j in significant}


def find_change(phi: Array, y: Array, first: int, last: int) -> int:
    """Find the row from which on another fit predicts best, from a first to a last possible one.

    Rows before the first possible one have the former parameters.
    """
    theta, _ = _least_squares(phi[:first], y[:first])
    error = y - phi @ theta
    before = np.concatenate([[0.0], np.cumsum(_log_densities(error, error[:first]))])

    def best(splits: Index) -> int:
        gains = []
        for k in splits:
            later, _ = _least_squares(phi[k:], y[k:])
            error = y[k:] - phi[k:] @ later
            gains.append(before[k] + _log_densities(error, error).sum())
        return int(splits[int(np.argmax(gains))])

    k = best(np.unique(np.linspace(first, last, CHANGE.splits).astype(np.intp)))
    step = -(-(last - first) // (CHANGE.splits - 1))
    return best(np.arange(max(first, k - step), min(last, k + step) + 1, dtype=np.intp))


def _least_squares(phi: Array, y: Array) -> tuple[Array, Array]:
    """Parameters (P,) of rows, and their covariance for unit noise (P, P), with P(0) as in a recursion."""
    bread = np.asarray(np.linalg.inv(phi.T @ phi + np.eye(phi.shape[1]) / PRIOR), dtype=float)
    return bread @ (phi.T @ y), bread


def _log_densities(error: Array, known: Array) -> Array:
    """Return log densities of errors under Student's t with the scale of known errors."""
    return log_student(error**2, max(float(np.mean(known**2)), 1e-12))
