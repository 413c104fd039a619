"""Normal equations kept apart by recording and by fold: fits with other weights, without a fold or with further columns
cost no pass over the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.regression.least_squares import solved, without_each
from pendulum_env._typing import Array, Index


@dataclass(frozen=True)
class Groups:
    """Recording and fold of each equation (R,), and which equations belong to each of E recordings and K folds."""

    owner: Index
    fold: Index
    rows: tuple[tuple[Index, ...], ...]

    @classmethod
    def of(cls, owner: Index, fold: Index, folds: int) -> Groups:
        """From the recording and the fold of each equation (R,)."""
        numbers = range(int(owner.max()) + 1)
        rows = tuple(tuple(np.flatnonzero((owner == e) & (fold == k)) for k in range(folds)) for e in numbers)
        return cls(owner, fold, rows)

    @property
    def counts(self) -> Index:
        """Equations of each recording (E,)."""
        return np.bincount(self.owner)


@dataclass(frozen=True)
class Normal:
    """Gram matrices of linear equations y = phi theta.

    Attributes:
        grams: of [y, phi] for each recording and fold (E, K, P + 1, P + 1).
        counts: equations of each recording (E,).
        least, most: bounds of the parameters (P,).
    """

    grams: Array
    counts: Index
    least: Array
    most: Array

    @classmethod
    def of(cls, rows: Array, groups: Groups, least: Array, most: Array) -> Normal:
        """Of rows [y, phi] (R, P + 1)."""
        grams = [[(own := rows[place]).T @ own for place in places] for places in groups.rows]
        return cls(np.array(grams), groups.counts, least, most)

    def beside(self, rows: Array, own: Array, here: slice, groups: Groups, least: Array, most: Array) -> Normal:
        """With further columns `own` (R_j, Q), which the equations `here` of whole recordings have, and bounds (Q,).

        `rows` are [y, phi] of all equations (R, P + 1).
        """
        first, more = rows.shape[1], own.shape[1]
        grams = np.zeros((*self.grams.shape[:2], first + more, first + more))
        grams[:, :, :first, :first] = self.grams
        begin, stop, _ = here.indices(len(rows))
        for e, places in enumerate(groups.rows):
            for k, place in enumerate(places):
                if len(place) and begin <= place[0] < stop:
                    new = own[place - begin]
                    cross = rows[place].T @ new
                    grams[e, k, :first, first:], grams[e, k, first:, :first] = cross, cross.T
                    grams[e, k, first:, first:] = new.T @ new
        return Normal(grams, self.counts, np.append(self.least, least), np.append(self.most, most))

    def solve(self, weights: Array) -> Array | None:
        """Parameters (P,) of least weighted squared error, given a weight for each recording (E,).

        None where the equations hardly tell them apart, and normal equations lose too many digits.
        """
        return solved(np.einsum("e,ekij->ij", weights**2, self.grams), self.least, self.most)

    def solve_without(self, weights: Array) -> Array | None:
        """The same without each fold (K, P)."""
        folds = np.einsum("e,ekij->kij", weights**2, self.grams)
        found = [solved(gram, self.least, self.most) for gram in without_each(folds)]
        return None if any(theta is None for theta in found) else np.array(found)

    def weights(self, theta: Array, least: float) -> Array:
        """Weight of each recording (E,) by what parameters (P,) leave of it, see `quietest_most`."""
        left = np.append(1.0, -theta)
        squares = np.einsum("i,eij,j->e", left, self.grams.sum(axis=1), left)
        return quietest_most(np.maximum(squares, 0.0), self.counts, least)


def quietest_most(squares: Array, counts: Index, least: float) -> Array:
    """Weight of each recording (E,) by the sum of its squared residuals (E,): the quietest counts most.

    Some may have no equations, by their counts (E,); below the level `least`, all are as quiet.
    """
    levels = np.maximum(np.sqrt(squares / np.maximum(counts, 1)), least) + 1e-300
    return np.where(counts > 0, levels[counts > 0].min() / levels, 0.0)
