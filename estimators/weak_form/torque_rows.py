"""Rows of the torque balance, averaged over windows: fits of sets of terms, also with variants of one effect.

Recordings are weighted by their residual, so an unexplained recording does not bias the others. All nonlinear
parameters of an effect are compared through Gram matrices of the rows, so that a fit of many variants costs one batch
of small solves. Results are memoised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np

from estimators.data.rows import FOLDS, FittedTerms, FoldFits, RowLayout, ScoredTerms, Terms
from estimators.memoize import memoized
from estimators.regression.balance import Balance, Columns, Tangent, condense, place_columns
from estimators.regression.fold_grams import (
    FoldGrams,
    compute_entry_squares,
    compute_squared_errors,
    solve_all_folds,
    solve_each_fold,
)
from estimators.regression.least_squares import weigh_recordings
from estimators.search_hints import find_hints, is_possible
from estimators.weak_form.columns import bounds_of_laws, is_known, is_torque_dependent, list_bounds
from estimators.weak_form.nonlinear import (
    Residuals,
    compute_nonlinear_slopes,
    cross_entropy,
    find_edges,
    list_continuous_parameters,
    refine_nonlinear,
    scan_edges,
)
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Term

RECENT = 4  # sets of terms whose equations are kept
PERTURBATION = 1e-6  # of the largest torque, for slopes by it
PERTURBATIONS = np.array([0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0])  # of it, both ways, for nonlinear laws


@dataclass(frozen=True)
class VariantSettings:
    """Extent of the search for the best variant of an effect."""

    exact: int = 3  # most promising variants of a law of the torque, fitted exactly
    reach: float = 0.03  # of the recording, range of the scan for an instant
    follows: int = 3  # iterations that set a nonlinear parameter to the parameter that it follows


VARIANTS = VariantSettings()


@dataclass(eq=False)
class TorqueRows:
    """Rows of the torque of some windows.

    Attributes:
        data: windows of recordings.
    """

    data: TorqueWindows
    _columns: dict[Term, Columns] = field(default_factory=dict, init=False)
    _recent: dict[tuple[Term, ...], Balance] = field(default_factory=dict, init=False)

    @cached_property
    def layout(self) -> RowLayout:
        """Joints, blocks and noise of the rows."""
        data = self.data
        precision = {at: data.part(at).precision() for at in data.joints}
        return RowLayout(
            joints={at: data.locate_rows(at) for at in data.joints},
            clusters=data.clusters,
            precision=precision,
            blocks=data.blocks,
            noise=lambda at, inertia: data.part(at).noise(inertia),
            structure=lambda at, residual, inertia: data.part(at).structure(residual, inertia),
        )

    @cached_property
    def _torque(self) -> Array:
        return self.data.net_torque()

    @memoized
    def _of_joint(self, joint: str) -> TorqueRows:
        return TorqueRows(self.data.part(joint))

    def select_joint(self, joint: str) -> TorqueRows:
        """Return the rows of a joint; all rows for a term at no single joint."""
        return self if self.data.part(joint) is self.data else self._of_joint(joint)

    def columns(self, variants: Terms) -> list[Columns]:
        """Return the windowed columns of each variant of one effect, on the rows of its joint."""
        if (own := self.select_joint(variants[0].at)) is not self:
            return own.columns(variants)
        missing = [variant for variant in variants if variant not in self._columns]
        if missing:
            self._columns.update(zip(missing, self.make_columns(missing), strict=True))
        return [self._columns[variant] for variant in variants]

    def make_columns(self, variants: Terms) -> list[Columns]:
        """Return the columns of variants that a search uses once: they are not memoised."""
        if (own := self.select_joint(variants[0].at)) is not self:
            return own.make_columns(variants)
        plain, kind, torque = self.data.columns(variants), variants[0], self.data.torque()
        if not is_torque_dependent(kind):
            return [Columns(own, fixed, np.zeros_like(own)) for own, fixed in plain]
        step = PERTURBATION * self._largest_torque
        pairs = zip(plain, self._perturbed.columns(variants), strict=True)
        parts = [
            Columns(own, fixed, (more - own) / step, (moved - fixed) / step) for (own, fixed), (more, moved) in pairs
        ]
        if not (kind.fixed and kind.has_state()):
            return parts
        whole = float(np.linalg.norm(torque))
        remaining = [float(np.linalg.norm(torque - part.fixed)) for part in parts]
        return [
            part if variant.delay or rest >= whole else part._replace(torque_share=max(rest / whole, 1e-12))
            for variant, part, rest in zip(variants, parts, remaining, strict=True)
        ]

    def _with_change(self, term: Term, part: Columns) -> Columns:
        """Return the columns of a term with the change of its fixed ones under perturbations of the torque."""
        if (own := self.select_joint(term.at)) is not self:
            return own._with_change(term, part)
        if not term.fixed or term.has_state():
            return part
        more = np.nan_to_num(self.data.averages.fixed_under(term, self._perturbations), nan=0.0, posinf=0.0, neginf=0.0)
        return part._replace(fixed_change=more - part.fixed[:, None])

    @property
    def _largest_torque(self) -> float:
        return max(float(np.abs(self.data.torque()).max()), 1e-12)

    @cached_property
    def _perturbed(self) -> TorqueWindows:
        return self.data.with_torque(offset=PERTURBATION * self._largest_torque)

    @property
    def _perturbations(self) -> Array:
        """Increasing perturbations of the torque (J,) [N m], zero in the middle, to solve nonlinear laws for it."""
        return self._largest_torque * np.concatenate([-PERTURBATIONS[::-1], [0.0], PERTURBATIONS])

    @cached_property
    def perturbations(self) -> Array:
        """Perturbations of the torque in each row of all joints (R, J) [N m]."""
        joints = [self.select_joint(at) for at in self.data.joints]
        return np.concatenate([np.tile(own._perturbations, (len(own.data.weights), 1)) for own in joints])

    @memoized
    def _rates(self, term: Term) -> Array:
        """Return time derivatives of the linear columns of a term (R, P), on the rows of its joint."""
        return self.data.rates(term)

    def equations(self, terms: Terms, by_noise: bool = False) -> Balance:
        """Return the rows of some terms, weighted as in a fit, or `by_noise` alone; the last sets are memoised."""
        key = tuple(terms)
        if key not in self._recent:
            if len(self._recent) >= RECENT:
                self._recent.pop(next(iter(self._recent)))
            self._recent[key] = self.assemble(terms, self.columns_of_each(terms), self.data.weights)
        found = self._recent[key]
        return found if by_noise else replace(found, weights=self.weights(terms))

    def columns_of_each(self, terms: Terms) -> list[Columns]:
        """Return the columns of each of some terms."""
        return [self._whole_columns(term) for term in terms]

    @memoized
    def _whole_columns(self, term: Term) -> Columns:
        return self._with_change(term, self.columns([term])[0])

    def assemble(self, terms: Terms, parts: Sequence[Columns], weights: Array) -> Balance:
        """Return the rows of some terms from the columns of each and weights (R,)."""
        rows = [self.data.locate_rows(term.at) for term in terms]
        balance = Balance.from_target(self._torque, weights).with_columns(
            list(zip(rows, parts, strict=True)), *list_bounds(terms), self.perturbations
        )
        if not any(term.lead for term in terms):
            return balance
        unfiltered, lead = self._torque.copy(), np.zeros(len(weights))
        for here, term, part in zip(rows, terms, parts, strict=True):
            unfiltered[here] -= 0.0 if term.lead else part.fixed
            lead[here] += term.lead
        rates = place_columns(len(weights), [(here, self._rates(term)) for here, term in zip(rows, terms, strict=True)])
        y = unfiltered - lead * self.data.load_rates
        return replace(
            balance, unfiltered=replace(balance, phi=balance.phi + lead[:, None] * rates, y=y, torque_share=1.0)
        )

    def with_variant(self, terms: Terms, here: slice) -> Callable[[Term, Columns], Balance]:
        """Return a function that gives the rows of the terms and a variant, from the variant's columns.

        The part of the terms is computed once. Rows of other joints are condensed to the tangent of their errors, which
        are linear unless friction there grows with the load.
        """
        if not terms or any(term.lead for term in terms):  # no shared part, or one that each variant changes
            shared, w = self.columns_of_each(terms), self.weights(terms)
            return lambda variant, own: self.assemble((*terms, variant), [*shared, self._with_change(variant, own)], w)
        first, perturbations = self.equations(terms), self.perturbations
        elsewhere = np.ones(len(perturbations), dtype=bool)
        elsewhere[here] = False
        if elsewhere.any():
            near, own_rows = self.tangent(terms), perturbations[here]
            first = condense(first, elsewhere, near.slopes[elsewhere], near.target[elsewhere])
            wide = np.tile(perturbations.max(axis=0), (len(first.y) - len(own_rows), 1))
            here, perturbations = slice(0, len(own_rows)), np.concatenate([own_rows, wide])
        return lambda variant, own: first.with_columns(
            [(here, self._with_change(variant, own))], *list_bounds((*terms, variant)), perturbations
        )

    def weights(self, terms: Terms) -> Array:
        """Return the weight of each row (R,), smaller for recordings with larger residuals."""
        return self._weight_of_each(terms)[self.data.recording_of_window]

    @memoized
    def _weight_of_each(self, terms: Terms) -> Array:
        """Return the weight of each recording (E,)."""
        if len(self.data.windows) == 1 or not terms:
            return self._noise_of_each
        if (found := self._fit_linearly(terms)) is not None:
            return found[1]
        balance, owner = self.equations(terms, by_noise=True), self.data.recording_of_window
        squares = np.bincount(owner, balance.error(self._solve_by_noise(terms)) ** 2).astype(float)
        return weigh_recordings(squares, np.bincount(owner), self.data.least())

    @memoized
    def _solve_by_noise(self, terms: Terms) -> Array:
        """Fit the terms with the weights of noise alone, near the fit without the last if that is not linear."""
        *others, last = terms
        start = None
        if is_torque_dependent(*others):
            start = np.append(self._solve_by_noise(tuple(others)), np.zeros(len(last.columns)))
        return self.equations(terms, by_noise=True).solve(start)

    @memoized
    def solve(self, terms: Terms) -> Array:
        """Fit the linear parameters (P,) of the terms to all windows."""
        if (found := self._fit_linearly(terms)) is not None:
            return found[0].theta
        balance = self.equations(terms)
        return balance.solve(None if balance.is_linear or len(self.data.windows) == 1 else self._solve_by_noise(terms))

    @memoized
    def fit_folds(self, terms: Terms) -> FoldFits:
        """Fit some terms to all rows and without each fold, to first order in the last term if that suffices."""
        found = self._fit_linearly(terms) or self._fit_beside(terms)
        if found is not None:
            return found[0]
        theta, balance = self.solve(terms), self.equations(terms)
        return FoldFits(tuple(terms), theta, balance.solve_without(self.layout.fold, FOLDS, theta))

    @memoized
    def _fit_linearly(self, terms: Terms) -> tuple[FoldFits, Array] | None:
        """Return the fits of terms with linear equations, and the weights of recordings (E,); None of others."""
        return None if is_torque_dependent(*terms) else self._fit_beside(terms)

    def _fit_beside(self, terms: Terms) -> tuple[FoldFits, Array] | None:
        """Fit the last of some terms beside the others, to first order around the fit of these, by Gram matrices.

        Returns:
            The fits, and the weights of recordings (E,); None if columns are nearly collinear, or if the first order
            does not suffice.
        """
        *others, last = terms
        if not others or is_torque_dependent(last):
            return None

        def linearise(by_noise: bool) -> tuple[Array, Array, Array, Array]:
            """Return Gram matrices of the terms, parameters (P,) around which they are, and bounds of a step."""
            known, (part,), (least, most) = self._fold_grams(others, by_noise), self.columns([last]), list_bounds(terms)
            start = np.append(known.near.theta, np.zeros(len(last.columns)))
            return known.with_term(part, self.data.locate_rows(last.at)), start, least - start, most - start

        weights, owner = self._noise_of_each, self.data.recording_of_window
        if len(weights) > 1:
            grams, _, *bounds = linearise(True)
            if (step := solve_all_folds(grams, weights, *bounds)) is None:
                return None
            counts = np.bincount(owner, minlength=len(weights))
            weights = weigh_recordings(compute_entry_squares(grams, step), counts, self.data.least())
        grams, start, *bounds = linearise(False)
        if (steps := solve_each_fold(grams, weights, *bounds)) is None:
            return None
        fits = FoldFits(tuple(terms), start + steps[0], start + steps[1:])
        if is_torque_dependent(*others):
            square = float(weights**2 @ compute_entry_squares(grams, steps[0]))
            balance = replace(self.equations(terms, by_noise=True), weights=weights[owner])
            if not balance.fits_tangent(fits.theta, np.ones(len(owner), dtype=bool), square):
                return None
        return fits, weights

    @memoized
    def _fold_grams(self, terms: Terms, by_noise: bool = False) -> FoldGrams:
        """Return the Gram matrices of the rows of some terms, near their fit, or near that `by_noise` alone."""
        if by_noise and not is_torque_dependent(*terms):
            return self._fold_grams(terms)  # they are the same around any fit
        balance = self.equations(terms, by_noise=True)
        near = balance.tangent(self._solve_by_noise(terms)) if by_noise else self.tangent(terms)
        return FoldGrams.compute(near, self.data.recording_of_window, self.layout.fold, len(self.data.windows), FOLDS)

    @cached_property
    def _noise_of_each(self) -> Array:
        """Weight of each recording by its noise (E,)."""
        owner = self.data.recording_of_window
        counts = np.bincount(owner, minlength=len(self.data.windows))
        return np.bincount(owner, self.data.weights, len(counts)) / np.maximum(counts, 1)

    @cached_property
    def base_inertia(self) -> float:
        """Inertia of the joint by the base model, clear of contacts [kg m^2], which scales the noise."""
        if all(known := [w.recording.known_inertia for w in self.data.windows]):
            return max(known)
        if self.data.contacts:
            return TorqueRows(self.data.without_contacts).base_inertia
        theta = (
            self.equations(BASE).with_bounds(*bounds_of_laws(BASE)).solve()
        )  # below zero if the sign of torque is wrong
        return abs(float(theta[[term.id for term in BASE].index("inertia")]))

    def fit(self, terms: Terms, exactly: bool = False) -> FittedTerms:
        """Fit the linear parameters of some terms, always to convergence; a search sets nonlinear parameters."""
        return FittedTerms(tuple(terms), self.solve(terms))

    def residual(self, terms: Terms, theta: Array) -> Array:
        """Return the measured minus the predicted torque (R,) at some parameters [N m]."""
        return self.equations(terms, by_noise=True).error(theta)

    @memoized
    def tangent(self, terms: Terms) -> Tangent:
        """Return the errors near the fit of the terms, to first order; around zero where they are linear."""
        balance = self.equations(terms, by_noise=True)
        return balance.tangent(None if balance.is_linear else self.solve(terms))

    @memoized
    def _frame(self, terms: Terms) -> Array:
        """Return an orthonormal basis (R, P) of changes of the weighted errors by the parameters."""
        return np.linalg.qr(self.tangent(terms).slopes * self.weights(terms)[:, None])[0]

    def absorbed_noise(self, terms: Terms) -> list[tuple[slice, float]]:
        """Return the variance of torque noise that terms filter out of the rows, with these rows [(N m)^2].

        It still counts as error: a lag smooths the noise of the torque together with the torque, which must not raise
        its likelihood.
        """
        filters = [term for term in terms if term.fixed and term.has_state()]
        return [(self.data.locate_rows(term.at), self._absorbed(term)) for term in filters]

    @memoized
    def _absorbed(self, term: Term) -> float:
        return self.data.part(term.at).absorbed(term)

    def nonlinear_jacobian(self, terms: Terms, theta: Array) -> tuple[Array, list[str]]:
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

            def torques(variants: Terms, own: Array = own) -> list[Array]:
                return [linear @ own + fixed for linear, fixed in self.data.columns(variants)]

            for name, slope in compute_nonlinear_slopes(term, torques).items():
                slopes[name] = whole = np.zeros(len(self.data.weights))
                whole[self.data.locate_rows(term.at)] = slope
        return np.column_stack([np.empty((len(self.data.weights), 0)), *slopes.values()]), list(slopes)

    def compare(self, terms: Terms, variants: Terms) -> list[float]:
        """Return the torque error of the fit of the terms with each of V variants of one further effect [N m]."""
        w, here = self.weights(terms), self.data.locate_rows(variants[0].at)
        parts = self.columns(variants)
        with_variant = cache(lambda: self.with_variant(terms, here))  # most variants do not need it

        def exact(variant: Term, own: Columns) -> float:
            return with_variant()(variant, own).least_squared()

        if not terms or is_known(*terms, variants[0]):
            squares = np.array([exact(*pair) for pair in zip(variants, parts, strict=True)])
        else:
            grams = self._fold_grams(terms)
            start = np.append(grams.near.theta, np.zeros(len(variants[0].columns)))
            limits = [end - start for end in list_bounds((*terms, variants[0]))]

            def squared(parts: Sequence[Columns]) -> Array:
                return compute_squared_errors(grams.with_variants(parts, self._weight_of_each(terms), here), *limits)

            squares = squared(parts)
            if is_torque_dependent(variants[0]):
                predicted = squared([_at_prediction(part, grams.near, here) for part in parts])
                squares = _refit_exactly(list(zip(variants, parts, strict=True)), (squares, predicted), exact)
        absorbed = [self._mean_absorbed((*terms, variant), w) for variant in variants]
        return np.sqrt(squares / (w @ w) + absorbed).tolist()

    def _mean_absorbed(self, terms: Terms, w: Array) -> float:
        """Return the variance of torque noise that terms absorb, mean over all weighted rows (R,) [(N m)^2]."""
        absorbed = self.absorbed_noise(terms)
        return sum(float(w[here] @ w[here]) * variance for here, variance in absorbed) / float(w @ w)

    def trial(self, terms: Terms) -> ScoredTerms:
        """Fit one set of terms."""
        *others, last = terms
        return ScoredTerms(tuple(terms), self.compare(others, [last])[0])

    def search_basins(self, terms: Terms, variants: Terms) -> ScoredTerms:
        """Search from each value of the parameter over which the error is multimodal, and return the best trial."""
        residuals, name = self._residuals(terms), find_hints(type(variants[0])).multimodal
        places = {variant.nonlinear_values[name] for variant in variants}
        basins = [[v for v in variants if v.nonlinear_values[name] == place] for place in sorted(places)]
        found = [self.trial((*terms, cross_entropy(basin, residuals))) for basin in basins]
        best = min(found, key=lambda trial: trial.fitted_rms)
        closer = self.trial((*terms, refine_nonlinear(best.terms[-1], residuals)))
        return min(best, closer, key=lambda trial: trial.fitted_rms)

    def refine(self, trial: ScoredTerms, id: str) -> ScoredTerms:
        """Search the continuous nonlinear parameters of one term of a trial from their values."""
        place = next(i for i, term in enumerate(trial.terms) if term.id == id)
        term = trial.terms[place]
        if find_hints(type(term)).multimodal:
            return trial
        others = (*trial.terms[:place], *trial.terms[place + 1 :])
        following = [parameter for parameter in term.nonlinear_parameters if parameter.follows]
        for _ in range(VARIANTS.follows if following else 0):
            theta = self.solve((*others, term))
            known = dict(zip((c.name for other in others for c in other.columns), theta, strict=False))
            term = replace(term, **{s.name: float(known[s.follows]) for s in following if s.follows in known})
        residuals, samples = self._residuals(others), self.data.part(term.at).samples
        reach, found, edges = VARIANTS.reach * float(np.ptp(samples.time)), term, find_edges(term, samples)
        for _ in range(1 + bool(edges and len(list_continuous_parameters(term)) > 1)):
            found = scan_edges(refine_nonlinear(found, residuals, edges), residuals, edges, reach)
        closer = self.trial((*trial.terms[:place], found, *trial.terms[place + 1 :]))
        worse = closer.fitted_rms > trial.fitted_rms and not following
        return trial if worse or not is_possible(found, samples) else closer

    def _residuals(self, terms: Terms) -> Residuals:
        """Return a function that gives the weighted residual (R,) of the best fit of the terms with each variant.

        The columns of the terms are projected out once; each variant then takes a small solve.
        """
        shared, w = self.columns_of_each(terms), self.weights(terms)
        near, frame = self.tangent(terms), self._frame(terms)
        scale, target = w * near.scale, w * near.error
        inverse = np.linalg.pinv(frame.T @ (w[:, None] * near.slopes))

        def clear(columns: Array, here: slice) -> Array:
            cleared = -frame @ (frame[here].T @ columns)
            cleared[here] += columns
            return np.asarray(cleared)

        remaining = clear(target, slice(None))
        with_variant = cache(lambda at: self.with_variant(terms, self.data.locate_rows(at)))

        def exact(balance: Balance) -> Array:
            return balance.weights * balance.error(balance.solve())

        def residual(variant: Term, own: Columns) -> Array:
            if is_known(*terms, variant) or not variant.columns:
                return exact(self.assemble((*terms, variant), [*shared, own], w))
            here = self.data.locate_rows(variant.at)
            columns = scale[here, None] * own.linear
            extra = clear(columns, here)
            size = np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
            extra = extra / size
            theta = np.linalg.solve(extra.T @ extra + 1e-12 * np.eye(len(size)), extra.T @ remaining) / size
            others = near.theta + inverse @ (frame.T @ target - frame[here].T @ (columns @ theta))
            (least, most), whole = list_bounds((*terms, variant)), np.append(others, theta)
            if np.any((whole < least) | (whole > most)):
                return exact(self.assemble((*terms, variant), [*shared, own], w))
            return np.asarray(remaining - (extra * size) @ theta)

        def residuals(variants: Terms) -> list[Array]:
            pairs = list(zip(variants, self.make_columns(variants), strict=True))
            if not is_torque_dependent(variants[0]):
                return [residual(*pair) for pair in pairs]
            return [exact(with_variant(variants[0].at)(*pair)) for pair in pairs]

        return residuals


def _at_prediction(part: Columns, near: Tangent, here: slice) -> Columns:
    """Return the columns of a term under the torque that other terms predict, in the place of the recorded torque."""
    return part._replace(linear=part.linear - near.error[here, None] * part.slope)


def _refit_exactly(
    pairs: Sequence[tuple[Term, Columns]], estimates: Sequence[Array], exact: Callable[[Term, Columns], float]
) -> Array:
    """Return squared errors (V,) of variants that depend on the torque, exact for the best of them.

    The best are those of the fit with the recorded torque, and of the fit with the predicted torque.
    """
    tried = np.unique([np.argsort(estimate)[: VARIANTS.exact] for estimate in estimates])
    squares = np.array([exact(*pairs[k]) for k in tried.tolist()])
    found = np.maximum(estimates[0], squares.min())
    found[tried] = squares
    return found
