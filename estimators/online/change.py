"""Change of parameters: its time, and fits to the rows before and after it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr, stdtrit

from estimators.decisions.score import compute_log_student
from estimators.online.settings import ONLINE
from estimators.online.work import Work
from estimators.regression.recursive import PRIOR
from pendulum_env._typing import Array, Index


@dataclass(frozen=True)
class ParameterFit:
    """Estimates of parameters.

    Attributes:
        theta: values (P,).
        covariance: covariance of their errors (P, P).
        freedom: degrees of freedom of the covariance.
    """

    theta: Array
    covariance: Array
    freedom: float = np.inf


def fit_rows(phi: Array, y: Array, chunk: int) -> ParameterFit:
    """Fit rows y = phi' theta with errors that are correlated within chunks.

    The covariance is infinite if chunks do not outnumber parameters.

    Args:
        phi: (R, P).
        y: (R,).
        chunk: number of rows in a chunk.
    """
    theta, bread = _solve_least_squares(phi, y)
    error = y - phi @ theta
    scores = np.add.reduceat(phi * error[:, None], np.arange(0, len(error), chunk))
    chunks, count = len(scores), len(theta)
    if chunks <= count:
        return ParameterFit(theta, np.full((count, count), np.inf), 0.0)
    robust = bread @ (scores.T @ scores) @ bread * (chunks / (chunks - count))
    white = bread * float(np.mean(error**2))
    # scores of directions without excitation are too small: no variance is below that of white errors
    scale = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(robust), 1e-300), 1.0))
    return ParameterFit(theta, robust * np.outer(scale, scale), float(chunks - count))


@dataclass
class ParameterChange:
    """Change of parameters from former values.

    Attributes:
        names: names of the parameters.
        before: former values.
        min_rows: number of rows before the first comparison.
        since: time of the change [s]; None if the former values were given.
        changed: significant changes and their standard errors, by name, the most significant first.
    """

    names: Sequence[str]
    before: ParameterFit
    min_rows: int
    since: float | None
    changed: Mapping[str, tuple[float, float]] = field(default_factory=dict, init=False)
    _n_compared: int = field(default=0, init=False)

    def is_due(self, rows: int) -> bool:
        """Return whether rows suffice for a comparison, and exceed those of the last one."""
        return rows >= max(self.min_rows, self._n_compared + 1)

    def compare(self, phi: Array, y: Array, chunk: int) -> None:
        """Compare the former parameters with a fit to the rows since the change; arguments as of `fit_rows`."""
        self._n_compared, after = len(y), fit_rows(phi, y, chunk)
        delta = after.theta - self.before.theta
        std = np.sqrt(np.maximum(np.diag(self.before.covariance + after.covariance), 1e-300))
        order = np.argsort(-np.abs(delta) / std)
        # Student's t: a standard error from few chunks is inaccurate
        limit = -stdtrit(max(1.0, min(self.before.freedom, after.freedom)), ndtr(-ONLINE.limits.change_z_score))
        significant = [j for j in order if abs(delta[j]) > limit * std[j]]
        self.changed = {self.names[j]: (float(delta[j]), float(std[j])) for j in significant}


def find_change(phi: Array, y: Array, first: int, last: int) -> Work[int]:
    """Find the row after which another fit predicts best, between a first and a last row.

    `first` rows have the former parameters. The best of some equally spaced rows is refined to a single row.

    Args:
        phi: rows in the order of time (R, P).
        y: (R,).
    """
    theta, _ = _solve_least_squares(phi[:first], y[:first])
    error = y - phi @ theta
    before = np.concatenate([[0.0], np.cumsum(_log_densities(error, error[:first]))])

    def find_best(splits: Index) -> Work[int]:
        gains = []
        for number, k in enumerate(splits):
            if number % ONLINE.work.splits == 0:
                yield
            theta_after, _ = _solve_least_squares(phi[k:], y[k:])
            error = y[k:] - phi[k:] @ theta_after
            gains.append(before[k] + _log_densities(error, error).sum())
        return int(splits[int(np.argmax(gains))])

    k = yield from find_best(np.unique(np.linspace(first, last, ONLINE.models.splits).astype(np.intp)))
    step = -(-(last - first) // (ONLINE.models.splits - 1))
    return (yield from find_best(np.arange(max(first, k - step), min(last, k + step) + 1, dtype=np.intp)))


def _solve_least_squares(phi: Array, y: Array) -> tuple[Array, Array]:
    """Solve rows for parameters (P,) and their covariance for unit noise (P, P), with P(0) as in a recursion."""
    bread = np.asarray(np.linalg.inv(phi.T @ phi + np.eye(phi.shape[1]) / PRIOR), dtype=float)
    return bread @ (phi.T @ y), bread


def _log_densities(error: Array, reference: Array) -> Array:
    """Return log densities of errors under Student's t with the scale of reference errors."""
    return compute_log_student(error**2, max(float(np.mean(reference**2)), 1e-12))
