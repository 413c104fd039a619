"""Fits of sets of terms to rows of torque, weighted by residual, and without each fold, by Gram matrices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.decisions.score import FOLDS
from estimators.memoize import memoized
from estimators.regression.balance import Balance, Tangent
from estimators.regression.fold_fits import is_near_tangent
from estimators.regression.fold_grams import FoldGrams, compute_entry_squares, solve_all_folds, solve_each_fold
from estimators.regression.least_squares import weigh_recordings
from estimators.weak_form.columns import is_torque_dependent, list_bounds
from estimators.weak_form.floors import compute_numerical_error
from estimators.weak_form.rows import FoldFits, RowLayout, Terms
from estimators.weak_form.torque_columns import TorqueColumns
from pendulum_env._typing import Array


@dataclass(eq=False)
class RowFits:
    """Fits of the linear parameters of terms to R rows; results are memoised.

    Recordings are weighted by their residual, so an unexplained recording does not bias the others.

    Attributes:
        regressor: columns of terms, and rows weighted by noise.
        layout: blocks of the rows, which give the folds.
    """

    regressor: TorqueColumns
    layout: RowLayout

    def equations(self, terms: Terms) -> Balance:
        """Return the rows of some terms, weighted by residual and noise."""
        return replace(self.regressor.equations(terms), weights=self.weights(terms))

    def weights(self, terms: Terms) -> Array:
        """Return the weight of each row (R,), smaller for entries with a larger residual of the terms."""
        return self.weigh_entries(terms)[self.regressor.data.recording_of_window]

    @memoized
    def weigh_entries(self, terms: Terms) -> Array:
        """Return the weight of each entry (E,) by its residual under the terms; by noise without terms or of one entry.

        An entry is a recording, or one joint of a recording.
        """
        if len(self.regressor.data.windows) == 1 or not terms:
            return self._entry_weights
        if (linear_fit := self.fit_linearly(terms)) is not None:
            return linear_fit[1]
        balance, owner = self.regressor.equations(terms), self.regressor.data.recording_of_window
        squares = np.bincount(owner, balance.error(self._solve_by_noise(terms)) ** 2).astype(float)
        return weigh_recordings(squares, np.bincount(owner), compute_numerical_error(self.regressor.data.windows))

    @memoized
    def _solve_by_noise(self, terms: Terms) -> Array:
        """Fit the linear parameters (P,) with the weights of noise.

        If terms before the last depend on the torque, the fit without the last term is the start.
        """
        *others, last = terms
        start = None
        if is_torque_dependent(*others):
            start = np.append(self._solve_by_noise(tuple(others)), np.zeros(len(last.columns)))
        return self.regressor.equations(terms).solve(start)

    @memoized
    def solve(self, terms: Terms) -> Array:
        """Fit the linear parameters (P,) of the terms to all windows."""
        if (linear_fit := self.fit_linearly(terms)) is not None:
            return linear_fit[0].theta
        balance, is_single = self.equations(terms), len(self.regressor.data.windows) == 1
        return balance.solve(None if balance.is_linear or is_single else self._solve_by_noise(terms))

    @memoized
    def fit_linearly(self, terms: Terms) -> tuple[FoldFits, Array] | None:
        """Return the fits of terms, and the weights of entries (E,); None if a term depends on the torque."""
        return None if is_torque_dependent(*terms) else self.fit_last_term(terms)

    def fit_last_term(self, terms: Terms) -> tuple[FoldFits, Array] | None:
        """Fit the last of some terms with the others, to first order around the fit of these, by Gram matrices.

        Returns:
            The fits, and the weights of entries (E,); None if columns are nearly collinear, or if the first order is
            inaccurate.
        """
        (*others, last), data = terms, self.regressor.data
        if not others or is_torque_dependent(last):
            return None

        def linearise(by_noise: bool) -> tuple[Array, Array, Array, Array]:
            """Return Gram matrices of the terms, parameters (P,) at a step of zero, and bounds of a step."""
            known, (least, most) = self.make_grams(others, by_noise), list_bounds(terms)
            start = np.append(known.near.theta, np.zeros(len(last.columns)))
            grams = known.with_term(self.regressor.columns([last])[0], data.locate_rows(last.at))
            return grams, start, least - start, most - start

        weights, owner = self._entry_weights, data.recording_of_window
        if len(weights) > 1:
            grams, _, *bounds = linearise(True)
            if (step := solve_all_folds(grams, weights, *bounds)) is None:
                return None
            counts = np.bincount(owner, minlength=len(weights))
            squares, error = compute_entry_squares(grams, step), compute_numerical_error(data.windows)
            weights = weigh_recordings(squares, counts, error)
        grams, start, *bounds = linearise(False)
        if (steps := solve_each_fold(grams, weights, *bounds)) is None:
            return None
        theta = np.clip(start + steps, *list_bounds(terms))  # sums may miss a bound by rounding
        fits = FoldFits(tuple(terms), theta[0], theta[1:])
        if is_torque_dependent(*others):
            square = float(weights**2 @ compute_entry_squares(grams, steps[0]))
            balance = replace(self.regressor.equations(terms), weights=weights[owner])
            if not is_near_tangent(balance, fits.theta, np.ones(len(owner), dtype=bool), square):
                return None
        return fits, weights

    @memoized
    def make_grams(self, terms: Terms, by_noise: bool = False) -> FoldGrams:
        """Return the Gram matrices of the rows, linearised around the fit of the terms, or the fit `by_noise` alone."""
        if by_noise and not is_torque_dependent(*terms):
            return self.make_grams(terms)  # linear rows have the same matrices around any fit
        balance, data = self.regressor.equations(terms), self.regressor.data
        near = balance.linearise(self._solve_by_noise(terms)) if by_noise else self.linearise(terms)
        return FoldGrams.compute(near, data.recording_of_window, self.layout.scored.fold, len(data.windows), FOLDS)

    @cached_property
    def _entry_weights(self) -> Array:
        """Weight of each recording by its noise (E,), the mean over its rows."""
        owner = self.regressor.data.recording_of_window
        counts = np.bincount(owner, minlength=len(self.regressor.data.windows))
        return np.bincount(owner, self.regressor.data.weights, len(counts)) / np.maximum(counts, 1)

    @memoized
    def linearise(self, terms: Terms) -> Tangent:
        """Return the errors near the fit of the terms, to first order; around zero where they are linear."""
        balance = self.regressor.equations(terms)
        return balance.linearise(None if balance.is_linear else self.solve(terms))

    @memoized
    def make_frame_of_unknown(self, terms: Terms) -> Array:
        """Return an orthonormal basis (R, F) of the weighted derivatives of the errors by the F unknown parameters."""
        least, most = list_bounds(terms)
        return np.linalg.qr(self.linearise(terms).slopes[:, least < most] * self.weights(terms)[:, None])[0]
