"""Rows of the positions of servos, linearised at the fit of each set of terms to whole rollouts.

Near the likeliest parameters of a model its simulated positions are almost linear in them. Rows y = phi theta have
positions in y and their derivatives in phi.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Errors
from estimators.decisions.score import FOLDS
from estimators.memoize import memoized
from estimators.regression.balance import Balance, Columns
from estimators.regression.fold_fits import solve_without
from estimators.search_hints import find_hints
from estimators.weak_form.columns import list_bounds
from estimators.weak_form.nonlinear import list_nonlinear_names
from estimators.weak_form.point import Point
from estimators.weak_form.rows import FoldFits, RowLayout, ScoredTerms, Terms
from estimators.weak_form.torque_rows import TorqueRows
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from robots.servos.in_loop.likelihood import compute_likelihood_scale
from robots.servos.in_loop.linearisation import TypicalSizes, linearise_errors
from robots.servos.in_loop.rollout_fits import RolloutFits
from robots.servos.in_loop.rollouts import Rollouts


@dataclass(eq=False)
class RolloutRows:
    """Rows of the positions of rollouts, the `RowMaker` of servos.

    Attributes:
        rollouts: simulations of the recordings.
        torque: rows of the torque of the same recordings, for typical sizes and starts of parameters.
        guide: fitted rows, for held-out rows; their parameters predict these rows. None if these rows are fitted.
        criterion: thresholds of the search.
        known: model whose parameters are a start of the first fit.
    """

    rollouts: Rollouts
    torque: TorqueRows
    guide: RolloutRows | None = None
    criterion: Criterion = field(default_factory=Criterion)
    known: Model | None = None

    @property
    @memoized
    def fits(self) -> RolloutFits:
        """Fits of the rollouts."""
        if self.guide is None:
            return RolloutFits(self.rollouts, TypicalSizes(self.torque), known=self.known)
        return RolloutFits(self.rollouts, self.guide.fits.sizes, self.guide.fits)

    @property
    @memoized
    def layout(self) -> RowLayout:
        """Blocks and noise of the rows, of one joint without a name."""
        positions, noise = self.rollouts.positions, self.rollouts.noise
        return RowLayout(
            joints={"": slice(None)},
            clusters=positions.clusters,
            precision={"": noise.precision},
            blocks=positions.blocks,
            block=self.criterion.block,
            noise=lambda at, inertia: noise.floor,
            structure=lambda at, residual, inertia: positions.measure_structure(residual),
            errors=partial(Errors(np.nan, np.nan).with_motion_errors, measured=positions.measured),
            predicts_torque=False,
            has_fast_fits=False,
            least_scale=noise.resolution,  # a joint at rest has no error, in the log and in its simulation
        )

    @property
    @memoized
    def fine(self) -> RolloutRows:
        """The rows of whole recordings with shorter steps of the integrator, without fits."""
        return replace(self, rollouts=self.rollouts.fine, guide=self.guide and self.guide.fine)

    def fit(self, terms: Terms, exactly: bool = False) -> Point:
        """Fit some terms, to convergence if `exactly`; return the fitted terms and parameters."""
        return self.fits.fit(terms, exactly)

    def fit_folds(self, terms: Terms) -> FoldFits:
        """Fit some terms without each fold, to first order around their fit."""
        terms, theta = self.fit(terms)
        return FoldFits(terms, theta, solve_without(self.equations(terms), self.layout.scored.fold, FOLDS))

    def search_basins(self, terms: Terms, variants: Terms) -> ScoredTerms:
        """Fit the terms with each variant of one effect, or with a link from many starts; return the best fit."""
        if find_hints(type(variants[0])).profiled:
            return self.score_terms(self.fits.fit_link(terms, variants, self.criterion.coarse_share))
        return min((self.score_terms((*terms, variant)) for variant in variants), key=lambda trial: trial.fitted_rms)

    def equations(self, terms: Terms, by_noise: bool = False) -> Balance:
        """Return the rows around the fit of some terms, weighted by the size of each error.

        Held-out rows `by_noise` have no slopes: they are predicted by the same fit, and simulated once.
        """
        if by_noise and self.guide is not None:
            point, error = self.fits.predict(terms)
            phi = np.zeros((len(error), len(point.theta)))
            target = -error - self.rollouts.noise_of_counts
            return Balance(phi, target, phi, *list_bounds(terms), np.ones(len(error)))
        near = self.fits.linearise(terms)
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
        return ScoredTerms(tuple(terms), self.fits.compute_scale(terms))

    def refine(self, trial: ScoredTerms, id: str) -> ScoredTerms:
        """Fit all continuous nonlinear parameters of a trial from their values."""
        return self.score_terms(self.fits.fit_nonlinear(trial.terms))

    def compare(self, terms: Terms, variants: Terms) -> list[float]:
        """Return the scale of the errors with each variant of one effect, extrapolated from the fit of the terms [rad].

        Later fits of the terms and a variant begin at its linear fit.
        """
        linear, terms = self.fits.linearise(terms), tuple(terms)
        key = terms, variants[0].id
        slopes = linear.slopes[:, : len(linear.point.theta)]
        others = slice(None), Columns(slopes, np.zeros(len(slopes)), np.zeros_like(slopes))
        scales = []
        for variant, columns in zip(variants, self._compute_columns(variants, linear.point), strict=True):
            start = np.append(linear.point.theta, np.zeros(len(variant.columns)))
            least, most = (end - start for end in list_bounds((*linear.point.terms, variant)))
            balance = Balance.from_target(-linear.error, linear.weights).with_columns(
                [others, (slice(None), columns)], least, most
            )
            step = balance.solve()
            theta = start + step
            self.fits.set_start(Point.from_parameters((*linear.point.terms, variant), theta), (*terms, variant))
            scales.append(compute_likelihood_scale(self.rollouts, -balance.error(step)))
        self.fits.extrapolated[key] = min([*scales, self.fits.extrapolated.get(key, np.inf)])
        return scales

    def columns(self, variants: Terms) -> list[Columns]:
        """Return the change of positions by each variant of one effect, added to the first model that was fitted."""
        return self._compute_columns(variants, self.fits.first_point)

    def _compute_columns(self, variants: Terms, point: Point) -> list[Columns]:
        """Return the change of positions by each variant of one effect, added to some terms and parameters.

        A variant with a fixed law, or a link before the encoder, moves the positions even if its parameters are zero.
        """
        others, values = tuple(term for term in point.terms if term.id != variants[0].id), point.linear_values
        point = Point(others, np.array([values[column.name] for term in others for column in term.columns]))
        points, places = [], []
        for variant in variants:
            size, at_zero = self.fits.sizes.compute_sizes(variant), 0  # column of the model without the effect
            if variant.fixed or (variant.link and self.rollouts.servos.at_output):
                points.append(Point((*point.terms, variant), np.r_[point.theta, np.zeros(len(size))]))
                at_zero = len(points)
            first = len(points) + 1
            points += [Point((*point.terms, variant), np.r_[point.theta, shift]) for shift in np.diag(size)]
            places.append((size, at_zero, slice(first, len(points) + 1)))
        without, columns = self._simulate_without(point.terms, tuple(point.theta.tolist())), []
        errors = np.column_stack([without, self.rollouts.without_counts.compute_position_errors(points)])
        changes = errors - errors[:, :1]
        for size, at_zero, place in places:
            slopes = (changes[:, place] - changes[:, at_zero, None]) / size
            columns.append(Columns(slopes, changes[:, at_zero], np.zeros_like(slopes)))
        return columns

    @memoized
    def _simulate_without(self, terms: Terms, theta: tuple[float, ...]) -> Array:
        """Return the errors without an effect (R, 1) [rad], the same for all effects, and without counts."""
        return self.rollouts.without_counts.compute_position_errors([Point(tuple(terms), np.array(theta))])

    def nonlinear_jacobian(self, terms: Terms, theta: Array) -> tuple[Array, list[str]]:
        """Return derivatives (R, S) of the positions by continuous nonlinear parameters, and the names of these."""
        names = list_nonlinear_names(terms)
        if not names:
            return np.empty((len(self.rollouts.positions.measured), 0)), names
        point, typical = self.fits.linearise(terms).point, self.fits.sizes.list_sizes(terms)
        slopes = linearise_errors(self.rollouts, point, typical, nonlinear=True).slopes
        return slopes[:, -len(names) :], names
