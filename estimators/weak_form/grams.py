"""Gram matrices of fits with many variants of an effect, which are solved in one batch."""

from collections.abc import Sequence

import numpy as np

from estimators.regression.balance import Columns, Tangent
from estimators.regression.least_squares import RIDGE
from pendulum_env._typing import Array


def grams_of_variants(near: Tangent, parts: Sequence[Columns], weights: Array, here: slice) -> Array:
    """Return Gram matrices (V, P + 1, P + 1) of fits with each of V variants that do not depend on the torque.

    The left-hand side comes last, the parameters of the variant before it.

    Args:
        near: what the others leave.
        parts: columns of each variant, without fixed ones.
        weights: of the equations (R,).
        here: rows of the variants' joint.
    """
    shared = weights[:, None] * np.column_stack([near.slopes, near.error])
    own = (weights * near.scale)[here, None] * np.stack([part.linear for part in parts])
    first, more = shared.shape[1], own.shape[2]
    grams = np.empty((len(parts), first + more, first + more))
    grams[:, :first, :first], grams[:, :first, first:] = shared.T @ shared, shared[here].T @ own
    grams[:, first:, :first] = np.swapaxes(grams[:, :first, first:], 1, 2)
    grams[:, first:, first:] = np.swapaxes(own, 1, 2) @ own
    order = [*range(first - 1), *range(first, first + more), first - 1]
    return grams[:, order][:, :, order]


def squared_errors(grams: Array) -> tuple[Array, Array]:
    """Return squared errors (V,) and parameters (V, P) of V fits from their Gram matrices (V, P + 1, P + 1).

    The equations' left-hand side y comes last.
    """
    scale = np.sqrt(np.maximum(np.diagonal(grams, axis1=1, axis2=2), 1e-300))  # (V, P + 1)
    grams = grams / (scale[:, :, None] * scale[:, None, :])
    normal, target = grams[:, :-1, :-1] + RIDGE * np.eye(grams.shape[1] - 1), grams[:, :-1, -1:]
    theta = np.linalg.solve(normal, target)
    left = 1.0 - 2 * (np.swapaxes(target, 1, 2) @ theta) + np.swapaxes(theta, 1, 2) @ grams[:, :-1, :-1] @ theta
    squares = np.maximum(left[:, 0, 0], 0.0) * scale[:, -1] ** 2
    return squares, theta[:, :, 0] * scale[:, -1:] / scale[:, :-1]
