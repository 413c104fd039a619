"""Candidates: the best-fitting variant of each effect beside the terms of a model.

All shape parameters of an effect are compared through Gram matrices of the windowed equations, so that a fit of many
variants costs one batch of small solves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np

from estimators.kept import kept
from estimators.regression.least_squares import RIDGE, Balance, Columns, Tangent
from estimators.regression.normal import Groups, Normal, quietest_most
from estimators.selection.score import BLOCK, FOLDS
from estimators.weak_form.dataset import Dataset
from estimators.weak_form.shapes import Residuals, cross_entropy, gauss_newton, scan, shape_slopes
from pendulum_env._typing import Array
from pendulum_env.physics import Term
from pendulum_env.physics.table import Table

REACH = 0.03  # of the recording, range of the scan for an instant
TRIED = 3  # most promising variants of a law of the torque, which are fitted exactly
KEPT = 8  # sets of terms whose normal equations are kept
STARTS = 2  # variants of the grid from which a search over shape parameters starts
FOLLOWS = 3  # iterations that set a shape parameter to the parameter that it follows

PERTURBATION = 1e-6  # of the largest torque, for slopes by it
PUSHES = np.array([0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0])  # of it, either way, for bent laws of it


@dataclass(frozen=True)
class Trial:
    """A set of terms with the torque error of its fit [N m]."""

    terms: tuple[Term, ...]
    fitted_rms: float


@dataclass
class Screen:
    """Trials of term sets on one dataset; what was evaluated once is kept."""

    data: Dataset
    _columns: dict[Term, Columns] = field(default_factory=dict)
    _bases: dict[tuple[Term, ...], tuple[Array, Normal]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._torque = self.data.net_torque()

    def at(self, joint: str) -> Screen:
        """The screen of the data of a joint; this one for what is at no one joint."""
        return self if self.data.part(joint) is self.data else self._of_joint(joint)

    @kept
    def _of_joint(self, joint: str) -> Screen:
        return Screen(self.data.part(joint))

    def columns(self, variants: Sequence[Term]) -> list[Columns]:
        """Windowed columns of each variant of one effect, on the rows of its joint."""
        if (own := self.at(variants[0].at)) is not self:
            return own.columns(variants)
        missing = [variant for variant in variants if variant not in self._columns]
        if missing:
            self._columns.update(zip(missing, self._cut(missing), strict=True))
        return [self._columns[variant] for variant in variants]

    def _cut(self, variants: Sequence[Term]) -> list[Columns]:
        plain, kind, torque = self.data.columns(variants), variants[0], self.data.torque()
        if not depends_on_torque(kind):
            return [Columns(own, fixed, np.zeros_like(own)) for own, fixed in plain]
        pairs = zip(plain, self._perturbed.columns(variants), strict=True)
        slopes = [(more - own) / perturbation_of(torque) for (own, _), (more, _) in pairs]
        parts = [Columns(own, fixed, slope) for (own, fixed), slope in zip(plain, slopes, strict=True)]
        if not kind.fixed:
            return parts
        if kind.has_state():
            whole = float(np.linalg.norm(torque))
            left = [float(np.linalg.norm(torque - part.fixed)) for part in parts]
            return [
                part if variant.delay or rest >= whole else part._replace(passed=max(rest / whole, 1e-12))
                for variant, part, rest in zip(variants, parts, left, strict=True)
            ]
        lost = [self.data.rows.lost(own, pushes_of(torque)) for own in variants]
        return [
            part._replace(taken=np.nan_to_num(more, nan=0.0, posinf=0.0, neginf=0.0) - part.fixed[:, None])
            for part, more in zip(parts, lost, strict=True)
        ]

    @cached_property
    def _perturbed(self) -> Dataset:
        return self.data.with_more_torque(perturbation_of(self.data.torque()))

    @kept
    def _rates(self, term: Term) -> Array:
        return self.data.rates(term)

    def placed(self, terms: Sequence[Term], parts: Sequence[Array]) -> Array:
        """Columns of some terms side by side (R, P), each on the rows of its joint."""
        if len(self.data.joints) == 1:
            return np.column_stack(parts)
        whole, first = np.zeros((len(self._torque), sum(part.shape[1] for part in parts))), 0
        for term, part in zip(terms, parts, strict=True):
            whole[self.data.where(term.at), first : (first := first + part.shape[1])] = part
        return whole

    def balance(self, terms: Sequence[Term]) -> Balance:
        """Equations of some terms, with smaller weights for recordings of larger residuals."""
        return self._balance(terms, [self.columns([term])[0] for term in terms], self.weights(terms))

    def equations(self, terms: Sequence[Term]) -> Balance:
        """The same, weighted by noise alone."""
        return self._balance(terms, [self.columns([term])[0] for term in terms], self.data.weights)

    def weights(self, terms: Sequence[Term]) -> Array:
        """Weight of each equation (R,), smaller for recordings of larger residuals."""
        return self._weight_of_each(terms)[self._groups.owner]

    @cached_property
    def _groups(self) -> Groups:
        return Groups.of(self.data.recording_of_window, self.data.blocks(BLOCK)[0] % FOLDS, FOLDS)

    @cached_property
    def _by_noise(self) -> Array:
        """Weight of each recording by its noise alone (E,)."""
        weights = np.ones(len(self._groups.counts))
        weights[self._groups.owner] = self.data.weights
        return weights

    def _normal(self, terms: tuple[Term, ...]) -> Normal | None:
        """Normal equations of terms that no torque bends; None of others. Those of all but the last are kept."""
        if not terms or depends_on_torque(*terms) or is_known(*terms):
            return None
        *others, last = terms
        if not others:
            return Normal.of(self._rows(terms), self._groups, *bounds(terms))
        base = tuple(others)
        if base not in self._bases:
            if len(self._bases) >= KEPT:
                self._bases.pop(next(iter(self._bases)))
            rows = self._rows(base)
            self._bases[base] = rows, Normal.of(rows, self._groups, *bounds(base))
        rows, normal = self._bases[base]
        own, here = self.columns([last])[0].linear, self.data.where(last.at)
        return normal.beside(rows, own, here, self._groups, *bounds([last]))

    def _rows(self, terms: Sequence[Term]) -> Array:
        """Left-hand side and columns of some terms side by side (R, P + 1)."""
        return np.column_stack([self._torque, self.placed(terms, [self.columns([term])[0].linear for term in terms])])

    def _balance(self, terms: Sequence[Term], parts: Sequence[Columns], w: Array) -> Balance:
        acting, loaded = self._torque.copy(), self._torque.copy()  # without what all fixed columns take, or without lag
        passed, lead = np.ones(len(w)), np.zeros(len(w))
        taken: list[tuple[slice, Array]] = []
        for term, part in zip(terms, parts, strict=True):
            here = self.data.where(term.at)
            if term.fixed:
                acting[here] -= part.fixed
                loaded[here] -= 0.0 if term.lead else part.fixed
                lead[here] += term.lead
                passed[here] *= part.passed
            if part.taken is not None:
                taken.append((here, part.taken))
        balance = Balance(
            self.placed(terms, [part.linear for part in parts]),
            acting,
            self.placed(terms, [part.slope for part in parts]),
            *bounds(terms),
            w,
        )
        if taken:
            response = self._pushes.copy()
            for here, own in taken:
                response[here] -= own
            balance = replace(balance, response=response, pushes=self._pushes)
        if lead.any():
            ahead = balance.phi + lead[:, None] * self.placed(terms, [self._rates(term) for term in terms])
            balance = replace(balance, recorded=replace(balance, phi=ahead, y=loaded - lead * self.data.load_rates))
        return balance if (passed == 1.0).all() else replace(balance, passed=passed)

    @cached_property
    def _pushes(self) -> Array:
        """Pushes of the torque in each equation (R, J) [N m]."""
        joints = [self.data.part(at) for at in self.data.joints]
        return np.concatenate([np.tile(pushes_of(own.torque()), (len(own.weights), 1)) for own in joints])

    @kept
    def solve(self, terms: Sequence[Term]) -> Array:
        """Linear parameters (P,) of the terms, fitted to all windows."""
        normal = self._normal(tuple(terms))
        theta = None if normal is None else normal.solve(self._weight_of_each(terms))
        return self.balance(terms).solve() if theta is None else theta

    def solve_without(self, terms: Sequence[Term]) -> Array:
        """Linear parameters of the terms without each fold of blocks (FOLDS, P)."""
        normal = self._normal(tuple(terms))
        found = None if normal is None else normal.solve_without(self._weight_of_each(terms))
        return self.balance(terms).solve_without(self._groups.fold, FOLDS) if found is None else found

    @kept
    def _weight_of_each(self, terms: Sequence[Term]) -> Array:
        """Weight of each recording (E,)."""
        if len(self.data.windows) == 1 or not terms:
            return self._by_noise
        normal = self._normal(tuple(terms))
        theta = None if normal is None else normal.solve(self._by_noise)
        if normal is not None and theta is not None:
            return normal.weights(theta, self.data.least())
        balance = self.equations(terms)
        owner, counts = self._groups.owner, self._groups.counts
        squares = np.bincount(owner, balance.error(balance.solve()) ** 2, len(counts)).astype(float)
        return quietest_most(squares, counts, self.data.least())

    def as_fitted(self, terms: Sequence[Term]) -> tuple[Term, ...]:
        """The terms with shape parameters that follow others as these were fitted: a search sets them itself."""
        return tuple(terms)

    def settle(self, terms: Sequence[Term]) -> tuple[Term, ...]:
        """The terms fitted as closely as can be: they always are."""
        return tuple(terms)

    @kept
    def tangent(self, terms: Sequence[Term]) -> Tangent:
        """Errors near the fit of the terms, to first order."""
        return self.balance(terms).tangent()

    @kept
    def frame(self, terms: Sequence[Term]) -> Array:
        """Orthonormal basis (R, P) of changes of the weighted errors by the parameters."""
        return np.linalg.qr(self.tangent(terms).slopes * self.weights(terms)[:, None])[0]

    def trials(self, terms: Sequence[Term], variants: Sequence[Term]) -> list[Trial]:
        """`terms` with each of V variants of one further effect added, and their errors."""
        w, here = self.weights(terms), self.data.where(variants[0].at)
        models = [(*terms, variant) for variant in variants]
        parts = self.columns(variants)
        beside = cache(lambda: self._beside(terms, here))  # most variants do without

        def exact(variant: Term, own: Columns) -> float:
            return beside()(variant, own).least_squared()

        if not terms or variants[0].fixed or is_known(*terms, variants[0]):
            squares = np.array([exact(*pair) for pair in zip(variants, parts, strict=True)])
        else:
            near = self.tangent(terms)
            squares, theta = squared_errors(_grams(near, parts, w, here))
            theta[:, : len(near.theta)] += near.theta
            least, most = bounds(models[0])
            for k in np.flatnonzero(np.any((theta < least) | (theta > most), axis=1)).tolist():
                squares[k] = exact(variants[k], parts[k])
            if depends_on_torque(variants[0]):
                squares = self._bent(near, list(zip(variants, parts, strict=True)), squares, exact, w)
        return [
            Trial(model, float(np.sqrt(square / (w @ w) + self._hidden_in_all(model, w))))
            for model, square in zip(models, squares, strict=True)
        ]

    def _bent(
        self,
        near: Tangent,
        pairs: Sequence[tuple[Term, Columns]],
        plain: Array,
        exact: Callable[[Term, Columns], float],
        w: Array,
    ) -> Array:
        """Squared errors (V,) of variants that scale with the torque: exact ones of those that promise most.

        They are ranked by the fit with the recorded torque and by the fit with the predicted one, as either may be far
        off.
        """
        here = self.data.where(pairs[0][0].at)
        moved = [own._replace(linear=own.linear - near.error[here, None] * own.slope) for _, own in pairs]
        promises = (plain, squared_errors(_grams(near, moved, w, here))[0])
        tried = np.unique([np.argsort(promise)[:TRIED] for promise in promises])
        squares = np.array([exact(*pairs[k]) for k in tried.tolist()])
        found = np.maximum(plain, squares.min())
        found[tried] = squares
        return found

    def _beside(self, terms: Sequence[Term], here: slice) -> Callable[[Term, Columns], Balance]:
        """Function that gives equations of the terms and a variant at some rows, given its columns.

        What the terms share is made once, and of other joints, where nothing is bent, no more is kept than their fit.
        """
        if not terms or any(term.lead for term in terms):  # there is nothing to begin with, or that is seen twice
            shared, w = [self.columns([term])[0] for term in terms], self.weights(terms)
            return lambda variant, own: self._balance((*terms, variant), [*shared, own], w)
        first, pushes = self.balance(terms), self._pushes
        elsewhere = np.ones(len(pushes), dtype=bool)
        elsewhere[here] = False
        if elsewhere.any() and first.unbent[elsewhere].all():
            first, own_pushes = first.condensed(elsewhere), pushes[here]
            wide = np.tile(pushes.max(axis=0), (len(first.y) - len(own_pushes), 1))
            here, pushes = slice(0, len(own_pushes)), np.concatenate([own_pushes, wide])
        return lambda variant, own: first.beside(own, here, *bounds([variant]), pushes)

    def trial(self, terms: Sequence[Term]) -> Trial:
        """Errors of one set of terms."""
        *others, last = terms
        return self.trials(others, [last])[0]

    def hidden_noise(self, terms: Sequence[Term]) -> list[tuple[slice, float]]:
        """Variance of torque noise that terms filter out of the equations, with the rows of the joint [(N m)^2].

        It still counts as error: a lag smooths the noise of the torque together with the torque, which must not raise
        its likelihood.
        """
        filters = [term for term in terms if term.fixed and term.has_state()]
        return [(self.data.where(term.at), self._absorbed(term)) for term in filters]

    @kept
    def _absorbed(self, term: Term) -> float:
        return self.data.part(term.at).absorbed(term)

    def _hidden_in_all(self, terms: Sequence[Term], w: Array) -> float:
        """The same, mean over all equations as they are weighted (R,) [(N m)^2]."""
        return sum(float(w[here] @ w[here]) * variance for here, variance in self.hidden_noise(terms)) / float(w @ w)

    def residual(self, terms: Sequence[Term]) -> Array:
        """Torque (R,) that a fit of the terms does not predict [N m]."""
        return self.balance(terms).error(self.solve(terms))

    def shape_jacobian(self, terms: Sequence[Term], theta: Array) -> tuple[Array, list[str]]:
        """Derivatives (R, S) of the modelled torque with respect to continuous shape parameters, and their names."""
        slopes: dict[str, Array] = {}
        first = 0
        for term in terms:
            own = theta[first : (first := first + len(term.columns))]

            def torques(variants: Sequence[Term], own: Array = own) -> list[Array]:
                return [linear @ own + fixed for linear, fixed in self.data.columns(variants)]

            for name, slope in shape_slopes(term, torques).items():
                slopes[name] = whole = np.zeros(len(self.data.weights))
                whole[self.data.where(term.at)] = slope
        return np.column_stack([np.empty((len(self.data.weights), 0)), *slopes.values()]), list(slopes)

    @kept
    def variants(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """Best variants of an effect beside the terms, one for each set of shape parameters that are told.

        Those with the fewest come first. Empty where the data offer no variant to try.
        """
        if effect.multimodal:
            return self._searched_one_by_one(terms, effect)
        return best_of_forms(self.ranked(terms, effect), effect, self.refine)

    @kept
    def ranked(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """The terms with each variant of the grid of an effect, the smallest error first."""
        trials = [trial for same in by_class(self.grid(terms, effect)) for trial in self.trials(terms, same)]
        return sorted(trials, key=lambda trial: trial.fitted_rms)

    def grid(self, terms: Sequence[Term], effect: type[Term]) -> list[Term]:
        """Variants of an effect beside the terms, from which a search starts."""
        found = effect.grid(self.data.part(effect.at).samples, self.residual(terms)[self.data.where(effect.at)])
        return [variant.beside(terms) if isinstance(variant, Table) else variant for variant in found]

    @kept
    def looked_at(self, terms: Sequence[Term], effect: type[Term]) -> int:
        """Number of variants among which `grid` chose."""
        x, here = self.data.part(effect.at).samples, self.data.where(effect.at)
        return effect.looked_at(x, self.residual(terms)[here])

    def _searched_one_by_one(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """The best of the searches from each value of the shape parameter that the error is multimodal over."""
        variants = self.grid(terms, effect)
        if not variants:
            return []
        residuals = self._residuals(terms)
        places = {variant.shape[effect.multimodal] for variant in variants}
        niches = [[v for v in variants if v.shape[effect.multimodal] == place] for place in sorted(places)]
        found = [self.trial((*terms, cross_entropy(niche, residuals))) for niche in niches]
        best = min(found, key=lambda trial: trial.fitted_rms)
        refined = self.trial((*terms, gauss_newton(best.terms[-1], residuals)))
        return [min(best, refined, key=lambda trial: trial.fitted_rms)]

    def refine(self, trial: Trial, id: str) -> Trial:
        """Search the continuous shape parameters of one term of a trial from where they are."""
        place = next(i for i, term in enumerate(trial.terms) if term.id == id)
        term = trial.terms[place]
        if term.multimodal:
            return trial
        others = (*trial.terms[:place], *trial.terms[place + 1 :])
        following = [shape for shape in term.shapes if shape.follows]
        for _ in range(FOLLOWS if following else 0):
            theta = self.solve((*others, term))
            known = dict(zip((c.name for other in others for c in other.columns), theta, strict=False))
            term = replace(term, **{s.name: float(known[s.follows]) for s in following if s.follows in known})
        residuals, samples = self._residuals(others), self.data.part(term.at).samples
        found = scan(gauss_newton(term, residuals), residuals, REACH * float(np.ptp(samples.time)))
        refined = self.trial((*trial.terms[:place], found, *trial.terms[place + 1 :]))
        worse = refined.fitted_rms > trial.fitted_rms and not following
        return trial if worse or not found.possible(samples) else refined

    def _residuals(self, terms: Sequence[Term]) -> Residuals:
        """Function that gives the weighted residual (R,) of the best fit of the terms with each of several variants.

        The terms' own columns are projected out once, each variant's then take a small solve.
        """
        shared, w = [self.columns([term])[0] for term in terms], self.weights(terms)
        near, frame = self.tangent(terms), self.frame(terms)
        scale = w * near.scale

        def clear(columns: Array, here: slice) -> Array:
            cleared = -frame @ (frame[here].T @ columns)
            cleared[here] += columns
            return np.asarray(cleared)

        left = clear(w * near.error, slice(None))

        beside = cache(lambda at: self._beside(terms, self.data.where(at)))

        def exact(balance: Balance) -> Array:
            return balance.weights * balance.error(balance.solve())

        def residual(variant: Term, own: Columns) -> Array:
            if is_known(*terms, variant) or not variant.columns:
                return exact(self._balance((*terms, variant), [*shared, own], w))
            here = self.data.where(variant.at)
            target = left if not variant.fixed else left - clear(scale[here] * own.fixed, here)
            extra = clear(scale[here, None] * own.linear, here)
            size = np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
            extra = extra / size
            theta = np.linalg.solve(extra.T @ extra + 1e-12 * np.eye(len(size)), extra.T @ target) / size
            least, most = bounds([variant])
            if np.any((theta < least) | (theta > most)):
                return exact(self._balance((*terms, variant), [*shared, own], w))
            return np.asarray(target - (extra * size) @ theta)

        def residuals(variants: Sequence[Term]) -> list[Array]:
            pairs = list(zip(variants, self.at(variants[0].at)._cut(variants), strict=True))
            if not depends_on_torque(variants[0]):
                return [residual(*pair) for pair in pairs]
            return [exact(beside(variants[0].at)(*pair)) for pair in pairs]

        return residuals


def perturbation_of(torque: Array) -> float:
    """Push of the torque [N m], for slopes by it."""
    return PERTURBATION * _largest(torque)


def pushes_of(torque: Array) -> Array:
    """Pushes of the torque (J,) [N m], growing, zero in their middle, by which bent laws of it are solved for it."""
    return _largest(torque) * np.concatenate([-PUSHES[::-1], [0.0], PUSHES])


def _largest(torque: Array) -> float:
    return max(float(np.abs(torque).max()), 1e-12)


def depends_on_torque(*terms: Term) -> bool:
    """Whether the torque of one of the terms depends on the commanded torque."""
    return any(term.fixed or any(column.of_torque for column in term.columns) for term in terms)


def is_known(*terms: Term) -> bool:
    """Whether a linear parameter of the terms is known, and not to be fitted."""
    return any(column.is_known for term in terms for column in term.columns)


def bounds(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Bounds of the linear parameters (P,) of some terms."""
    columns = [column for term in terms for column in term.columns]
    return np.array([column.least for column in columns]), np.array([column.most for column in columns])


def by_class(variants: Iterable[Term]) -> Iterable[list[Term]]:
    """Variants that are computed at once: tables over several extents are of several classes."""
    found: dict[type[Term], list[Term]] = {}
    for variant in variants:
        found.setdefault(type(variant), []).append(variant)
    return found.values()


def best_of_forms(ranked: Sequence[Trial], effect: type[Term], refine: Callable[[Trial, str], Trial]) -> list[Trial]:
    """The best refined trial of each form that an effect has in ranked ones, the simplest form first."""
    if len(ranked) < 2 or (effect.shapes and all(shape.integer for shape in effect.shapes)):
        return list(ranked[:1])
    forms: dict[object, list[Trial]] = {}
    for trial in ranked:
        last = trial.terms[-1]
        forms.setdefault((last.free, len(last.columns)), []).append(trial)
    ends = [
        min((refine(t, effect.id) for t in few[:STARTS]), key=lambda trial: trial.fitted_rms) for few in forms.values()
    ]
    return sorted(ends, key=lambda trial: (complexity(trial.terms[-1]), trial.fitted_rms))


def complexity(term: Term) -> int:
    """Number of parameters of a term."""
    return len(term.columns) + len(term.free)


def _grams(near: Tangent, parts: Sequence[Columns], weights: Array, here: slice) -> Array:
    """Gram matrices (V, P + 1, P + 1) of fits with each of V variants that do not depend on the torque.

    Of what all share they are made once. The left-hand side comes last, the parameters of the variant before it.

    Args:
        near: what the others leave.
        parts: columns of each variant.
        weights: of the equations (R,).
        here: rows of the variants' joint.
    """
    shared = weights[:, None] * np.column_stack([near.slopes, near.error])
    own = (weights * near.scale)[here, None] * np.stack([np.column_stack([part.linear, -part.fixed]) for part in parts])
    first, more = shared.shape[1], own.shape[2]
    grams = np.empty((len(parts), first + more, first + more))
    grams[:, :first, :first], grams[:, :first, first:] = shared.T @ shared, shared[here].T @ own
    grams[:, first:, :first] = np.swapaxes(grams[:, :first, first:], 1, 2)
    grams[:, first:, first:] = np.swapaxes(own, 1, 2) @ own
    order = [*range(first - 1), *range(first, first + more - 1), first - 1]
    fold = np.eye(first + more)[:, order]
    fold[-1, -1] = 1.0  # what is fixed is on the left-hand side as well
    return np.asarray(fold.T @ grams @ fold)


def squared_errors(grams: Array) -> tuple[Array, Array]:
    """Squared errors (V,) and parameters (V, P) of the fits of V systems from their Gram matrices (V, P + 1, P + 1).

    The equations' left-hand side y comes last.
    """
    scale = np.sqrt(np.maximum(np.diagonal(grams, axis1=1, axis2=2), 1e-300))  # (V, P + 1)
    grams = grams / (scale[:, :, None] * scale[:, None, :])
    normal, target = grams[:, :-1, :-1] + RIDGE * np.eye(grams.shape[1] - 1), grams[:, :-1, -1:]
    theta = np.linalg.solve(normal, target)
    left = 1.0 - 2 * (np.swapaxes(target, 1, 2) @ theta) + np.swapaxes(theta, 1, 2) @ grams[:, :-1, :-1] @ theta
    squares = np.maximum(left[:, 0, 0], 0.0) * scale[:, -1] ** 2
    return squares, theta[:, :, 0] * scale[:, -1:] / scale[:, :-1]
