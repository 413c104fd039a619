"""Rows of the torque balance, averaged over windows: fits of sets of terms, also with variants of one effect.

Recordings are weighted by their residual, so an unexplained recording does not bias the others. Many variants of an
effect are fitted by one batch of small solves of Gram matrices. Results are memoised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from estimators.decisions.score import FOLDS
from estimators.memoize import memoized
from estimators.regression.balance import Balance, Columns, Tangent, compute_least_square
from estimators.regression.fold_fits import solve_without
from estimators.regression.fold_grams import compute_squared_errors
from estimators.search_hints import find_hints, is_possible
from estimators.weak_form.columns import is_torque_dependent, list_bounds
from estimators.weak_form.floors import (
    compute_absorbed_noise,
    compute_noise_floor,
    compute_precision,
    measure_structure,
)
from estimators.weak_form.nonlinear import (
    compute_nonlinear_slopes,
    find_edges,
    list_continuous_parameters,
    refine_nonlinear,
    scan_edges,
    search_by_cross_entropy,
)
from estimators.weak_form.point import Point
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.row_fits import RowFits
from estimators.weak_form.rows import FoldFits, RowLayout, ScoredTerms, Terms
from estimators.weak_form.torque_columns import TorqueColumns
from estimators.weak_form.torque_windows import TorqueWindows
from estimators.weak_form.variant_rows import VariantRows
from estimators.weak_form.windows import mark_contacts
from pendulum_env._typing import Array
from pendulum_env.physics import Term

VARIANTS = RESOLUTION.variants


@dataclass(eq=False)
class TorqueRows:
    """Rows of the torque of the windows `data`; a `RowMaker`."""

    data: TorqueWindows

    @cached_property
    def layout(self) -> RowLayout:
        """Joints, blocks and noise of the rows."""
        data = self.data
        windows = {at: data.part(at).windows for at in data.joints}
        is_contact = np.concatenate([mark_contacts(w) for w in data.windows])
        return RowLayout(
            joints={at: data.locate_rows(at) for at in data.joints},
            clusters=data.clusters,
            precision={at: compute_precision(of_joint) for at, of_joint in windows.items()},
            blocks=data.blocks,
            block=data.block,
            noise=lambda at, inertia: compute_noise_floor(windows[at], inertia),
            structure=lambda at, residual, inertia: measure_structure(windows[at], residual, inertia, data.block),
            is_bounded=is_contact if is_contact.any() else None,
        )

    @cached_property
    def regressor(self) -> TorqueColumns:
        """Columns of terms, and rows weighted by noise."""
        return TorqueColumns(self.data)

    @cached_property
    def fits(self) -> RowFits:
        """Fits of sets of terms."""
        return RowFits(self.regressor, self.layout)

    def columns(self, variants: Terms) -> list[Columns]:
        """Return the windowed columns of each variant of one effect, on the rows of its joint."""
        return self.regressor.columns(variants)

    def equations(self, terms: Terms, by_noise: bool = False) -> Balance:
        """Return the rows of some terms, weighted by residual and noise, or `by_noise` alone."""
        return self.regressor.equations(terms) if by_noise else self.fits.equations(terms)

    @memoized
    def fit_folds(self, terms: Terms) -> FoldFits:
        """Fit some terms to all rows and without each fold; linearised around the fit without the last if accurate."""
        linearised = self.fits.fit_linearly(terms) or self.fits.fit_last_term(terms)
        if linearised is not None:
            return linearised[0]
        theta, balance = self.fits.solve(terms), self.equations(terms)
        return FoldFits(tuple(terms), theta, solve_without(balance, self.layout.scored.fold, FOLDS, theta))

    def fit(self, terms: Terms, exactly: bool = False) -> Point:
        """Fit the linear parameters of some terms, to convergence also without `exactly`."""
        return Point(tuple(terms), self.fits.solve(terms))

    def residual(self, terms: Terms, theta: Array) -> Array:
        """Return the measured minus the predicted torque (R,) at some parameters [N m]."""
        return self.equations(terms, by_noise=True).error(theta)

    @memoized
    def make_frame(self, terms: Terms) -> Array:
        """Return an orthonormal basis (R, P) of the weighted derivatives of the errors by the parameters."""
        return np.linalg.qr(self.fits.linearise(terms).slopes * self.fits.weights(terms)[:, None])[0]

    def list_absorbed_noise(self, terms: Terms) -> list[tuple[slice, float]]:
        """Return, per term that filters torque, its rows and the variance of torque noise that it removes [(N m)^2].

        Errors are increased by this variance, so a lag does not gain by smoothing noise.
        """
        filters = [term for term in terms if term.fixed and term.has_state()]
        return [(self.data.locate_rows(term.at), self._average_absorbed_noise(term)) for term in filters]

    @memoized
    def _average_absorbed_noise(self, term: Term) -> float:
        """Return the variance of torque noise that a term removes from the rows of its joint [(N m)^2]."""
        return compute_absorbed_noise(self.data.part(term.at).windows, term)

    def nonlinear_jacobian(self, terms: Terms, theta: Array) -> tuple[Array, list[str]]:
        """Return derivatives (R, S) of the modelled torque by continuous nonlinear parameters, and their full names.

        `theta` (P,) are the linear parameters. Links with estimated states are left out: for any inertia J of a link,
        other w, c, g and parameters of the joint give the same torque J (q'' - w^2 s - c s' + g sin q) along a motion.
        """
        slopes: dict[str, Array] = {}
        start = 0
        for term in terms:
            parameters = theta[start : (start := start + len(term.columns))]
            if term.id in self.data.link_states:
                continue

            def torques(variants: Terms, parameters: Array = parameters) -> list[Array]:
                return [linear @ parameters + fixed for linear, fixed in self.data.columns(variants)]

            width = float(np.ptp(self.data.part(term.at).samples.position))
            for name, slope in compute_nonlinear_slopes(term, torques, width).items():
                slopes[name] = slope_of_rows = np.zeros(len(self.data.weights))
                slope_of_rows[self.data.locate_rows(term.at)] = slope
        return np.column_stack([np.empty((len(self.data.weights), 0)), *slopes.values()]), list(slopes)

    def compare(self, terms: Terms, variants: Terms) -> list[float]:
        """Return the weighted RMS torque error [N m] of the fit of the terms plus each of V variants of one effect.

        Torque noise that terms remove is included. The best variants that depend on the torque are fitted exactly.
        """
        w, here = self.fits.weights(terms), self.data.locate_rows(variants[0].at)
        parts = self.columns(variants)
        with_variant = cache(
            lambda: VariantRows(self.fits, tuple(terms)).with_variant(here)
        )  # made only if a variant is fitted exactly

        def exact(variant: Term, columns: Columns) -> float:
            return compute_least_square(with_variant()(variant, columns))

        if not terms:
            squares = np.array([exact(*pair) for pair in zip(variants, parts, strict=True)])
        else:
            grams = self.fits.make_grams(terms)
            start = np.append(grams.near.theta, np.zeros(len(variants[0].columns)))
            limits = [end - start for end in list_bounds((*terms, variants[0]))]

            def squared(parts: Sequence[Columns]) -> Array:
                return compute_squared_errors(grams.with_variants(parts, self.fits.weigh_entries(terms), here), *limits)

            squares = squared(parts)
            if is_torque_dependent(variants[0]):
                predicted = squared([_move_to_prediction(part, grams.near, here) for part in parts])
                squares = _refit_exactly(list(zip(variants, parts, strict=True)), (squares, predicted), exact)
        absorbed = [self._weigh_absorbed_noise((*terms, variant), w) for variant in variants]
        return np.sqrt(squares / (w @ w) + absorbed).tolist()

    def _weigh_absorbed_noise(self, terms: Terms, w: Array) -> float:
        """Return the variance of torque noise that terms remove, mean over rows of weights (R,) [(N m)^2]."""
        absorbed = self.list_absorbed_noise(terms)
        return sum(float(w[here] @ w[here]) * variance for here, variance in absorbed) / float(w @ w)

    def score_terms(self, terms: Terms) -> ScoredTerms:
        """Return a set of terms with the error of its fit, see `compare`."""
        *others, last = terms
        return ScoredTerms(tuple(terms), self.compare(others, [last])[0])

    def search_basins(self, terms: Terms, variants: Terms) -> ScoredTerms:
        """Return the best trial of the terms with a variant, by one search per value of its multimodal parameter."""
        residuals, name = (
            VariantRows(self.fits, tuple(terms)).make_residual_function(),
            find_hints(type(variants[0])).multimodal,
        )
        values = {variant.nonlinear_values[name] for variant in variants}
        basins = [[v for v in variants if v.nonlinear_values[name] == value] for value in sorted(values)]
        trials = [self.score_terms((*terms, search_by_cross_entropy(basin, residuals))) for basin in basins]
        best = min(trials, key=lambda trial: trial.fitted_rms)
        refined = self.score_terms((*terms, refine_nonlinear(best.terms[-1], residuals)))
        return min(best, refined, key=lambda trial: trial.fitted_rms)

    def refine(self, trial: ScoredTerms, id: str) -> ScoredTerms:
        """Optimise the nonlinear parameters of the term `id` of a trial; return the trial itself if not better.

        Parameters that follow a linear parameter are set to it. Multimodal terms stay.
        """
        index = next(i for i, term in enumerate(trial.terms) if term.id == id)
        term = trial.terms[index]
        if find_hints(type(term)).multimodal:
            return trial
        others = (*trial.terms[:index], *trial.terms[index + 1 :])
        following = [parameter for parameter in term.nonlinear_parameters if parameter.follows]
        for _ in range(VARIANTS.follows if following else 0):
            theta = self.fits.solve((*others, term))
            values = dict(zip((c.name for other in others for c in other.columns), theta, strict=False))
            term = replace(term, **{s.name: float(values[s.follows]) for s in following if s.follows in values})
        residuals, samples = VariantRows(self.fits, others).make_residual_function(), self.data.part(term.at).samples
        gain = VARIANTS.gain if is_torque_dependent(term) else 0.0
        span, refined, edges = float(np.ptp(samples.time)), term, find_edges(term, samples)
        reach, longest = VARIANTS.reach * span, VARIANTS.longest * span
        for _ in range(1 + bool(edges and len(list_continuous_parameters(term)) > 1)):
            refined = refine_nonlinear(refined, residuals, edges, gain, longest, float(np.ptp(samples.position)))
            refined = scan_edges(refined, residuals, edges, reach)
        refined_trial = self.score_terms((*trial.terms[:index], refined, *trial.terms[index + 1 :]))
        is_worse = refined_trial.fitted_rms > trial.fitted_rms and not following
        return trial if is_worse or not is_possible(refined, samples) else refined_trial


def _move_to_prediction(part: Columns, near: Tangent, here: slice) -> Columns:
    """Return the columns of a term at the torque that other terms predict, to first order from the recorded torque."""
    return part._replace(linear=part.linear - near.error[here, None] * part.slope)


def _refit_exactly(
    pairs: Sequence[tuple[Term, Columns]], estimates: Sequence[Array], exact: Callable[[Term, Columns], float]
) -> Array:
    """Return squared errors (V,) of variants that depend on the torque, exact for the best by each of the estimates.

    The other squared errors are those of the first estimate (V,), at least the smallest exact error.
    """
    best = np.unique([np.argsort(estimate)[: VARIANTS.exact] for estimate in estimates])
    exact_squares = np.array([exact(*pairs[k]) for k in best.tolist()])
    squares = np.maximum(estimates[0], exact_squares.min())
    squares[best] = exact_squares
    return squares
