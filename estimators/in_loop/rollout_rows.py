"""Rows of the positions of servos, linearised at the fit of each set of terms to whole rollouts.

Near the likeliest parameters of a model its simulated positions are almost linear in them. Rows y = phi theta have
positions in y and their derivatives in phi.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.rows import FoldFits, RowLayout, ScoredTerms, Terms
from estimators.decisions.errors import Errors
from estimators.decisions.score import BLOCK, FOLDS
from estimators.in_loop.fit import (
    LOOP,
    LinearErrors,
    choose_likeliest_point,
    compute_likelihood_scale,
    compute_log_likelihood,
    fit_rollouts,
    linearise_errors,
    list_link_starts,
)
from estimators.in_loop.profile import LikelihoodProfile, scan_profile
from estimators.in_loop.rollouts import FINE, Rollouts
from estimators.memoize import memoized
from estimators.regression.balance import Balance, Columns
from estimators.regression.fold_fits import solve_without
from estimators.search_hints import find_hints
from estimators.simulation.multiple_shooting import add_link_friction
from estimators.weak_form.columns import list_bounds
from estimators.weak_form.nonlinear import list_nonlinear_names
from estimators.weak_form.point import Point
from estimators.weak_form.torque_rows import TorqueRows
from pendulum_env._typing import Array
from pendulum_env.physics import Term, find_link, has_link

Key = tuple[Term, ...]


@dataclass(eq=False)
class RolloutRows:
    """Rows of the positions of rollouts; fits are memoised.

    Attributes:
        rollouts: simulations of the recordings.
        torque: rows of the torque of the same recordings, for typical sizes and starts of parameters.
        guide: fitted rows, for held-out rows; their parameters predict these rows. None if these rows are fitted.
    """

    rollouts: Rollouts
    torque: TorqueRows
    guide: RolloutRows | None = None
    _linear: dict[Key, LinearErrors] = field(default_factory=dict, init=False)
    _starts: dict[Key, Point] = field(default_factory=dict, init=False)  # parameters of linear fits
    _least_errors: dict[tuple[Key, str], float] = field(default_factory=dict, init=False)  # extrapolated [rad]
    _converged: set[Key] = field(default_factory=set, init=False)

    @property
    @memoized
    def layout(self) -> RowLayout:
        """Blocks and noise of the rows, of one joint without a name."""
        return RowLayout(
            joints={"": slice(None)},
            clusters=self.rollouts.clusters,
            precision={"": self.rollouts.precision},
            blocks=self.rollouts.blocks,
            block=BLOCK,
            noise=lambda at, inertia: self.rollouts.noise,
            structure=lambda at, residual, inertia: self.rollouts.measure_structure(residual),
            errors=Errors(np.nan, np.nan).with_loop_errors,
            predicts_torque=False,
            has_fast_fits=False,
        )

    @property
    @memoized
    def data(self) -> RegressionData:
        """Data of the regression with these rows."""
        return RegressionData(self.torque.data, rollouts=self)

    @property
    @memoized
    def fine(self) -> RolloutRows:
        """The rows with shorter steps of the integrator, without fits."""
        return replace(self, rollouts=replace(self.rollouts, steps=FINE), guide=self.guide and self.guide.fine)

    def linearise_at_fit(self, terms: Terms) -> LinearErrors:
        """Return the errors around the fit of the terms, memoised.

        Held-out rows are linearised at the fit of their guide.
        """
        key = tuple(terms)
        if key not in self._linear:
            if self.guide is not None:
                self._linear[key] = linearise_errors(
                    self.rollouts, self.guide.linearise_at_fit(key).point, self.list_typical_sizes(key), False
                )
            else:
                share = 1.0 if self._is_hopeless(key) else LOOP.roughly
                self._store_fit(
                    key, fit_rollouts(self.rollouts, self._choose_start(key), self.list_typical_sizes(key), share=share)
                )
        return self._linear[key]

    def _is_hopeless(self, terms: Key) -> bool:
        """Return whether the linear fit of the last term gains too little, so one iteration suffices."""
        others, last = terms[:-1], terms[-1]
        if others not in self._linear or (others, last.id) not in self._least_errors:
            return False
        best = self._least_errors[others, last.id]
        gain = len(self.rollouts.position) * np.log(
            compute_likelihood_scale(self.rollouts, self.linearise_at_fit(others).error) / best
        )
        return bool(gain < LOOP.hopeless)

    def _store_fit(self, terms: Key, linear: LinearErrors) -> None:
        """Store a fit under `terms`, and under its fitted terms: their bounds may depend on linear parameters."""
        self._linear[terms] = self._linear[linear.point.terms] = linear

    def set_start(self, point: Point, terms: Key | None = None) -> None:
        """Set the start of the fit of some terms, by default those of the point."""
        self._starts[terms or point.terms] = point

    def fit(self, terms: Terms, exactly: bool = False) -> Point:
        """Fit some terms, to convergence if `exactly`; return the fitted terms and parameters."""
        key = tuple(terms)
        if exactly and self.guide is None and key not in self._converged:
            self._store_fit(
                key,
                fit_rollouts(self.rollouts, self.linearise_at_fit(key).point, self.list_typical_sizes(key), share=0.0),
            )
            self._converged |= {key, self.linearise_at_fit(key).point.terms}
        return self.linearise_at_fit(key).point

    def fit_folds(self, terms: Terms) -> FoldFits:
        """Fit some terms without each fold, to first order around their fit."""
        terms, theta = self.fit(terms)
        return FoldFits(terms, theta, solve_without(self.equations(terms), self.layout.scored.fold, FOLDS))

    def with_nonlinear(self, terms: Terms) -> Key:
        """Return the terms with all continuous nonlinear parameters fitted from their values."""
        point = self.linearise_at_fit(terms).point
        if len(point.values) == len(point.theta):
            return point.terms
        linear = fit_rollouts(self.rollouts, point, self.list_typical_sizes(terms), nonlinear=True)
        self._store_fit(linear.point.terms, linear)
        return linear.point.terms

    def fit_by_profile(self, terms: Terms) -> LikelihoodProfile | None:
        """Refit some terms by the profile of a parameter with many local minima; None if no term has one."""
        typical = self.list_typical_sizes(terms)
        profile = scan_profile(self.rollouts, self.linearise_at_fit(terms).point, typical)
        if profile is not None:
            self._store_fit(profile.point.terms, linearise_errors(self.rollouts, profile.point, typical, True))
            self._converged.add(profile.point.terms)
        return profile

    def search_basins(self, terms: Terms, variants: Terms) -> ScoredTerms:
        """Fit the terms with a link from several variants and shares of the inertia, and return the best fit.

        The weight is at the link. The likeliest variant at each value of the parameter with many local minima is fitted
        with longer secants and without counts, and the best of these fits to convergence. If the likeliest start
        explains less than the share `LOOP.promising`, no other start is tried.
        """
        point, name = self.linearise_at_fit(terms).point, find_hints(type(variants[0])).profiled
        if not name:
            return min(
                (self.score_terms((*terms, variant)) for variant in variants), key=lambda trial: trial.fitted_rms
            )
        points_list = list_link_starts(point, variants)
        typical = self.list_typical_sizes(points_list[0].terms)
        smooth = self.rollouts.without_counts
        likelihood = compute_log_likelihood(smooth, smooth.compute_position_errors(points_list))
        starts: dict[float, Point] = {}  # the likeliest at each value, the likeliest of all first
        for k in np.argsort(-likelihood):
            starts.setdefault(points_list[k].terms[-1].nonlinear_values[name], points_list[k])

        def fit_roughly(start: Point) -> list[LinearErrors]:
            begun = [add_link_friction(start, share) for share in LOOP.link_friction]
            return [fit_rollouts(smooth, start, typical, nonlinear=True, secants=LOOP.secants[:1]) for start in begun]

        first, *others = [*starts.values()][: LOOP.starts]
        rough = fit_roughly(first)
        before, *after = (
            compute_likelihood_scale(smooth, error)
            for error in (smooth.compute_position_errors([point])[:, 0], *(fit.error for fit in rough))
        )
        is_promising = min(after) ** 2 < (1.0 - LOOP.promising) * before**2
        if is_promising:
            rough += [fit for start in others for fit in fit_roughly(start)]
        rough.sort(key=lambda fit: compute_likelihood_scale(smooth, fit.error))
        fits = (
            [
                fit_rollouts(self.rollouts, fit.point, typical, nonlinear=True, share=0.0)
                for fit in rough[: LOOP.finalists]
            ]
            if is_promising
            else [linearise_errors(self.rollouts, rough[0].point, typical, nonlinear=True)]
        )
        best = min(fits, key=lambda fit: compute_likelihood_scale(self.rollouts, fit.error))
        self._store_fit(best.point.terms, best)
        return self.score_terms(best.point.terms)

    def list_typical_sizes(self, terms: Terms) -> Array:
        """Return the size of each linear parameter that matters (P,), see `LOOP.typical`."""
        return np.concatenate([np.empty(0), *(self._compute_typical_sizes(term) for term in terms)])

    @memoized
    def _compute_typical_sizes(self, term: Term) -> Array:
        """Return the size of each linear parameter of a term that matters (P,), by the recorded torque.

        Its torque is the share `LOOP.typical` of the RMS torque.
        """
        if self.guide is not None:
            return self.guide._compute_typical_sizes(term)
        rms = np.sqrt(np.mean(self.torque.data.torque.recorded**2))
        column_rms = np.sqrt(np.mean(self.torque.data.columns([term])[0][0] ** 2, axis=0))
        columns = self.torque.data.window_columns
        (x,) = columns.trace([term])  # windows omit slow motion, in which friction may be largest
        peaks = [np.max(np.abs(column.force(x) + column.dry(x) * np.sign(x.velocity))) for column in term.columns]
        return np.asarray(LOOP.typical * rms / np.maximum(np.maximum(column_rms, peaks), 1e-9))

    def _choose_start(self, terms: Key) -> Point:
        """Return the likeliest start of a fit, from the most similar fitted model or from a linear fit.

        Parameters that the similar model lacks are 0, or their typical size times 1 or 3. A link also starts from the
        likeliest model with another link, with the same inertia.
        """
        ids = {term.id for term in terms}
        parents = sorted(
            self._linear, key=lambda other: (len(ids ^ {term.id for term in other}), -len(set(other) & set(terms)))
        )
        if not parents:  # parameters fitted to the torque, with several minimum sizes
            theta, typical = self.torque.fits.solve(terms), self.list_typical_sizes(terms)
            sizes = [theta, *(np.maximum(np.abs(theta), share * typical) for share in (1.0, 5.0))]
            first_starts = [Point.from_parameters(terms, values) for values in sizes]
            return self._starts.get(terms) or choose_likeliest_point(self.rollouts, first_starts)[0]
        parent = self._linear[parents[0]].point
        values = parent.linear_values
        names = [column.name for term in terms for column in term.columns]
        sizes = list(zip(names, self.list_typical_sizes(terms), strict=True))
        starts = [
            Point.from_parameters(terms, np.array([values.get(name, share * size) for name, size in sizes]))
            for share in (0.0, 1.0, 3.0)
        ]
        if all(name in values for name in names):
            del starts[1:]
        starts += self._start_from_other_link(terms)
        if terms in self._starts:
            starts.append(self._starts[terms])
        return starts[0] if len(starts) == 1 else choose_likeliest_point(self.rollouts, starts)[0]

    def _start_from_other_link(self, terms: Key) -> list[Point]:
        """Return starts from the likeliest fit with another link and otherwise the same columns, if any."""
        if not has_link(terms):
            return []
        link_id, names = find_link(terms).id, _list_columns_without_link(terms)
        similar = [
            linear
            for key, linear in self._linear.items()
            if has_link(key) and find_link(key).id != link_id and _list_columns_without_link(key) == names
        ]
        if not similar:
            return []
        likeliest = min(similar, key=lambda linear: compute_likelihood_scale(self.rollouts, linear.error))
        return [Point.from_parameters(terms, likeliest.point.theta)]

    def equations(self, terms: Terms, by_noise: bool = False) -> Balance:
        """Return the rows around the fit of some terms, weighted by the size of each error; `by_noise` is not used."""
        near = self.linearise_at_fit(terms)
        theta = near.point.theta
        phi = near.slopes[:, : len(theta)]
        target = phi @ theta - near.error - self.rollouts.noise_of_counts
        return Balance(phi, target, np.zeros_like(phi), *list_bounds(terms), near.weights)

    def make_frame(self, terms: Terms) -> Array:
        """Return an orthonormal basis (R, P) of the weighted columns of some terms, linearised at their fit."""
        balance = self.equations(terms)
        return np.linalg.qr(balance.phi * balance.weights[:, None])[0]

    def residual(self, terms: Terms, theta: Array) -> Array:
        """Return the measured minus the simulated positions (R,) [rad]."""
        error = self.rollouts.compute_position_errors([Point(tuple(terms), theta)])[:, 0]
        return -error - self.rollouts.noise_of_counts

    def score_terms(self, terms: Terms) -> ScoredTerms:
        """Fit one set of terms, and score it by the scale of its errors [rad]."""
        return ScoredTerms(tuple(terms), compute_likelihood_scale(self.rollouts, self.linearise_at_fit(terms).error))

    def refine(self, trial: ScoredTerms, id: str) -> ScoredTerms:
        """Fit all continuous nonlinear parameters of a trial from their values."""
        return self.score_terms(self.with_nonlinear(trial.terms))

    def compare(self, terms: Terms, variants: Terms) -> list[float]:
        """Return the scale of the errors with each variant of one effect, extrapolated from the fit of the terms [rad].

        Later fits of the terms and a variant begin at its linear fit.
        """
        linear, terms = self.linearise_at_fit(terms), tuple(terms)
        key = terms, variants[0].id
        slopes = linear.slopes[:, : len(linear.point.theta)]
        others = slice(None), Columns(slopes, np.zeros(len(slopes)), np.zeros_like(slopes))
        scales = []
        for variant, columns in zip(variants, self._columns(variants, linear.point), strict=True):
            start = np.append(linear.point.theta, np.zeros(len(variant.columns)))
            least, most = (end - start for end in list_bounds((*linear.point.terms, variant)))
            balance = Balance.from_target(-linear.error, linear.weights).with_columns(
                [others, (slice(None), columns)], least, most
            )
            step = balance.solve()
            theta = start + step
            self.set_start(Point.from_parameters((*linear.point.terms, variant), theta), (*terms, variant))
            scales.append(compute_likelihood_scale(self.rollouts, -balance.error(step)))
        self._least_errors[key] = min([*scales, self._least_errors.get(key, np.inf)])
        return scales

    def columns(self, variants: Terms) -> list[Columns]:
        """Return the change of positions by each variant of one effect, added to the first model that was fitted."""
        return self._columns(variants, next(iter(self._linear.values())).point)

    def _columns(self, variants: Terms, point: Point) -> list[Columns]:
        """Return the change of positions by each variant of one effect, added to some terms and parameters.

        A variant with a fixed law, or a link before the encoder, moves the positions even if its parameters are zero.
        """
        others, values = tuple(term for term in point.terms if term.id != variants[0].id), point.linear_values
        point = Point(others, np.array([values[column.name] for term in others for column in term.columns]))
        points, places = [], []
        for variant in variants:
            size, at_zero = self._compute_typical_sizes(variant), 0  # column of the model without the effect
            if variant.fixed or (variant.link and self.rollouts.servos.at_output):
                points.append(Point((*point.terms, variant), np.r_[point.theta, np.zeros(len(size))]))
                at_zero = len(points)
            first = len(points) + 1
            points += [Point((*point.terms, variant), np.r_[point.theta, shift]) for shift in np.diag(size)]
            places.append((size, at_zero, slice(first, len(points) + 1)))
        smooth, columns = self.rollouts.without_counts, []
        errors = np.column_stack([smooth.compute_position_errors([point]), smooth.compute_position_errors(points)])
        changes = errors - errors[:, :1]
        for size, at_zero, place in places:
            slopes = (changes[:, place] - changes[:, at_zero, None]) / size
            columns.append(Columns(slopes, changes[:, at_zero], np.zeros_like(slopes)))
        return columns

    def nonlinear_jacobian(self, terms: Terms, theta: Array) -> tuple[Array, list[str]]:
        """Return derivatives (R, S) of the positions by continuous nonlinear parameters, and the names of these."""
        names = list_nonlinear_names(terms)
        if not names:
            return np.empty((len(self.rollouts.position), 0)), names
        slopes = linearise_errors(
            self.rollouts, self.linearise_at_fit(terms).point, self.list_typical_sizes(terms), True
        ).slopes
        return slopes[:, -len(names) :], names


def _list_columns_without_link(terms: Key) -> list[list[str]]:
    """List the names of the linear parameters of each term, without those of a link, so all links compare equal."""
    return [[] if term.link else [column.name for column in term.columns] for term in terms]
