"""Fits of models in the loop: what a search asks of windowed equations, asked of whole rollouts.

Around the likeliest parameters of a model its simulated positions are as good as linear in them. There its equations
stand: y = phi theta, with positions on the left and their derivatives on the right.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.in_loop.fit import LOOP, Linear, fit, likeliest, linear, scale_of
from estimators.in_loop.rollouts import Rollouts
from estimators.memoize import memoized
from estimators.regression.balance import Balance, Columns
from estimators.selection.columns import bounds
from estimators.selection.data import PreparedData
from estimators.selection.score import BLOCK, FOLDS
from estimators.simulation.output_error import Point
from estimators.weak_form.nonlinear import continuous
from pendulum_env._typing import Array
from pendulum_env.physics import Term

Terms = tuple[Term, ...]


@dataclass(eq=False)
class LoopRegression:
    """Fits of sets of terms to rollouts; what was fitted once is kept.

    Attributes:
        data: rollouts.
        windows: the same recordings as windowed equations, which tell typical sizes and where to begin.
        guide: fits to the recordings by whose parameters these have to be predicted; None of these themselves.
    """

    data: Rollouts
    windows: PreparedData
    guide: LoopRegression | None
    _linear: dict[Terms, Linear] = field(default_factory=dict, init=False)
    _foretold: dict[Terms, Point] = field(default_factory=dict, init=False)  # where a linear fit has the parameters
    _promised: dict[tuple[Terms, str], float] = field(default_factory=dict, init=False)  # least error foreseen [rad]
    _settled: set[Terms] = field(default_factory=set, init=False)

    def near(self, terms: Sequence[Term]) -> Linear:
        """Errors around the fit of the terms."""
        key = tuple(terms)
        if key not in self._linear:
            if self.guide is not None:
                self._linear[key] = linear(self.data, self.guide.near(key).point, self.typical(key), False)
            else:
                share = 1.0 if self._is_hopeless(key) else LOOP.roughly
                self._keep(key, fit(self.data, self._begin(key), self.typical(key), share=share))
        return self._linear[key]

    def _is_hopeless(self, terms: Terms) -> bool:
        """Whether the last of the terms promises nothing beside the others: then a single turn says enough of it."""
        others, last = terms[:-1], terms[-1]
        if others not in self._linear or (others, last.id) not in self._promised:
            return False
        best = self._promised[others, last.id]
        gain = len(self.data.position) * np.log(scale_of(self.data, self.near(others).error) / best)
        return bool(gain < LOOP.hopeless)

    def _keep(self, terms: Terms, found: Linear) -> None:
        """Know a fit by the terms that it was asked for, and by those that it has: some parameters follow others."""
        self._linear[terms] = self._linear[found.point.terms] = found

    def begin_at(self, point: Point, terms: Terms | None = None) -> None:
        """Where the fit of a model begins, of the terms of the point if no others are given."""
        self._foretold[terms or point.terms] = point

    def fitted_terms(self, terms: Sequence[Term]) -> Terms:
        """The terms with nonlinear parameters that follow others as these were fitted."""
        return self.near(terms).point.terms

    def converge(self, terms: Sequence[Term]) -> Terms:
        """The terms fitted as closely as can be, with nonlinear parameters that follow others."""
        key = tuple(terms)
        if self.guide is None and key not in self._settled:
            self._keep(key, fit(self.data, self.near(key).point, self.typical(key), share=0.0))
            self._settled |= {key, self.near(key).point.terms}
        return self.near(key).point.terms

    def with_nonlinear(self, terms: Sequence[Term]) -> Terms:
        """The terms with all continuous nonlinear parameters fitted from where they are."""
        point = self.near(terms).point
        if len(point.values) == len(point.theta):
            return point.terms
        found = fit(self.data, point, self.typical(terms), nonlinear=True)
        self._keep(found.point.terms, found)
        return found.point.terms

    def typical(self, terms: Sequence[Term]) -> Array:
        """Size of each linear parameter that matters (P,)."""
        return np.concatenate([np.empty(0), *(self._typical_of(term) for term in terms)])

    @memoized
    def _typical_of(self, term: Term) -> Array:
        rms = np.sqrt(np.mean(self.windows.data.torque() ** 2))
        own = np.sqrt(np.mean(self.windows.data.columns([term])[0][0] ** 2, axis=0))
        return np.asarray(LOOP.typical * rms / np.maximum(own, 1e-9))

    def _begin(self, terms: Terms) -> Point:
        """Where a fit begins: the likeliest of what is known of models that are nearly the same."""
        known = {term.id for term in terms}
        parents = sorted(
            self._linear, key=lambda other: (len(known ^ {term.id for term in other}), -len(set(other) & set(terms)))
        )
        if not parents:
            return self._foretold.get(terms) or likeliest(self.data, [*self._first(terms)])[0]
        parent = self._linear[parents[0]].point
        values = dict(zip((c.name for term in parent.terms for c in term.columns), parent.theta, strict=True))
        names = [column.name for term in terms for column in term.columns]
        sizes = list(zip(names, self.typical(terms), strict=True))
        starts = [
            Point.within(terms, np.array([values.get(name, share * size) for name, size in sizes]))
            for share in (0.0, 1.0, 3.0)
        ]
        if all(name in values for name in names):
            del starts[1:]
        if terms in self._foretold:
            starts.append(self._foretold[terms])
        return starts[0] if len(starts) == 1 else likeliest(self.data, starts)[0]

    def _first(self, terms: Terms) -> Iterator[Point]:
        """Where the first fit may begin: where torque has the parameters, or with what a joint has at least."""
        theta, typical = self.windows.regression.solve(terms), self.typical(terms)
        for share in (0.0, 1.0, 5.0):
            values = np.maximum(np.abs(theta), share * typical) if share else theta
            yield Point.within(terms, values)

    def balance(self, terms: Sequence[Term]) -> Balance:
        """Equations of some terms, weighted by how far off each error is."""
        near = self.near(terms)
        theta = near.point.theta
        phi = near.slopes[:, : len(theta)]
        return Balance(phi, phi @ theta - near.error, np.zeros_like(phi), *bounds(terms), near.weights)

    equations = balance

    def weights(self, terms: Sequence[Term]) -> Array:
        """Weight of each equation (R,)."""
        return self.near(terms).weights

    def solve(self, terms: Sequence[Term]) -> Array:
        """Linear parameters (P,) of the likeliest fit."""
        return self.near(terms).point.theta

    def solve_without(self, terms: Sequence[Term]) -> Array:
        """Linear parameters of the terms without each fold of blocks (FOLDS, P)."""
        return self.balance(terms).solve_without(self.data.blocks(BLOCK)[0] % FOLDS, FOLDS)

    def residual(self, terms: Sequence[Term]) -> Array:
        """Measured minus simulated positions of the fit (R,) [rad]."""
        return -self.near(terms).error

    def absorbed_noise(self, terms: Sequence[Term]) -> list[tuple[slice, float]]:
        """What terms take out of the noise: nothing, where positions are compared."""
        return []

    def foreseen(self, terms: Terms, variants: Sequence[Term]) -> list[float]:
        """Scale of the errors with each variant of one effect, as a linear fit beside the terms foresees it [rad]."""
        near, key = self.near(terms), (terms, variants[0].id)
        slopes = near.slopes[:, : (free := len(near.point.theta))]
        others = slice(None), Columns(slopes, np.zeros(len(slopes)), np.zeros_like(slopes))
        found = []
        for variant, own in zip(variants, self.columns(variants, terms), strict=True):
            least, most = bounds([variant])
            unbounded = np.full(free, np.inf)
            balance = Balance.of(-near.error, near.weights).beside(
                [others, (slice(None), own)], np.append(-unbounded, least), np.append(unbounded, most)
            )
            step = balance.solve()
            theta = np.append(near.point.theta + step[:free], step[free:])
            self.begin_at(Point.within((*near.point.terms, variant), theta), (*terms, variant))
            found.append(scale_of(self.data, -balance.error(step)))
        self._promised[key] = min([*found, self._promised.get(key, np.inf)])
        return found

    def columns(self, variants: Sequence[Term], terms: Terms | None = None) -> list[Columns]:
        """What each of several variants of one effect does to the positions beside the fit of some terms.

        Without terms: beside the first model that was fitted.
        """
        point = self.near(next(iter(self._linear)) if terms is None else terms).point
        others = [term.id for term in point.terms]
        if variants[0].id in others:
            point = Point(
                tuple(term for term in point.terms if term.id != variants[0].id),
                self._without(point, others.index(variants[0].id)),
            )
        points = [point]
        slices = []
        for variant in variants:
            size = self._typical_of(variant)
            shifts = np.diag(size) if len(size) else np.zeros((1, 0))
            if variant.fixed and len(size):
                shifts = np.vstack([np.zeros(len(size)), shifts])
            slices.append((len(points), len(points) + len(shifts)))
            points += [Point((*point.terms, variant), np.r_[point.theta, shift]) for shift in shifts]
        base = self.data.misses(points[:1])
        errors = np.column_stack([base, self.data.misses(points[1:])])
        found = []
        for variant, (first, last) in zip(variants, slices, strict=True):
            own, size = errors[:, first:last], self._typical_of(variant)
            fixed = own[:, :1] - base if variant.fixed else np.zeros_like(base)
            linear = own[:, len(own[0]) - len(size) :] - base - fixed if len(size) else np.empty((len(own), 0))
            found.append(Columns(linear / size, fixed[:, 0], np.zeros((len(own), len(size)))))
        return found

    @staticmethod
    def _without(point: Point, place: int) -> Array:
        first = sum(len(term.columns) for term in point.terms[:place])
        return np.delete(point.theta, np.s_[first : first + len(point.terms[place].columns)])

    def nonlinear_jacobian(self, terms: Sequence[Term], theta: Array) -> tuple[Array, list[str]]:
        """Derivatives (R, S) of the positions with respect to continuous nonlinear parameters, and their names."""
        point = self.near(terms).point
        names = [term.full(parameter.name) for term in terms for parameter in continuous(term)]
        slopes = (
            linear(self.data, point, self.typical(terms), True).slopes
            if names
            else np.empty((len(self.data.position), 0))
        )
        return slopes[:, len(slopes[0]) - len(names) :], names

    def place_columns(self, terms: Sequence[Term], parts: Sequence[Array]) -> Array:
        """Columns of some terms side by side (R, P)."""
        return np.column_stack(parts)

    def frame(self, terms: Sequence[Term]) -> Array:
        """Orthonormal columns (R, P) that span what the terms can do to the weighted errors."""
        near = self.near(terms)
        return np.linalg.qr(near.slopes[:, : len(near.point.theta)] * near.weights[:, None])[0]
