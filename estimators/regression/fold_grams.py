"""Gram matrices of equations by entry and fold: sufficient statistics of all fits to them.

An entry is a recording, or a recording of one joint, whose equations have one weight. The Gram matrix of a fit is the
sum of those of its entries and folds, so that other weights and each fold left out take a small solve. A further term
adds a border, from the equations of its own joint alone. The left-hand side comes first in each matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.regression.balance import LEAST_SLOPE, Columns, Tangent
from estimators.regression.least_squares import RIDGE, solve_gram, solve_within, sum_without_each
from pendulum_env._typing import Array, Index


@dataclass(frozen=True)
class FoldGrams:
    """Gram matrices of the errors of equations and their slopes, to first order around a fit.

    Attributes:
        near: errors of the equations.
        entry: of each equation, ascending (R,).
        order: equations in the order of their entries, and of their folds within an entry (R,).
        ends: where equations of each entry and fold begin and end in that order (E K + 1,).
        rows: error and slopes of each equation (R, P + 1).
        grams: of these rows (E, K, P + 1, P + 1).
    """

    near: Tangent
    entry: Index
    order: Index
    ends: Index
    rows: Array
    grams: Array

    @classmethod
    def compute(cls, near: Tangent, entry: Index, fold: Index, entries: int, folds: int) -> FoldGrams:
        """Compute the Gram matrices of equations, given the entry and the fold of each (R,) and their numbers."""
        cell = entry * folds + fold
        order = np.argsort(cell, kind="stable")
        ends = np.searchsorted(cell[order], np.arange(entries * folds + 1))
        rows = np.column_stack([near.error, near.slopes])
        grams = np.array([own.T @ own for own in np.split(rows[order], ends[1:-1])])
        return cls(near, entry, order, ends, rows, grams.reshape(entries, folds, *grams.shape[1:]))

    def with_term(self, part: Columns, here: slice) -> Array:
        """Return the Gram matrices (E, K, P + 1, P + 1) with one more term, which acts in the equations of a joint."""
        first, last, _ = here.indices(len(self.order))
        before, columns = self._extend(part, here)
        place, size = self.order[here] - first, before.shape[1]
        before, columns = before[place], columns[place]
        grams = np.zeros((*self.grams.shape[:2], *2 * (size + columns.shape[1],)))
        grams[:, :, :size, :size] = self.grams
        cells = grams.reshape(-1, *grams.shape[2:])
        for k in range(*np.searchsorted(self.ends, [first, last])):
            cell = slice(self.ends[k] - first, self.ends[k + 1] - first)
            rows, own = before[cell], columns[cell]
            cells[k, size:, :size] = own.T @ rows
            cells[k, :size, size:] = cells[k, size:, :size].T
            cells[k, size:, size:] = own.T @ own
            if part.fixed.any():
                cells[k, :size, :size] = rows.T @ rows
        return grams

    def with_variants(self, parts: Sequence[Columns], weights: Array, here: slice) -> Array:
        """Return the Gram matrices (V, P + 1, P + 1) of all folds with each of V variants of a term.

        Args:
            parts: columns of each variant.
            weights: of the equations of each entry (E,).
            here: equations of the joint of the variants.
        """
        square, w = weights**2, weights[self.entry[here], None]
        size, first = self.rows.shape[1], self.rows.shape[1] + parts[0].linear.shape[1]
        grams = np.empty((len(parts), first, first))
        if any(part.fixed.any() for part in parts):  # changes all errors in its rows
            elsewhere = np.delete(np.arange(len(weights)), np.unique(self.entry[here]))
            others = np.einsum("e,ekij->ij", square[elsewhere], self.grams[elsewhere])
            for gram, part in zip(grams, parts, strict=True):
                rows = w * np.column_stack(self._extend(part, here))
                gram[:] = rows.T @ rows
                gram[:size, :size] += others
            return grams
        own = (w * self.near.scale[here, None]) * np.stack([part.linear for part in parts])
        grams[:, :size, :size] = np.einsum("e,ekij->ij", square, self.grams)
        grams[:, :size, size:] = (w * self.rows[here]).T @ own
        grams[:, size:, :size] = np.swapaxes(grams[:, :size, size:], 1, 2)
        grams[:, size:, size:] = np.swapaxes(own, 1, 2) @ own
        return grams

    def _extend(self, part: Columns, here: slice) -> tuple[Array, Array]:
        """Return the rows of a joint (r, P + 1) beside a term there, and the columns of the term (r, p)."""
        rows, scale = self.rows[here], self.near.scale[here]
        if not part.fixed.any():
            return rows, scale[:, None] * part.linear
        ratio = 1.0 / (np.maximum(1.0 - scale * part.fixed_slope, LEAST_SLOPE) * part.torque_share)[:, None]
        error = rows[:, :1] - (scale * part.fixed)[:, None]
        return ratio * np.column_stack([error, rows[:, 1:]]), ratio * scale[:, None] * part.linear


def compute_entry_squares(grams: Array, step: Array) -> Array:
    """Return the squared error of each entry (E,) after a step of the parameters (P,), from its Gram matrices."""
    left = np.append(1.0, -step)
    return np.maximum(left @ grams.sum(axis=1) @ left, 0.0)


def solve_all_folds(grams: Array, weights: Array, least: Array, most: Array) -> Array | None:
    """Return the step (P,) of a fit to all folds within bounds (P,); see `solve_each_fold`."""
    return solve_gram(np.einsum("e,ekij->ij", weights**2, grams), least, most)


def solve_each_fold(grams: Array, weights: Array, least: Array, most: Array) -> Array | None:
    """Return the steps (K + 1, P) of a fit to all folds, and of fits without each; None for nearly collinear columns.

    Args:
        grams: of each entry and fold (E, K, P + 1, P + 1).
        weights: of the equations of each entry (E,).
        least, most: bounds of the step (P,).
    """
    folds = np.einsum("e,ekij->kij", weights**2, grams)
    steps = [solve_gram(gram, least, most) for gram in (folds.sum(axis=0), *sum_without_each(folds))]
    return None if any(step is None for step in steps) else np.array(steps)


def compute_squared_errors(grams: Array, least: Array, most: Array) -> Array:
    """Return squared errors (V,) of V fits within bounds (P,), from their Gram matrices (V, P + 1, P + 1)."""
    scale = np.sqrt(np.maximum(np.diagonal(grams, axis1=1, axis2=2), 1e-300))  # (V, P + 1)
    grams = grams / (scale[:, :, None] * scale[:, None, :])
    normal, target = grams[:, 1:, 1:] + RIDGE * np.eye(grams.shape[1] - 1), grams[:, 1:, :1]
    theta = np.linalg.solve(normal, target)
    size = scale[:, 1:] / scale[:, :1]
    for k in np.flatnonzero(np.any((theta[:, :, 0] < least * size) | (theta[:, :, 0] > most * size), axis=1)).tolist():
        theta[k, :, 0] = solve_within(normal[k], target[k, :, 0], least * size[k], most * size[k])
    left = 1.0 - 2 * (np.swapaxes(target, 1, 2) @ theta) + np.swapaxes(theta, 1, 2) @ grams[:, 1:, 1:] @ theta
    return np.asarray(np.maximum(left[:, 0, 0], 0.0) * scale[:, 0] ** 2)
