"""Gram matrices of fits with many variants of an effect, which are solved in one batch."""

from collections.abc import Sequence

import numpy as np

from estimators.regression.balance import LEAST_SLOPE, Columns, Tangent
from estimators.regression.least_squares import RIDGE, solve_within
from pendulum_env._typing import Array


def compute_variant_grams(near: Tangent, parts: Sequence[Columns], weights: Array, here: slice) -> Array:
    """Return Gram matrices (V, P + 1, P + 1) of fits with each of V variants of an effect, to first order.

    The left-hand side comes last, the parameters of the variant before it.

    Args:
        near: what the others leave.
        parts: columns of each variant.
        weights: of the equations (R,).
        here: rows of the variants' joint.
    """
    shared = weights[:, None] * np.column_stack([near.slopes, near.error])
    if any(part.fixed.any() for part in parts):
        return _grams_with_fixed(shared, (weights * near.scale)[here], near.scale[here], parts, here)
    own = (weights * near.scale)[here, None] * np.stack([part.linear for part in parts])
    first, more = shared.shape[1], own.shape[2]
    grams = np.empty((len(parts), first + more, first + more))
    grams[:, :first, :first], grams[:, :first, first:] = shared.T @ shared, shared[here].T @ own
    grams[:, first:, :first] = np.swapaxes(grams[:, :first, first:], 1, 2)
    grams[:, first:, first:] = np.swapaxes(own, 1, 2) @ own
    order = [*range(first - 1), *range(first, first + more), first - 1]
    return grams[:, order][:, :, order]


def _grams_with_fixed(shared: Array, weights: Array, scale: Array, parts: Sequence[Columns], here: slice) -> Array:
    """Return the same where a variant takes torque away, so that all errors in its rows change."""
    elsewhere = np.ones(len(shared), dtype=bool)
    elsewhere[here] = False
    own, grams = shared[here], []
    others, place = shared[elsewhere].T @ shared[elsewhere], np.arange(shared.shape[1])
    for part in parts:
        ratio = 1.0 / (np.maximum(1.0 - scale * part.fixed_slope, LEAST_SLOPE) * part.torque_share)
        rows = np.column_stack([own[:, :-1], weights[:, None] * part.linear, own[:, -1] - weights * part.fixed])
        rows *= ratio[:, None]
        gram = rows.T @ rows
        place[-1] = len(gram) - 1
        gram[np.ix_(place, place)] += others
        grams.append(gram)
    return np.array(grams)


def compute_squared_errors(grams: Array, least: Array, most: Array) -> Array:
    """Return squared errors (V,) of V fits within bounds (P,), from their Gram matrices (V, P + 1, P + 1).

    The equations' left-hand side y comes last.
    """
    scale = np.sqrt(np.maximum(np.diagonal(grams, axis1=1, axis2=2), 1e-300))  # (V, P + 1)
    grams = grams / (scale[:, :, None] * scale[:, None, :])
    normal, target = grams[:, :-1, :-1] + RIDGE * np.eye(grams.shape[1] - 1), grams[:, :-1, -1:]
    theta = np.linalg.solve(normal, target)
    size = scale[:, :-1] / scale[:, -1:]
    for k in np.flatnonzero(np.any((theta[:, :, 0] < least * size) | (theta[:, :, 0] > most * size), axis=1)).tolist():
        theta[k, :, 0] = solve_within(normal[k], target[k, :, 0], least * size[k], most * size[k])
    left = 1.0 - 2 * (np.swapaxes(target, 1, 2) @ theta) + np.swapaxes(theta, 1, 2) @ grams[:, :-1, :-1] @ theta
    return np.asarray(np.maximum(left[:, 0, 0], 0.0) * scale[:, -1] ** 2)
