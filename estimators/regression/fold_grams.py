"""Gram matrices of equations by entry and fold, for fast fits.

An entry is a recording, or one joint of a recording; its equations have one weight. The Gram matrix of a fit is the
weighted sum over entries and folds. A further term adds rows and columns to the matrices. Row and column 0 of each
matrix belong to the left-hand side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.regression.balance import Columns, Tangent
from estimators.regression.least_squares import RIDGE, solve_gram, solve_within, sum_without_each
from estimators.regression.response import LEAST_SLOPE
from pendulum_env._typing import Array, Index


@dataclass(frozen=True)
class FoldGrams:
    """Gram matrices of the errors of equations and their slopes, to first order around a fit.

    Attributes:
        near: errors of the equations, to first order.
        entry: entry of each equation, ascending (R,).
        order: indices of the equations, sorted by entry, then fold (R,).
        ends: limits of each entry and fold in `order` (E K + 1,).
        rows: error and slopes of each equation, in the original order (R, P + 1).
        grams: Gram matrices of `rows` per entry and fold (E, K, P + 1, P + 1).
    """

    near: Tangent
    entry: Index
    order: Index
    ends: Index
    rows: Array
    grams: Array

    @classmethod
    def compute(cls, near: Tangent, entry: Index, fold: Index, entries: int, folds: int) -> FoldGrams:
        """Compute the Gram matrices from entry and fold of each equation (R,), and the numbers of entries and folds."""
        cell = entry * folds + fold
        order = np.argsort(cell, kind="stable")
        ends = np.searchsorted(cell[order], np.arange(entries * folds + 1))
        rows = np.column_stack([near.error, near.slopes])
        grams = np.array([cell_rows.T @ cell_rows for cell_rows in np.split(rows[order], ends[1:-1])])
        return cls(near, entry, order, ends, rows, grams.reshape(entries, folds, *grams.shape[1:]))

    def with_term(self, part: Columns, joint_rows: slice) -> Array:
        """Return Gram matrices (E, K, P + p + 1, P + p + 1) with a term of p columns, on the rows of a joint."""
        first, last, _ = joint_rows.indices(len(self.order))
        rows, columns = self._extend(part, joint_rows)
        sorted_rows, size = self.order[joint_rows] - first, rows.shape[1]
        rows, columns = rows[sorted_rows], columns[sorted_rows]
        grams = np.zeros((*self.grams.shape[:2], *2 * (size + columns.shape[1],)))
        grams[:, :, :size, :size] = self.grams
        cells = grams.reshape(-1, *grams.shape[2:])
        for k in range(*np.searchsorted(self.ends, [first, last])):
            cell = slice(self.ends[k] - first, self.ends[k + 1] - first)
            row_cell, column_cell = rows[cell], columns[cell]
            cells[k, size:, :size] = column_cell.T @ row_cell
            cells[k, :size, size:] = cells[k, size:, :size].T
            cells[k, size:, size:] = column_cell.T @ column_cell
            if part.fixed.any():
                cells[k, :size, :size] = row_cell.T @ row_cell
        return grams

    def with_variants(self, parts: Sequence[Columns], weights: Array, joint_rows: slice) -> Array:
        """Return Gram matrices (V, P + p + 1, P + p + 1) of all rows with each of V variants of a term.

        Args:
            parts: p columns of each variant, on the rows of a joint.
            weights: weight of the equations of each entry (E,).
            joint_rows: rows of the joint of the variants.
        """
        square, row_weight = weights**2, weights[self.entry[joint_rows], None]
        size, new_size = self.rows.shape[1], self.rows.shape[1] + parts[0].linear.shape[1]
        grams = np.empty((len(parts), new_size, new_size))
        if any(part.fixed.any() for part in parts):  # changes all errors in the rows of the joint
            elsewhere = np.delete(np.arange(len(weights)), np.unique(self.entry[joint_rows]))
            others = np.einsum("e,ekij->ij", square[elsewhere], self.grams[elsewhere])
            for gram, part in zip(grams, parts, strict=True):
                rows = row_weight * np.column_stack(self._extend(part, joint_rows))
                gram[:] = rows.T @ rows
                gram[:size, :size] += others
            return grams
        columns = (row_weight * self.near.scale[joint_rows, None]) * np.stack([part.linear for part in parts])
        grams[:, :size, :size] = np.einsum("e,ekij->ij", square, self.grams)
        grams[:, :size, size:] = (row_weight * self.rows[joint_rows]).T @ columns
        grams[:, size:, :size] = np.swapaxes(grams[:, :size, size:], 1, 2)
        grams[:, size:, size:] = np.swapaxes(columns, 1, 2) @ columns
        return grams

    def _extend(self, part: Columns, joint_rows: slice) -> tuple[Array, Array]:
        """Return the rows of a joint (r, P + 1), changed by fixed columns of a term, and the term's columns (r, p)."""
        rows, scale = self.rows[joint_rows], self.near.scale[joint_rows]
        if not part.fixed.any():
            return rows, scale[:, None] * part.linear
        ratio = 1.0 / (np.maximum(1.0 - scale * part.fixed_slope, LEAST_SLOPE) * part.torque_share)[:, None]
        error = rows[:, :1] - (scale * part.fixed)[:, None]
        return ratio * np.column_stack([error, rows[:, 1:]]), ratio * scale[:, None] * part.linear


def compute_entry_squares(grams: Array, step: Array) -> Array:
    """Return the squared error of each entry (E,) after a step (P,), from Gram matrices (E, K, P + 1, P + 1)."""
    combination = np.append(1.0, -step)
    return np.maximum(combination @ grams.sum(axis=1) @ combination, 0.0)


def solve_all_folds(grams: Array, weights: Array, least: Array, most: Array) -> Array | None:
    """Return the step (P,) of a fit to all folds within bounds (P,); arguments and None as in `solve_each_fold`."""
    return solve_gram(np.einsum("e,ekij->ij", weights**2, grams), least, most)


def solve_each_fold(grams: Array, weights: Array, least: Array, most: Array) -> Array | None:
    """Return the steps (K + 1, P) of a fit to all folds, and of fits without each; None for nearly collinear columns.

    Args:
        grams: Gram matrices of each entry and fold (E, K, P + 1, P + 1).
        weights: weight of the equations of each entry (E,).
        least, most: bounds of the step (P,).
    """
    folds = np.einsum("e,ekij->kij", weights**2, grams)
    steps = [solve_gram(gram, least, most) for gram in (folds.sum(axis=0), *sum_without_each(folds))]
    return None if any(step is None for step in steps) else np.array(steps)


def compute_squared_errors(grams: Array, least: Array, most: Array) -> Array:
    """Return squared errors (V,) of V fits within bounds (P,), from their Gram matrices (V, P + 1, P + 1).

    Parameters with equal bounds are known; their part moves to the left-hand side.
    """
    is_free = least < most
    substitution = np.eye(len(least) + 1)[:, np.append(True, is_free)]
    substitution[1:, 0] = np.where(is_free, 0.0, -least)
    grams, least, most = substitution.T @ grams @ substitution, least[is_free], most[is_free]
    scale = np.sqrt(np.maximum(np.diagonal(grams, axis1=1, axis2=2), 1e-300))  # (V, P + 1)
    grams = grams / (scale[:, :, None] * scale[:, None, :])
    normal, target = grams[:, 1:, 1:] + RIDGE * np.eye(grams.shape[1] - 1), grams[:, 1:, :1]
    theta = np.linalg.solve(normal, target)
    size = scale[:, 1:] / scale[:, :1]
    for k in np.flatnonzero(np.any((theta[:, :, 0] < least * size) | (theta[:, :, 0] > most * size), axis=1)).tolist():
        theta[k, :, 0] = solve_within(normal[k], target[k, :, 0], least * size[k], most * size[k])
    squares = 1.0 - 2 * (np.swapaxes(target, 1, 2) @ theta) + np.swapaxes(theta, 1, 2) @ grams[:, 1:, 1:] @ theta
    return np.asarray(np.maximum(squares[:, 0, 0], 0.0) * scale[:, 0] ** 2)
