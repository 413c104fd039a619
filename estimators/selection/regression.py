"""Least-squares fits of sets of terms to windows of data; results are memoised.

Recordings are weighted by their residual, so an unexplained recording does not bias the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from estimators.memoize import memoized
from estimators.regression.balance import Balance, Columns, Tangent, condensed, placed, unbent
from estimators.regression.least_squares import quietest_most
from estimators.selection.columns import ColumnCutter, bounds
from estimators.selection.score import BLOCK, FOLDS
from estimators.weak_form.dataset import Dataset
from estimators.weak_form.nonlinear import nonlinear_slopes
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Term

RECENT = 4  # sets of terms whose equations are kept


class Regression:
    """Fits of sets of terms to one dataset.

    Attributes:
        data: windows of recordings.
    """

    def __init__(self, data: Dataset) -> None:
        self.data = data
        self._cutter = ColumnCutter(data)
        self._recent: dict[tuple[Term, ...], Balance] = {}
        self._torque = data.net_torque()
        self._owner = data.recording_of_window
        self._fold: Index = data.blocks(BLOCK)[0] % FOLDS

    def columns(self, variants: Sequence[Term]) -> list[Columns]:
        """Return the windowed columns of each variant of one effect, on the rows of its joint."""
        return self._cutter.columns(variants)

    def cut(self, variants: Sequence[Term]) -> list[Columns]:
        """Return the columns of variants that a search meets only once: they are not memoised."""
        return self._cutter.cut(variants)

    def place_columns(self, terms: Sequence[Term], parts: Sequence[Array]) -> Array:
        """Return the columns of some terms side by side (R, P), each on the rows of its joint."""
        return placed(
            len(self._torque), [(self.data.where(term.at), own) for term, own in zip(terms, parts, strict=True)]
        )

    def balance(self, terms: Sequence[Term]) -> Balance:
        """Return the equations of some terms, with smaller weights for recordings with larger residuals."""
        return replace(self.equations(terms), weights=self.weights(terms))

    def equations(self, terms: Sequence[Term]) -> Balance:
        """Return the equations of some terms, weighted by noise alone; those of the last sets are memoised."""
        key = tuple(terms)
        if key not in self._recent:
            if len(self._recent) >= RECENT:
                self._recent.pop(next(iter(self._recent)))
            self._recent[key] = self.assemble(terms, self.parts(terms), self.data.weights)
        return self._recent[key]

    def parts(self, terms: Sequence[Term]) -> list[Columns]:
        """Return the columns of each of some terms."""
        return [self.columns([term])[0] for term in terms]

    def assemble(self, terms: Sequence[Term], parts: Sequence[Columns], weights: Array) -> Balance:
        """Return the equations of some terms from the columns of each and weights (R,)."""
        rows = [self.data.where(term.at) for term in terms]
        balance = Balance.of(self._torque, weights).beside(
            list(zip(rows, parts, strict=True)), *bounds(terms), self._cutter.pushes
        )
        if not any(term.lead for term in terms):
            return balance
        unfiltered, lead = self._torque.copy(), np.zeros(len(weights))
        for here, term, part in zip(rows, terms, parts, strict=True):
            unfiltered[here] -= 0.0 if term.lead else part.fixed
            lead[here] += term.lead
        ahead = balance.phi + lead[:, None] * self.place_columns(terms, [self._cutter.rates(term) for term in terms])
        y = unfiltered - lead * self.data.load_rates
        return replace(balance, recorded=replace(balance, phi=ahead, y=y, passed=1.0))

    def beside(self, terms: Sequence[Term], here: slice) -> Callable[[Term, Columns], Balance]:
        """Return a function that gives the equations of the terms and a variant, from the variant's columns.

        The part of the terms is computed once. Equations of other joints that are linear are condensed to their fit.
        """
        if not terms or any(term.lead for term in terms):  # there is nothing to begin with, or that is seen twice
            shared, w = self.parts(terms), self.weights(terms)
            return lambda variant, own: self.assemble((*terms, variant), [*shared, own], w)
        first, pushes = self.balance(terms), self._cutter.pushes
        elsewhere = np.ones(len(pushes), dtype=bool)
        elsewhere[here] = False
        if elsewhere.any() and unbent(first)[elsewhere].all():
            first, own_pushes = condensed(first, elsewhere), pushes[here]
            wide = np.tile(pushes.max(axis=0), (len(first.y) - len(own_pushes), 1))
            here, pushes = slice(0, len(own_pushes)), np.concatenate([own_pushes, wide])
        return lambda variant, own: first.beside([(here, own)], *bounds([variant]), pushes)

    @memoized
    def solve(self, terms: Sequence[Term]) -> Array:
        """Fit the linear parameters (P,) of the terms to all windows."""
        return self.balance(terms).solve()

    def solve_without(self, terms: Sequence[Term]) -> Array:
        """Fit the linear parameters of the terms without each fold of blocks (FOLDS, P)."""
        return self.balance(terms).solve_without(self._fold, FOLDS)

    def weights(self, terms: Sequence[Term]) -> Array:
        """Return the weight of each equation (R,), smaller for recordings with larger residuals."""
        if len(self.data.windows) == 1 or not terms:
            return self.data.weights
        return self._weight_of_each(terms)[self._owner]

    @memoized
    def _weight_of_each(self, terms: Sequence[Term]) -> Array:
        """Return the weight of each recording (E,)."""
        balance, counts = self.equations(terms), np.bincount(self._owner)
        squares = np.bincount(self._owner, balance.error(balance.solve()) ** 2).astype(float)
        return quietest_most(squares, counts, self.data.least())

    def fitted_terms(self, terms: Sequence[Term]) -> tuple[Term, ...]:
        """Return the terms with nonlinear parameters that follow others as fitted: here a search has set them."""
        return tuple(terms)

    def converge(self, terms: Sequence[Term]) -> tuple[Term, ...]:
        """Return the terms fitted to convergence, as they always are here."""
        return tuple(terms)

    @memoized
    def tangent(self, terms: Sequence[Term]) -> Tangent:
        """Return the errors near the fit of the terms, to first order."""
        return self.balance(terms).tangent()

    @memoized
    def frame(self, terms: Sequence[Term]) -> Array:
        """Return an orthonormal basis (R, P) of changes of the weighted errors by the parameters."""
        return np.linalg.qr(self.tangent(terms).slopes * self.weights(terms)[:, None])[0]

    def residual(self, terms: Sequence[Term]) -> Array:
        """Return the torque (R,) that a fit of the terms does not predict [N m]."""
        return self.balance(terms).error(self.solve(terms))

    def absorbed_noise(self, terms: Sequence[Term]) -> list[tuple[slice, float]]:
        """Return the variance of torque noise that terms filter out of the equations, with their rows [(N m)^2].

        It still counts as error: a lag smooths the noise of the torque together with the torque, which must not raise
        its likelihood.
        """
        filters = [term for term in terms if term.fixed and term.has_state()]
        return [(self.data.where(term.at), self._absorbed(term)) for term in filters]

    @memoized
    def _absorbed(self, term: Term) -> float:
        return self.data.part(term.at).absorbed(term)

    def nonlinear_jacobian(self, terms: Sequence[Term], theta: Array) -> tuple[Array, list[str]]:
        """Return derivatives (R, S) of the modelled torque by continuous nonlinear parameters, and their names.

        Those of a link with estimated states are left out, since its motion determines them. Along one motion its
        torque J (q'' - w^2 s - c s' + g sin q) is the same for any J, if w, c, g and the joint's own parameters follow.
        """
        slopes: dict[str, Array] = {}
        first = 0
        for term in terms:
            own = theta[first : (first := first + len(term.columns))]
            if term.id in self.data.link_states:
                continue

            def torques(variants: Sequence[Term], own: Array = own) -> list[Array]:
                return [linear @ own + fixed for linear, fixed in self.data.columns(variants)]

            for name, slope in nonlinear_slopes(term, torques).items():
                slopes[name] = whole = np.zeros(len(self.data.weights))
                whole[self.data.where(term.at)] = slope
        return np.column_stack([np.empty((len(self.data.weights), 0)), *slopes.values()]), list(slopes)
