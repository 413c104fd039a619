"""Trials of models in the loop: what the one engine asks of windowed equations, asked of whole rollouts.

Around the likeliest parameters of a model its simulated positions are as good as linear in them. There its equations
stand: y = phi theta, with positions on the left and their derivatives on the right.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.in_loop.fit import ROUGHLY, Linear, fit, likeliest, likelihood, linear
from estimators.in_loop.rollouts import Rollouts
from estimators.kept import kept
from estimators.regression.least_squares import Balance, Columns
from estimators.selection.candidates import Trial, best_of_forms, bounds, by_class
from estimators.selection.data import Errors, PreparedData
from estimators.selection.score import BLOCK, FOLDS
from estimators.simulation.output_error import Point
from estimators.weak_form.shapes import continuous
from pendulum_env._typing import Array
from pendulum_env.physics import Model, Samples, Term
from pendulum_env.recording import Recording

Terms = tuple[Term, ...]
TYPICAL = 0.05  # of the torque, a size at which a parameter matters
HOPELESS = 15.0  # [nat], as far as linear equations foresee it
MOST = 24  # variants of a grid, from the best of which continuous shape parameters are fitted


@dataclass(eq=False)
class InLoop:
    """Recordings of servos, to be followed in the loop, with trials of term sets; what was fitted once is kept.

    Attributes:
        data: their rollouts.
        windows: the same recordings as windowed equations, which tell typical sizes and where to begin.
        guide: the fitted recordings, by whose fit these have to be predicted; None of these themselves.
    """

    data: Rollouts
    windows: PreparedData
    guide: InLoop | None = None
    _linear: dict[Terms, Linear] = field(default_factory=dict, init=False)
    _ranked: dict[tuple[Terms, str], list[Trial]] = field(default_factory=dict, init=False)
    _foretold: dict[Terms, Point] = field(default_factory=dict, init=False)  # where a linear fit has the parameters
    _settled: set[Terms] = field(default_factory=set, init=False)

    segments = ()
    in_loop = True

    @property
    def screen(self) -> InLoop:
        """Fits of models to the data."""
        return self

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """The recordings that it is of."""
        return self.data.recordings

    @property
    def samples(self) -> Samples:
        """Samples of the motion."""
        return self.windows.samples

    @property
    def motions(self) -> dict[str, Samples]:
        """Those of each joint, by its name."""
        return self.windows.motions

    def reach_of(self, joint: str) -> tuple[float, float]:
        """Least and largest position that was recorded [rad]."""
        return self.windows.reach_of(joint)

    def watching(self, model: Model) -> InLoop:
        """The same: a link moves along in a simulation."""
        return self

    def misses(self, terms: Sequence[Term], theta: Array) -> Array:
        """Measured minus simulated positions (R,) [rad]."""
        return -self.data.misses([Point(tuple(terms), theta)])[:, 0]

    def errors(self, model: Model) -> Errors:
        """Errors of a model in the loop."""
        return Errors(np.nan, np.nan).with_loop(self.misses(model.terms, np.asarray(model.theta)))

    def at(self, joint: str) -> InLoop:
        """The trials at a joint: a servo has one."""
        return self

    def near(self, terms: Sequence[Term]) -> Linear:
        """Errors around the fit of the terms."""
        key = tuple(terms)
        if key not in self._linear:
            if self.guide is not None:
                self._linear[key] = linear(self.data, self.guide.near(key).point, self.typical(key), False)
            else:
                share = 1.0 if self._is_hopeless(key) else ROUGHLY
                self._keep(key, fit(self.data, self._begin(key), self.typical(key), share=share))
        return self._linear[key]

    def _is_hopeless(self, terms: Terms) -> bool:
        """Whether the last of the terms promises nothing beside the others: then a single turn says enough of it."""
        others, last = terms[:-1], terms[-1]
        if others not in self._linear or (others, last.id) not in self._ranked:
            return False
        best = self._ranked[others, last.id][0].fitted_rms
        gain = len(self.data.position) * np.log(self.trial(others).fitted_rms / best)
        return bool(gain < HOPELESS)

    def _keep(self, terms: Terms, found: Linear) -> None:
        """Know a fit by the terms that it was asked for, and by those that it has: some shapes follow parameters."""
        self._linear[terms] = self._linear[found.point.terms] = found

    def begin_at(self, point: Point) -> None:
        """Where the fit of a model begins."""
        self._foretold[point.terms] = point

    def as_fitted(self, terms: Sequence[Term]) -> Terms:
        """The terms with shape parameters that follow others as these were fitted."""
        return self.near(terms).point.terms

    def settle(self, terms: Sequence[Term]) -> Terms:
        """The terms fitted as closely as can be, with shape parameters that follow others."""
        key = tuple(terms)
        if self.guide is None and key not in self._settled:
            self._keep(key, fit(self.data, self.near(key).point, self.typical(key), share=0.0))
            self._settled |= {key, self.near(key).point.terms}
        return self.near(key).point.terms

    def typical(self, terms: Sequence[Term]) -> Array:
        """Size of each linear parameter that matters (P,)."""
        return np.concatenate([np.empty(0), *(self._typical_of(term) for term in terms)])

    @kept
    def _typical_of(self, term: Term) -> Array:
        rms = np.sqrt(np.mean(self.windows.data.torque() ** 2))
        own = np.sqrt(np.mean(self.windows.data.columns([term])[0][0] ** 2, axis=0))
        return np.asarray(TYPICAL * rms / np.maximum(own, 1e-9))

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
            return starts[0]
        foretold = [self._foretold[terms]] if terms in self._foretold else []
        return likeliest(self.data, [*starts, *foretold])[0]

    def _first(self, terms: Terms) -> Iterator[Point]:
        """Where the first fit may begin: where torque has the parameters, or with what a joint has at least."""
        theta, typical = self.windows.screen.solve(terms), self.typical(terms)
        for share in (0.0, 1.0, 5.0):
            values = np.maximum(np.abs(theta), share * typical) if share else theta
            yield Point.within(terms, values)

    def likelihood(self, terms: Sequence[Term]) -> float:
        """Log density of the errors of the likeliest fit of some terms, but for a constant [nat]."""
        return float(likelihood(self.data, self.near(terms).error[:, None])[0])

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

    def hidden_noise(self, terms: Sequence[Term]) -> list[tuple[slice, float]]:
        """What terms take out of the noise: nothing, where positions are compared."""
        return []

    def trial(self, terms: Sequence[Term]) -> Trial:
        """One set of terms, with the scale of its errors [rad]."""
        return self._trial(tuple(terms), self.near(terms).error)

    def _trial(self, terms: Terms, error: Array) -> Trial:
        return Trial(terms, float(np.exp(-likelihood(self.data, error[:, None])[0] / len(error))))

    def grid(self, terms: Sequence[Term], effect: type[Term]) -> list[Term]:
        """Variants of an effect beside the terms, from which a search starts."""
        variants = self.windows.screen.grid(tuple(terms), effect)
        coarse = any(not shape.integer for shape in effect.shapes) and len(variants) > MOST
        return variants[:: -(-len(variants) // MOST)] if coarse else variants

    def looked_at(self, terms: Sequence[Term], effect: type[Term]) -> int:
        """Number of variants among which `grid` chose."""
        return self.windows.screen.looked_at(tuple(terms), effect)

    def ranked(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """The terms with each variant of the grid of an effect, the smallest error as foreseen first."""
        key = tuple(terms), effect.id
        if key not in self._ranked:
            foreseen = (one for same in by_class(self.grid(terms, effect)) for one in self._foreseen(key[0], same))
            found = [self._trial((*key[0], variant), error) for variant, error in foreseen]
            self._ranked[key] = sorted(found, key=lambda trial: trial.fitted_rms)
        return self._ranked[key]

    def _foreseen(self, terms: Terms, variants: Sequence[Term]) -> list[tuple[Term, Array]]:
        """Each variant with the errors that a linear fit beside the terms foresees (R,)."""
        near, columns = self.near(terms), self.columns(variants, terms)
        found = []
        for variant, own in zip(variants, columns, strict=True):
            phi = np.column_stack([near.slopes[:, : len(near.point.theta)], own.linear])
            left = near.error + own.fixed
            least, most = bounds([variant])
            free = len(near.point.theta)
            balance = Balance(
                phi,
                -left,
                np.zeros_like(phi),
                np.r_[np.full(free, -np.inf), least],
                np.r_[np.full(free, np.inf), most],
                near.weights,
            )
            step = balance.solve()
            theta = np.r_[near.point.theta + step[:free], step[free:]]
            self._foretold[*terms, variant] = Point.within((*near.point.terms, variant), theta)
            found.append((variant, left + phi @ step))
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

    @kept
    def variants(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """Best variants of an effect beside the terms, one for each set of shape parameters that are told."""
        return best_of_forms(self.ranked(terms, effect), effect, self.refine)

    def refine(self, trial: Trial, id: str) -> Trial:
        """Fit all continuous shape parameters of a trial from where they are."""
        point = self.near(trial.terms).point
        if len(point.values) == len(point.theta):
            return self.trial(point.terms)
        found = fit(self.data, point, self.typical(trial.terms), shapes=True)
        self._keep(found.point.terms, found)
        return self.trial(found.point.terms)

    def shape_jacobian(self, terms: Sequence[Term], theta: Array) -> tuple[Array, list[str]]:
        """Derivatives (R, S) of the positions with respect to continuous shape parameters, and their names."""
        point = self.near(terms).point
        names = [term.full(shape.name) for term in terms for shape in continuous(term)]
        slopes = (
            linear(self.data, point, self.typical(terms), True).slopes
            if names
            else np.empty((len(self.data.position), 0))
        )
        return slopes[:, len(slopes[0]) - len(names) :], names

    def placed(self, terms: Sequence[Term], parts: Sequence[Array]) -> Array:
        """Columns of some terms side by side (R, P)."""
        return np.column_stack(parts)

    def frame(self, terms: Sequence[Term]) -> Array:
        """Orthonormal columns (R, P) that span what the terms can do to the weighted errors."""
        near = self.near(terms)
        return np.linalg.qr(near.slopes[:, : len(near.point.theta)] * near.weights[:, None])[0]
