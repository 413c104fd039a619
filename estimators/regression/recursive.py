"""Estimates of recursive least squares along a recording, in one pass."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from estimators.regression.least_squares import Equations
from pendulum_env._typing import Array, Index, Mask

PRIOR = 1e7  # P(0) on the diagonal, the paper's "10E6"


class History(NamedTuple):
    """Recursive estimates at K points.

    Attributes:
        points: index of the last equation used (K,).
        theta: parameters (K, P).
        root: upper triangular root of the covariance for unit noise (K, P, P).
    """

    points: Index
    theta: Array
    root: Array

    @property
    def std(self) -> Array:
        """Standard errors for unit noise (K, P)."""
        return np.sqrt(np.einsum("kij,kij->ki", self.root, self.root))


def choose_indices(count: int, points: int) -> Index:
    """Return about `points` evenly spaced indices into `count` equations, including the last."""
    return np.unique(np.linspace(0, count - 1, min(points, count) + 1).round().astype(np.intp)[1:])


def compute_history(equations: Equations, mask: Mask, points: Index) -> History:
    """Return the estimates of the recursion, (6) in the paper, after the equations at ascending `points` (K,).

    Equations outside `mask` (R,) are not used. The estimate minimises |theta|^2 / `PRIOR` plus the squared errors
    so far. The rows up to each point are reduced by QR to the triangle R, the square root of information, R'R = 1 / P.

    Source: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, chapter IV.
    """
    parameters = equations.phi.shape[1]
    rows = np.column_stack([equations.phi, equations.y]) * mask[:, None]  # (R, P + 1)
    ends = np.asarray(points, dtype=np.intp) + 1
    triangle = np.eye(parameters + 1) / np.sqrt(PRIOR)
    triangle[-1, -1] = 0.0
    theta, root = np.empty((len(ends), parameters)), np.empty((len(ends), parameters, parameters))
    for k, (begin, end) in enumerate(zip(np.r_[0, ends[:-1]], ends, strict=True)):
        reduced = scipy.linalg.lapack.dgeqrf(np.vstack([triangle, rows[begin:end]]))[0]  # R and reflectors
        triangle = np.triu(reduced[: parameters + 1])
        root[k] = scipy.linalg.lapack.dtrtri(triangle[:-1, :-1])[0]
        theta[k] = root[k] @ triangle[:-1, -1]
    return History(np.asarray(points), theta, root)
