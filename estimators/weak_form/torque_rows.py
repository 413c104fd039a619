"""Rows of the torque balance, averaged over windows: fits of sets of terms, also with variants of one effect.

Recordings are weighted by their residual, so an unexplained recording does not bias the others. Many variants of an
effect are fitted by one batch of small solves of Gram matrices. Results are memoised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np

from estimators.decisions.score import FOLDS
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
from estimators.weak_form.columns import has_known_parameter, is_torque_dependent, list_bounds
from estimators.weak_form.floors import (
    compute_absorbed_noise,
    compute_noise_floor,
    compute_numerical_error,
    compute_precision,
    measure_structure,
)
from estimators.weak_form.nonlinear import (
    ResidualFunction,
    compute_nonlinear_slopes,
    find_edges,
    list_continuous_parameters,
    refine_nonlinear,
    scan_edges,
    search_by_cross_entropy,
)
from estimators.weak_form.point import Point
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.rows import FoldFits, RowLayout, ScoredTerms, Terms
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import Array
from pendulum_env.physics import SIGNIFICANT, Term

VARIANTS = RESOLUTION.variants


@dataclass(eq=False)
class TorqueRows:
    """Rows of the torque of the windows `data`; a `RowMaker`."""

    data: TorqueWindows
    _columns: dict[Term, Columns] = field(default_factory=dict, init=False)
    _recent: dict[tuple[Term, ...], Balance] = field(default_factory=dict, init=False)

    @cached_property
    def layout(self) -> RowLayout:
        """Joints, blocks and noise of the rows."""
        data = self.data
        precision = {at: compute_precision(data.part(at).windows) for at in data.joints}
        return RowLayout(
            joints={at: data.locate_rows(at) for at in data.joints},
            clusters=data.clusters,
            precision=precision,
            blocks=data.blocks,
            noise=lambda at, inertia: compute_noise_floor(data.part(at).windows, inertia),
            structure=lambda at, residual, inertia: measure_structure(
                data.part(at).windows, residual, inertia, data.block
            ),
        )

    @cached_property
    def _torque(self) -> Array:
        """Left-hand side of all rows (R,) [N m]."""
        return self.data.torque.net

    @memoized
    def _make_joint_rows(self, joint: str) -> TorqueRows:
        """Return the rows of one of several joints."""
        return TorqueRows(self.data.part(joint))

    def select_joint(self, joint: str) -> TorqueRows:
        """Return the rows of a joint; all rows for a term at several joints."""
        return self if self.data.part(joint) is self.data else self._make_joint_rows(joint)

    def columns(self, variants: Terms) -> list[Columns]:
        """Return the windowed columns of each variant of one effect, on the rows of its joint."""
        if (of_joint := self.select_joint(variants[0].at)) is not self:
            return of_joint.columns(variants)
        missing = [variant for variant in variants if variant not in self._columns]
        if missing:
            self._columns.update(zip(missing, self.make_columns(missing), strict=True))
        return [self._columns[variant] for variant in variants]

    def make_columns(self, variants: Terms) -> list[Columns]:
        """Return the windowed columns of each variant of one effect, on the rows of its joint; not memoised."""
        if (of_joint := self.select_joint(variants[0].at)) is not self:
            return of_joint.make_columns(variants)
        columns, effect, torque = self.data.columns(variants), variants[0], self.data.torque.recorded
        if not is_torque_dependent(effect):
            return [Columns(linear, fixed, np.zeros_like(linear)) for linear, fixed in columns]
        step = VARIANTS.perturbation * self._largest_torque * self.data.scale
        pairs = zip(columns, self._perturbed_windows.columns(variants), strict=True)
        parts = [
            Columns(linear, fixed, (moved_linear - linear) / step[:, None], (moved_fixed - fixed) / step)
            for (linear, fixed), (moved_linear, moved_fixed) in pairs
        ]
        if not (effect.fixed and effect.has_state()):
            return parts
        torque_norm = float(np.linalg.norm(torque))
        norms = [float(np.linalg.norm(torque - part.fixed)) for part in parts]
        return [
            part if variant.delay or norm >= torque_norm else part._replace(torque_share=max(norm / torque_norm, 1e-12))
            for variant, part, norm in zip(variants, parts, norms, strict=True)
        ]

    def _add_fixed_change(self, term: Term, part: Columns) -> Columns:
        """Return the columns of a term with `fixed_change`, if its fixed columns depend on the present torque."""
        if (rows := self.select_joint(term.at)) is not self:
            return rows._add_fixed_change(term, part)
        if not term.fixed or term.has_state():
            return part
        fixed = self.data.window_columns.averages.perturb_fixed_columns(term, self._perturbations)
        fixed = np.nan_to_num(fixed, nan=0.0, posinf=0.0, neginf=0.0)
        slopes = 1.0 - np.diff(fixed, axis=1) / np.diff(self.perturbations, axis=1)
        torque = self.data.torque.recorded
        torque_share = float(np.linalg.norm(torque - part.fixed)) / max(float(np.linalg.norm(torque)), 1e-300)
        return part._replace(fixed_change=self.perturbations - self._compute_response(slopes, min(torque_share, 1.0)))

    def _compute_response(self, slopes: Array, torque_share: float) -> Array:
        """Return the responses (R, J) [N m] of equations to perturbations, from the slopes s between these (R, J - 1).

        A residual r is an error of the recorded torque u or of the motion. The motion has a share c of the variance of
        noise. Its torque is smaller by `torque_share` k, the ratio of the norms of remaining and recorded torque. The
        likeliest errors equal an error r / sqrt((1 - c) s^2 + c k^2) of u, which is finite beyond a saturation. A law
        that scales all torques down does not reduce this error.
        """
        share = self._motion_share[:, None]
        steps = np.sqrt((1.0 - share) * slopes**2 + share * torque_share**2) * np.diff(self.perturbations, axis=1)
        response = np.cumsum(np.column_stack([np.zeros(len(steps)), steps]), axis=1)
        return response - response[:, [len(VARIANTS.perturbations)]]

    @cached_property
    def _motion_share(self) -> Array:
        """Share of the motion in the variance of each equation's noise (R,); 0 for an arm or insignificant inertia."""
        data = self.data
        if any(w.at or w.recording.known_inertia for w in data.windows):
            return np.zeros(len(data.weights))
        inertia = max(float(data.base_fit.theta[0] - SIGNIFICANT * data.base_fit.std[0]), 0.0)
        if inertia == 0.0:
            return np.zeros(len(data.weights))
        of_torque = np.array([w.noise.torque for w in data.windows])
        precision = compute_precision(data.windows)
        of_both = np.array([np.hypot(w.noise.compute_std(inertia), precision) for w in data.windows])
        return np.maximum(0.0, 1.0 - (of_torque / np.maximum(of_both, 1e-300)) ** 2)[data.recording_of_window]

    @property
    def _largest_torque(self) -> float:
        """Largest absolute windowed torque [N m], above zero."""
        return max(float(np.abs(self.data.torque.recorded).max()), 1e-12)

    @cached_property
    def _perturbed_windows(self) -> TorqueWindows:
        """Windows with a small offset of the torque, for derivatives."""
        return self.data.with_torque(offset=VARIANTS.perturbation * self._largest_torque)

    @property
    def _perturbations(self) -> Array:
        """Increasing perturbations of the torque (J,) [N m], zero in the middle, for nonlinear laws."""
        steps = np.array(VARIANTS.perturbations)
        return self._largest_torque * np.concatenate([-steps[::-1], [0.0], steps])

    @cached_property
    def perturbations(self) -> Array:
        """Perturbations of the torque in each row of all joints (R, J) [N m], times the scale of the row."""
        joints = [self.select_joint(at) for at in self.data.joints]
        return np.concatenate([np.outer(rows.data.scale, rows._perturbations) for rows in joints])

    @memoized
    def _rates(self, term: Term) -> Array:
        """Return time derivatives of the linear columns of a term (R, P), on the rows of its joint."""
        return self.data.rates(term)

    def equations(self, terms: Terms, by_noise: bool = False) -> Balance:
        """Return the rows of some terms, weighted by residual and noise, or `by_noise` alone.

        The rows of the last `VARIANTS.cached` sets of terms are memoised.
        """
        key = tuple(terms)
        if key not in self._recent:
            if len(self._recent) >= VARIANTS.cached:
                self._recent.pop(next(iter(self._recent)))
            self._recent[key] = self.assemble(terms, self.list_term_columns(terms), self.data.weights)
        balance = self._recent[key]
        return balance if by_noise else replace(balance, weights=self.weights(terms))

    def list_term_columns(self, terms: Terms) -> list[Columns]:
        """Return the columns of each term, on the rows of its joint, with `fixed_change`."""
        return [self._make_whole_columns(term) for term in terms]

    @memoized
    def _make_whole_columns(self, term: Term) -> Columns:
        """Return the columns of a term with `fixed_change`."""
        return self._add_fixed_change(term, self.columns([term])[0])

    def assemble(self, terms: Terms, parts: Sequence[Columns], weights: Array) -> Balance:
        """Return the rows of some terms from the columns of each, `parts`, and weights (R,).

        With a term that filters torque (`lead`), `unfiltered` holds the rows without its fixed columns.
        """
        rows = [self.data.locate_rows(term.at) for term in terms]
        balance = Balance.from_target(self._torque, weights).with_columns(
            list(zip(rows, parts, strict=True)), *list_bounds(terms), self.perturbations
        )
        if not any(term.lead for term in terms):
            return balance
        unfiltered, lead = self._torque.copy(), np.zeros(len(weights))
        for place, term, part in zip(rows, terms, parts, strict=True):
            unfiltered[place] -= 0.0 if term.lead else part.fixed
            lead[place] += term.lead
        rates = place_columns(len(weights), list(zip(rows, map(self._rates, terms), strict=True)))
        y = unfiltered - lead * self.data.torque.load_rates
        return replace(
            balance, unfiltered=replace(balance, phi=balance.phi + lead[:, None] * rates, y=y, torque_share=1.0)
        )

    def with_variant(self, terms: Terms, here: slice) -> Callable[[Term, Columns], Balance]:
        """Make the function from a variant and its columns to the rows of the terms plus the variant.

        `here` are the rows of the variant's joint. Weights are those of `terms` alone. Rows of other joints are
        condensed to their tangent. Rows with a term that filters torque (`lead`) are assembled for each variant.
        """
        if not terms or any(term.lead for term in terms):
            shared, w = self.list_term_columns(terms), self.weights(terms)
            return lambda variant, columns: self.assemble(
                (*terms, variant), [*shared, self._add_fixed_change(variant, columns)], w
            )
        shared_rows, perturbations = self.equations(terms), self.perturbations
        elsewhere = np.ones(len(perturbations), dtype=bool)
        elsewhere[here] = False
        if elsewhere.any():
            tangent, of_joint = self.linearise(terms), perturbations[here]
            shared_rows = condense(shared_rows, elsewhere, tangent.slopes[elsewhere], tangent.target[elsewhere])
            largest = np.tile(perturbations.max(axis=0), (len(shared_rows.y) - len(of_joint), 1))
            here, perturbations = slice(0, len(of_joint)), np.concatenate([of_joint, largest])
        return lambda variant, columns: shared_rows.with_columns(
            [(here, self._add_fixed_change(variant, columns))], *list_bounds((*terms, variant)), perturbations
        )

    def weights(self, terms: Terms) -> Array:
        """Return the weight of each row (R,), smaller for entries with a larger residual of the terms."""
        return self._weigh_entries(terms)[self.data.recording_of_window]

    @memoized
    def _weigh_entries(self, terms: Terms) -> Array:
        """Return the weight of each entry (E,) by its residual under the terms; by noise without terms or of one entry.

        An entry is a recording, or one joint of a recording.
        """
        if len(self.data.windows) == 1 or not terms:
            return self._entry_weights
        if (linear_fit := self._fit_linearly(terms)) is not None:
            return linear_fit[1]
        balance, owner = self.equations(terms, by_noise=True), self.data.recording_of_window
        squares = np.bincount(owner, balance.error(self._solve_by_noise(terms)) ** 2).astype(float)
        return weigh_recordings(squares, np.bincount(owner), compute_numerical_error(self.data.windows))

    @memoized
    def _solve_by_noise(self, terms: Terms) -> Array:
        """Fit the linear parameters (P,) with the weights of noise.

        If terms before the last depend on the torque, the fit without the last term is the start.
        """
        *others, last = terms
        start = None
        if is_torque_dependent(*others):
            start = np.append(self._solve_by_noise(tuple(others)), np.zeros(len(last.columns)))
        return self.equations(terms, by_noise=True).solve(start)

    @memoized
    def solve(self, terms: Terms) -> Array:
        """Fit the linear parameters (P,) of the terms to all windows."""
        if (linear_fit := self._fit_linearly(terms)) is not None:
            return linear_fit[0].theta
        balance = self.equations(terms)
        return balance.solve(None if balance.is_linear or len(self.data.windows) == 1 else self._solve_by_noise(terms))

    @memoized
    def fit_folds(self, terms: Terms) -> FoldFits:
        """Fit some terms to all rows and without each fold; linearised around the fit without the last if accurate."""
        linearised = self._fit_linearly(terms) or self._fit_last_term(terms)
        if linearised is not None:
            return linearised[0]
        theta, balance = self.solve(terms), self.equations(terms)
        return FoldFits(tuple(terms), theta, balance.solve_without(self.layout.scored.fold, FOLDS, theta))

    @memoized
    def _fit_linearly(self, terms: Terms) -> tuple[FoldFits, Array] | None:
        """Return the fits of terms, and the weights of entries (E,); None if a term depends on the torque."""
        return None if is_torque_dependent(*terms) else self._fit_last_term(terms)

    def _fit_last_term(self, terms: Terms) -> tuple[FoldFits, Array] | None:
        """Fit the last of some terms with the others, to first order around the fit of these, by Gram matrices.

        Returns:
            The fits, and the weights of entries (E,); None if columns are nearly collinear, or if the first order is
            inaccurate.
        """
        *others, last = terms
        if not others or is_torque_dependent(last):
            return None

        def linearise(by_noise: bool) -> tuple[Array, Array, Array, Array]:
            """Return Gram matrices of the terms, parameters (P,) at a step of zero, and bounds of a step."""
            known, (part,), (least, most) = self._make_grams(others, by_noise), self.columns([last]), list_bounds(terms)
            start = np.append(known.near.theta, np.zeros(len(last.columns)))
            return known.with_term(part, self.data.locate_rows(last.at)), start, least - start, most - start

        weights, owner = self._entry_weights, self.data.recording_of_window
        if len(weights) > 1:
            grams, _, *bounds = linearise(True)
            if (step := solve_all_folds(grams, weights, *bounds)) is None:
                return None
            counts = np.bincount(owner, minlength=len(weights))
            weights = weigh_recordings(
                compute_entry_squares(grams, step), counts, compute_numerical_error(self.data.windows)
            )
        grams, start, *bounds = linearise(False)
        if (steps := solve_each_fold(grams, weights, *bounds)) is None:
            return None
        theta = np.clip(start + steps, *list_bounds(terms))  # sums may miss a bound by rounding
        fits = FoldFits(tuple(terms), theta[0], theta[1:])
        if is_torque_dependent(*others):
            square = float(weights**2 @ compute_entry_squares(grams, steps[0]))
            balance = replace(self.equations(terms, by_noise=True), weights=weights[owner])
            if not balance.fits_tangent(fits.theta, np.ones(len(owner), dtype=bool), square):
                return None
        return fits, weights

    @memoized
    def _make_grams(self, terms: Terms, by_noise: bool = False) -> FoldGrams:
        """Return the Gram matrices of the rows, linearised around the fit of the terms, or the fit `by_noise` alone."""
        if by_noise and not is_torque_dependent(*terms):
            return self._make_grams(terms)  # linear rows have the same matrices around any fit
        balance = self.equations(terms, by_noise=True)
        near = balance.linearise(self._solve_by_noise(terms)) if by_noise else self.linearise(terms)
        return FoldGrams.compute(
            near, self.data.recording_of_window, self.layout.scored.fold, len(self.data.windows), FOLDS
        )

    @cached_property
    def _entry_weights(self) -> Array:
        """Weight of each recording by its noise (E,), the mean over its rows."""
        owner = self.data.recording_of_window
        counts = np.bincount(owner, minlength=len(self.data.windows))
        return np.bincount(owner, self.data.weights, len(counts)) / np.maximum(counts, 1)

    def fit(self, terms: Terms, exactly: bool = False) -> Point:
        """Fit the linear parameters of some terms, to convergence also without `exactly`."""
        return Point(tuple(terms), self.solve(terms))

    def residual(self, terms: Terms, theta: Array) -> Array:
        """Return the measured minus the predicted torque (R,) at some parameters [N m]."""
        return self.equations(terms, by_noise=True).error(theta)

    @memoized
    def linearise(self, terms: Terms) -> Tangent:
        """Return the errors near the fit of the terms, to first order; around zero where they are linear."""
        balance = self.equations(terms, by_noise=True)
        return balance.linearise(None if balance.is_linear else self.solve(terms))

    @memoized
    def make_frame(self, terms: Terms) -> Array:
        """Return an orthonormal basis (R, P) of the weighted derivatives of the errors by the parameters."""
        return np.linalg.qr(self.linearise(terms).slopes * self.weights(terms)[:, None])[0]

    @memoized
    def _make_frame_of_unknown(self, terms: Terms) -> Array:
        """Return an orthonormal basis (R, F) of the weighted derivatives of the errors by the F unknown parameters."""
        least, most = list_bounds(terms)
        return np.linalg.qr(self.linearise(terms).slopes[:, least < most] * self.weights(terms)[:, None])[0]

    def compute_absorbed_noise(self, terms: Terms) -> list[tuple[slice, float]]:
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

            for name, slope in compute_nonlinear_slopes(term, torques).items():
                slopes[name] = slope_of_rows = np.zeros(len(self.data.weights))
                slope_of_rows[self.data.locate_rows(term.at)] = slope
        return np.column_stack([np.empty((len(self.data.weights), 0)), *slopes.values()]), list(slopes)

    def compare(self, terms: Terms, variants: Terms) -> list[float]:
        """Return the weighted RMS torque error [N m] of the fit of the terms plus each of V variants of one effect.

        Torque noise that terms remove is included. The best variants that depend on the torque are fitted exactly.
        """
        w, here = self.weights(terms), self.data.locate_rows(variants[0].at)
        parts = self.columns(variants)
        with_variant = cache(lambda: self.with_variant(terms, here))  # made only if a variant is fitted exactly

        def exact(variant: Term, columns: Columns) -> float:
            return with_variant()(variant, columns).compute_least_square()

        if not terms:
            squares = np.array([exact(*pair) for pair in zip(variants, parts, strict=True)])
        else:
            grams = self._make_grams(terms)
            start = np.append(grams.near.theta, np.zeros(len(variants[0].columns)))
            limits = [end - start for end in list_bounds((*terms, variants[0]))]

            def squared(parts: Sequence[Columns]) -> Array:
                return compute_squared_errors(grams.with_variants(parts, self._weigh_entries(terms), here), *limits)

            squares = squared(parts)
            if is_torque_dependent(variants[0]):
                predicted = squared([_move_to_prediction(part, grams.near, here) for part in parts])
                squares = _refit_exactly(list(zip(variants, parts, strict=True)), (squares, predicted), exact)
        absorbed = [self._weigh_absorbed_noise((*terms, variant), w) for variant in variants]
        return np.sqrt(squares / (w @ w) + absorbed).tolist()

    def _weigh_absorbed_noise(self, terms: Terms, w: Array) -> float:
        """Return the variance of torque noise that terms remove, mean over rows of weights (R,) [(N m)^2]."""
        absorbed = self.compute_absorbed_noise(terms)
        return sum(float(w[here] @ w[here]) * variance for here, variance in absorbed) / float(w @ w)

    def score_terms(self, terms: Terms) -> ScoredTerms:
        """Return a set of terms with the error of its fit, see `compare`."""
        *others, last = terms
        return ScoredTerms(tuple(terms), self.compare(others, [last])[0])

    def search_basins(self, terms: Terms, variants: Terms) -> ScoredTerms:
        """Return the best trial of the terms with a variant, by one search per value of its multimodal parameter."""
        residuals, name = self._make_residual_function(terms), find_hints(type(variants[0])).multimodal
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
            theta = self.solve((*others, term))
            values = dict(zip((c.name for other in others for c in other.columns), theta, strict=False))
            term = replace(term, **{s.name: float(values[s.follows]) for s in following if s.follows in values})
        residuals, samples = self._make_residual_function(others), self.data.part(term.at).samples
        gain = VARIANTS.gain if is_torque_dependent(term) else 0.0
        span, refined, edges = float(np.ptp(samples.time)), term, find_edges(term, samples)
        reach, longest = VARIANTS.reach * span, VARIANTS.longest * span
        for _ in range(1 + bool(edges and len(list_continuous_parameters(term)) > 1)):
            refined = refine_nonlinear(refined, residuals, edges, gain, longest)
            refined = scan_edges(refined, residuals, edges, reach)
        refined_trial = self.score_terms((*trial.terms[:index], refined, *trial.terms[index + 1 :]))
        is_worse = refined_trial.fitted_rms > trial.fitted_rms and not following
        return trial if is_worse or not is_possible(refined, samples) else refined_trial

    def _make_residual_function(self, terms: Terms) -> ResidualFunction:
        """Make the function from variants to the weighted residual (R,) of the fit of the terms plus each variant.

        The columns of the unknown parameters are projected out once, so each variant takes a small solve. A variant
        that leaves the bounds, has known parameters or depends on the torque is fitted exactly.
        """
        shared, w = self.list_term_columns(terms), self.weights(terms)
        tangent, frame, (least, most) = self.linearise(terms), self._make_frame_of_unknown(terms), list_bounds(terms)
        is_free = least < most
        start = np.where(is_free, tangent.theta, least)
        scale, target = w * tangent.scale, w * (tangent.error - tangent.slopes @ (start - tangent.theta))
        inverse = np.linalg.pinv(frame.T @ (w[:, None] * tangent.slopes[:, is_free]))

        def project_out(columns: Array, here: slice) -> Array:
            projected = -frame @ (frame[here].T @ columns)
            projected[here] += columns
            return np.asarray(projected)

        remaining = project_out(target, slice(None))
        with_variant = cache(lambda at: self.with_variant(terms, self.data.locate_rows(at)))

        def exact(balance: Balance) -> Array:
            return balance.weights * balance.error(balance.solve())

        def residual(variant: Term, variant_columns: Columns) -> Array:
            if has_known_parameter(variant) or not variant.columns:
                return exact(self.assemble((*terms, variant), [*shared, variant_columns], w))
            here = self.data.locate_rows(variant.at)
            columns = scale[here, None] * variant_columns.linear
            free = project_out(columns, here)
            size = np.maximum(np.linalg.norm(free, axis=0), 1e-300)
            free = free / size
            theta = np.linalg.solve(free.T @ free + 1e-12 * np.eye(len(size)), free.T @ remaining) / size
            others = start.copy()
            others[is_free] += inverse @ (frame.T @ target - frame[here].T @ (columns @ theta))
            (least, most), parameters = list_bounds((*terms, variant)), np.append(others, theta)
            if np.any((parameters < least) | (parameters > most)):
                return exact(self.assemble((*terms, variant), [*shared, variant_columns], w))
            return np.asarray(remaining - (free * size) @ theta)

        def residuals(variants: Terms) -> list[Array]:
            pairs = list(zip(variants, self.make_columns(variants), strict=True))
            if not is_torque_dependent(variants[0]):
                return [residual(*pair) for pair in pairs]
            return [exact(with_variant(variants[0].at)(*pair)) for pair in pairs]

        return residuals


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
