"""Fits of sets of terms to whole rollouts, each computed once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.memoize import memoized
from estimators.weak_form.columns import list_bounds
from estimators.weak_form.point import Point
from estimators.weak_form.rows import Terms
from pendulum_env._typing import Array
from pendulum_env.physics import Model, Term, find_link, has_link
from pendulum_env.physics.term import return_zero
from robots.servos.in_loop.fit import fit_rollouts
from robots.servos.in_loop.likelihood import choose_likeliest_point, compute_likelihood_scale
from robots.servos.in_loop.linearisation import LinearErrors, TypicalSizes, bind_terms, linearise_errors
from robots.servos.in_loop.link_fit import fit_link
from robots.servos.in_loop.profile import LikelihoodProfile, scan_profile
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.settings import LOOP

Key = tuple[Term, ...]


@dataclass(eq=False)
class RolloutFits:
    """Errors of rollouts around the fit of each set of terms.

    Attributes:
        rollouts: simulations of the recordings.
        sizes: typical sizes of linear parameters.
        guide: fits of other recordings, around whose parameters these errors are linearised; None if these recordings
            are fitted.
        known: model whose parameters are a start of the first fit; parameters that it lacks start at zero.
        extrapolated: least error scale of the variants of an effect [rad], by terms and effect, to first order.
    """

    rollouts: Rollouts
    sizes: TypicalSizes
    guide: RolloutFits | None = None
    known: Model | None = None
    extrapolated: dict[tuple[Key, str], float] = field(default_factory=dict, init=False)
    _linear: dict[Key, LinearErrors] = field(default_factory=dict, init=False)
    _starts: dict[Key, Point] = field(default_factory=dict, init=False)  # parameters of linear fits
    _converged: set[Key] = field(default_factory=set, init=False)

    @property
    def first_point(self) -> Point:
        """Return the first fit."""
        return next(iter(self._linear.values())).point

    def linearise(self, terms: Terms) -> LinearErrors:
        """Return the errors around the fit of some terms."""
        key = tuple(terms)
        if key not in self._linear:
            typical = self.sizes.list_sizes(key)
            if self.guide is not None:
                point = self.guide.linearise(key).point
                self._linear[key] = linearise_errors(self.rollouts, point, typical, nonlinear=False)
            else:
                share = 1.0 if self._is_hopeless(key) else LOOP.fit.roughly
                starts = [self._choose_start(key)] if self._linear else self._start_from_torque(key)
                self._store(key, self._fit_likeliest(starts, typical, share))
        return self._linear[key]

    @memoized
    def predict(self, terms: Terms) -> tuple[Point, Array]:
        """Return the fit of other recordings, the `guide`, and the errors under it (R,) [rad]."""
        assert self.guide is not None
        point = self.guide.linearise(terms).point
        near = self._linear.get(tuple(terms))
        return point, self.rollouts.compute_position_errors([point])[:, 0] if near is None else near.error

    def compute_scale(self, terms: Terms) -> float:
        """Return the scale with the same likelihood as the errors of the fit of some terms [rad]."""
        return compute_likelihood_scale(self.rollouts, self.linearise(terms).error)

    def fit(self, terms: Terms, exactly: bool = False) -> Point:
        """Fit some terms, to convergence if `exactly`; return the fitted terms and parameters."""
        key = tuple(terms)
        if exactly and self.guide is None and key not in self._converged:
            typical = self.sizes.list_sizes(key)
            starts = [self.linearise(key).point]
            if len(self.rollouts.positions.measured) <= LOOP.fit.long_count:  # longer ones start from a fit of pieces
                starts = vary_dry_friction(starts[0], typical)
            likeliest = self._fit_likeliest(starts, typical, LOOP.fit.roughly).point
            self._store(key, fit_rollouts(self.rollouts, likeliest, typical, share=0.0))
            self._converged |= {key, self.linearise(key).point.terms}
        return self.linearise(key).point

    def fit_nonlinear(self, terms: Terms) -> Key:
        """Fit all continuous nonlinear parameters from their values; return the fitted terms."""
        point = self.linearise(terms).point
        if len(point.values) == len(point.theta):
            return point.terms
        return self._store_own(fit_rollouts(self.rollouts, point, self.sizes.list_sizes(terms), nonlinear=True))

    def fit_by_profile(self, terms: Terms) -> LikelihoodProfile | None:
        """Refit some terms by the profile of a parameter with many local minima; None if no term has one."""
        typical = self.sizes.list_sizes(terms)
        profile = scan_profile(self.rollouts, self.linearise(terms).point, typical)
        if profile is not None:
            self._converged.add(self._store_own(linearise_errors(self.rollouts, profile.point, typical, True)))
        return profile

    def fit_link(self, terms: Terms, variants: Terms, least_share: float) -> Key:
        """Fit the terms with a link from several of its variants; arguments as of `fit_link`."""
        return self._store_own(fit_link(self.rollouts, self.sizes, self.linearise(terms).point, variants, least_share))

    def set_start(self, point: Point, terms: Key | None = None) -> None:
        """Set the start of the fit of some terms, by default those of the point."""
        self._starts[terms or point.terms] = point

    def _store(self, terms: Key, linear: LinearErrors) -> None:
        """Store a fit under `terms`, and under its fitted terms: their bounds may depend on linear parameters."""
        self._linear[terms] = self._linear[linear.point.terms] = linear

    def _store_own(self, linear: LinearErrors) -> Key:
        """Store a fit under its fitted terms, and return these."""
        self._linear[linear.point.terms] = linear
        return linear.point.terms

    def _is_hopeless(self, terms: Key) -> bool:
        """Return whether the linear fit of the last term gains too little, so one iteration suffices."""
        others, last = terms[:-1], terms[-1]
        if others not in self._linear or (others, last.id) not in self.extrapolated:
            return False
        ratio = self.compute_scale(others) / self.extrapolated[others, last.id]
        return bool(len(self.rollouts.positions.measured) * np.log(ratio) < LOOP.fit.hopeless)

    def _choose_start(self, terms: Key) -> Point:
        """Return the likeliest start of a fit, from the most similar fitted model.

        Parameters that the similar model lacks are 0, or their typical size times 1 or 3. A link also starts from the
        likeliest model with another link, with the same inertia.
        """
        ids, typical = {term.id for term in terms}, self.sizes.list_sizes(terms)
        parents = sorted(
            self._linear, key=lambda other: (len(ids ^ {term.id for term in other}), -len(set(other) & set(terms)))
        )
        values = self._linear[parents[0]].point.linear_values
        names = [column.name for term in terms for column in term.columns]
        starts = [
            Point.from_parameters(
                terms, np.array([values.get(name, share * size) for name, size in zip(names, typical, strict=True)])
            )
            for share in (0.0, 1.0, 3.0)
        ]
        if all(name in values for name in names):
            del starts[1:]
        starts += self._start_from_other_link(terms)
        if terms in self._starts:
            starts.append(self._starts[terms])
        return starts[0] if len(starts) == 1 else choose_likeliest_point(self.rollouts, starts)[0]

    def _fit_likeliest(self, starts: Sequence[Point], typical: Array, share: float) -> LinearErrors:
        """Fit from each start; return the likeliest fit. Of long recordings, only the likeliest start is finished."""
        if len(starts) > 1 and len(self.rollouts.positions.measured) > LOOP.fit.long_count:
            hasty = [fit_rollouts(self.rollouts, start, typical, share=LOOP.fit.hasty_share) for start in starts]
            starts = [min(hasty, key=lambda fit: compute_likelihood_scale(self.rollouts, fit.error)).point]
        fits = [fit_rollouts(self.rollouts, start, typical, share=share) for start in starts]
        return min(fits, key=lambda fit: compute_likelihood_scale(self.rollouts, fit.error))

    def _start_from_torque(self, terms: Key) -> list[Point]:
        """Return starts of a first fit: the given or the known one, or by the torque with several least sizes."""
        known = self._start_from_known(terms)
        if terms in self._starts:
            given = [self._starts[terms], *known]
            return given if len(given) == 1 else [choose_likeliest_point(self.rollouts, given)[0]]
        theta, typical = self.sizes.torque.fits.solve(terms), self.sizes.list_sizes(terms)
        sizes = [theta, *(np.maximum(np.abs(theta), share * typical) for share in (1.0, 5.0))]
        points = [*(Point.from_parameters(terms, values) for values in sizes), *known]
        return vary_dry_friction(choose_likeliest_point(self.rollouts, points)[0], typical)

    def _start_from_known(self, terms: Terms) -> list[Point]:
        """Return the parameters of the known model as a start, if some terms have all of them."""
        names = [column.name for term in terms for column in term.columns]
        known = {} if self.known is None else Point.from_model(self.known).linear_values
        if not known or not known.keys() <= set(names):
            return []
        return [Point.from_parameters(terms, np.array([known.get(name, 0.0) for name in names]))]

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


def vary_dry_friction(point: Point, typical: Array) -> list[Point]:
    """Return a point, and the same with smaller and larger dry friction.

    Where a servo sticks depends on its dry friction, so the likelihood has several minima over it. `typical` is the
    size of each linear parameter that matters (P,). Parameters of either sign stay.
    """
    is_dry = np.array([column.dry is not return_zero for term in point.terms for column in term.columns])
    is_dry &= list_bounds(point.terms)[0] == 0
    sizes = np.maximum(point.theta, typical)
    others = [np.where(is_dry, factor * sizes, point.theta) for factor in LOOP.fit.friction]
    changed = [np.r_[theta, point.values[len(theta) :]] for theta in others if (theta != point.theta).any()]
    return [point, *(bind_terms(point.with_values(values)) for values in changed)]


def _list_columns_without_link(terms: Key) -> list[list[str]]:
    """List the names of the linear parameters of each term, without those of a link, so all links compare equal."""
    return [[] if term.link else [column.name for column in term.columns] for term in terms]
