"""Screening of effects: the best-fitting variant of each beside the terms of a model.

All nonlinear parameters of an effect are compared through Gram matrices of the windowed equations, so that
a fit of many variants costs one batch of small solves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from estimators.memoize import memoized
from estimators.regression.balance import Balance, Columns, Tangent
from estimators.regression.least_squares import RIDGE
from estimators.search_hints import grid, hints_of, is_possible, n_tried
from estimators.selection.columns import bounds, depends_on_torque, is_known
from estimators.selection.prepared import Trial
from estimators.selection.regression import Regression
from estimators.weak_form.dataset import Dataset
from estimators.weak_form.nonlinear import Residuals, cross_entropy, refined, scan
from pendulum_env._typing import Array
from pendulum_env.physics import Term
from pendulum_env.physics.table import Table
from pendulum_env.physics.terms import complexity


@dataclass(frozen=True)
class ScreenSettings:
    """Extent of the search for the best variant of an effect."""

    starts: int = 2  # variants of the grid from which a search over nonlinear parameters starts
    exact: int = 3  # most promising variants of a law of the torque, which are fitted exactly
    reach: float = 0.03  # of the recording, range of the scan for an instant
    follows: int = 3  # iterations that set a nonlinear parameter to the parameter that it follows


SCREEN = ScreenSettings()


@dataclass(eq=False)
class Screen:
    """Variants of effects beside the terms of a model, with the errors of their fits to one dataset.

    Attributes:
        regression: fits of sets of terms to the data.
    """

    regression: Regression

    @property
    def data(self) -> Dataset:
        """Windows of recordings."""
        return self.regression.data

    def trials(self, terms: Sequence[Term], variants: Sequence[Term]) -> list[Trial]:
        """Fit the terms with each of V variants of one further effect."""
        w, here = self.regression.weights(terms), self.data.where(variants[0].at)
        models = [(*terms, variant) for variant in variants]
        parts = self.regression.columns(variants)
        beside = cache(lambda: self.regression.beside(terms, here))  # most variants do without

        def exact(variant: Term, own: Columns) -> float:
            return beside()(variant, own).least_squared()

        if not terms or variants[0].fixed or is_known(*terms, variants[0]):
            squares = np.array([exact(*pair) for pair in zip(variants, parts, strict=True)])
        else:
            near = self.regression.tangent(terms)
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
        """Return squared errors (V,) of variants that scale with the torque, exact for the best of them.

        The best are those of the fit with the recorded torque, and of the fit with the predicted torque.
        """
        here = self.data.where(pairs[0][0].at)
        moved = [own._replace(linear=own.linear - near.error[here, None] * own.slope) for _, own in pairs]
        promises = (plain, squared_errors(_grams(near, moved, w, here))[0])
        tried = np.unique([np.argsort(promise)[: SCREEN.exact] for promise in promises])
        squares = np.array([exact(*pairs[k]) for k in tried.tolist()])
        found = np.maximum(plain, squares.min())
        found[tried] = squares
        return found

    def trial(self, terms: Sequence[Term]) -> Trial:
        """Fit one set of terms."""
        *others, last = terms
        return self.trials(others, [last])[0]

    def _hidden_in_all(self, terms: Sequence[Term], w: Array) -> float:
        """Return the torque noise that terms absorb, mean over all weighted equations (R,) [(N m)^2]."""
        return sum(
            float(w[here] @ w[here]) * variance for here, variance in self.regression.absorbed_noise(terms)
        ) / float(w @ w)

    @memoized
    def variants(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """Best variants of an effect beside the terms, one for each set of nonlinear parameters that are told.

        Variants with the fewest parameters come first. Empty where the data offer no variant.
        """
        if hints_of(effect).multimodal:
            return self._searched_one_by_one(terms, effect)
        return best_of_forms(self.ranked(terms, effect), effect, self.refine)

    @memoized
    def ranked(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """Fit the terms with each variant of the grid of an effect, the smallest error first."""
        return ranked(self.trials, terms, self.grid(terms, effect))

    def grid(self, terms: Sequence[Term], effect: type[Term]) -> list[Term]:
        """Return variants of an effect beside the terms, from which a search starts."""
        found = grid(
            effect, self.data.part(effect.at).samples, self.regression.residual(terms)[self.data.where(effect.at)]
        )
        return [variant.beside(terms) if isinstance(variant, Table) else variant for variant in found]

    @memoized
    def n_tried(self, terms: Sequence[Term], effect: type[Term]) -> int:
        """Return the number of variants among which `grid` chose."""
        x, here = self.data.part(effect.at).samples, self.data.where(effect.at)
        return n_tried(effect, x, self.regression.residual(terms)[here])

    def _searched_one_by_one(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """Search from each grid value of the parameter over which the error is multimodal, and return the best."""
        variants = self.grid(terms, effect)
        if not variants:
            return []
        residuals = self._residuals(terms)
        name = hints_of(effect).multimodal
        places = {variant.nonlinear_values[name] for variant in variants}
        basins = [[v for v in variants if v.nonlinear_values[name] == place] for place in sorted(places)]
        found = [self.trial((*terms, cross_entropy(basin, residuals))) for basin in basins]
        best = min(found, key=lambda trial: trial.fitted_rms)
        closer = self.trial((*terms, refined(best.terms[-1], residuals)))
        return [min(best, closer, key=lambda trial: trial.fitted_rms)]

    def refine(self, trial: Trial, id: str) -> Trial:
        """Search the continuous nonlinear parameters of one term of a trial from their values."""
        place = next(i for i, term in enumerate(trial.terms) if term.id == id)
        term = trial.terms[place]
        if hints_of(type(term)).multimodal:
            return trial
        others = (*trial.terms[:place], *trial.terms[place + 1 :])
        following = [parameter for parameter in term.nonlinear_parameters if parameter.follows]
        for _ in range(SCREEN.follows if following else 0):
            theta = self.regression.solve((*others, term))
            known = dict(zip((c.name for other in others for c in other.columns), theta, strict=False))
            term = replace(term, **{s.name: float(known[s.follows]) for s in following if s.follows in known})
        residuals, samples = self._residuals(others), self.data.part(term.at).samples
        found = scan(refined(term, residuals), residuals, SCREEN.reach * float(np.ptp(samples.time)))
        closer = self.trial((*trial.terms[:place], found, *trial.terms[place + 1 :]))
        worse = closer.fitted_rms > trial.fitted_rms and not following
        return trial if worse or not is_possible(found, samples) else closer

    def _residuals(self, terms: Sequence[Term]) -> Residuals:
        """Return a function that gives the weighted residual (R,) of the best fit of the terms with each variant.

        The columns of the terms are projected out once; each variant then takes a small solve.
        """
        shared, w = self.regression.parts(terms), self.regression.weights(terms)
        near, frame = self.regression.tangent(terms), self.regression.frame(terms)
        scale = w * near.scale

        def clear(columns: Array, here: slice) -> Array:
            cleared = -frame @ (frame[here].T @ columns)
            cleared[here] += columns
            return np.asarray(cleared)

        left = clear(w * near.error, slice(None))

        beside = cache(lambda at: self.regression.beside(terms, self.data.where(at)))

        def exact(balance: Balance) -> Array:
            return balance.weights * balance.error(balance.solve())

        def residual(variant: Term, own: Columns) -> Array:
            if is_known(*terms, variant) or not variant.columns:
                return exact(self.regression.assemble((*terms, variant), [*shared, own], w))
            here = self.data.where(variant.at)
            target = left if not variant.fixed else left - clear(scale[here] * own.fixed, here)
            extra = clear(scale[here, None] * own.linear, here)
            size = np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
            extra = extra / size
            theta = np.linalg.solve(extra.T @ extra + 1e-12 * np.eye(len(size)), extra.T @ target) / size
            least, most = bounds([variant])
            if np.any((theta < least) | (theta > most)):
                return exact(self.regression.assemble((*terms, variant), [*shared, own], w))
            return np.asarray(target - (extra * size) @ theta)

        def residuals(variants: Sequence[Term]) -> list[Array]:
            pairs = list(zip(variants, self.regression.cut(variants), strict=True))
            if not depends_on_torque(variants[0]):
                return [residual(*pair) for pair in pairs]
            return [exact(beside(variants[0].at)(*pair)) for pair in pairs]

        return residuals


def ranked(
    trials: Callable[[Sequence[Term], Sequence[Term]], list[Trial]], terms: Sequence[Term], variants: Sequence[Term]
) -> list[Trial]:
    """Fit the terms with each variant of an effect, the smallest error first.

    Variants of one effect may differ in class, or in the number of columns.
    """
    kinds: dict[tuple[type[Term], int], list[Term]] = {}
    for variant in variants:
        kinds.setdefault((type(variant), len(variant.columns)), []).append(variant)
    return sorted((one for same in kinds.values() for one in trials(terms, same)), key=lambda trial: trial.fitted_rms)


def best_of_forms(ranked: Sequence[Trial], effect: type[Term], refine: Callable[[Trial, str], Trial]) -> list[Trial]:
    """Refine the best trials of each form of an effect, and return the best of each, the simplest form first."""
    if len(ranked) < 2:
        return list(ranked)
    forms: dict[object, list[Trial]] = {}
    for trial in ranked:
        last = trial.terms[-1]
        forms.setdefault((last.free, len(last.columns)), []).append(trial)
    sought = effect.nonlinear_parameters
    whole = bool(sought) and all(known.integer for known in sought)  # there is nothing to refine
    ends = [
        few[0] if whole else min((refine(t, effect.id) for t in few[: SCREEN.starts]), key=lambda one: one.fitted_rms)
        for few in forms.values()
    ]
    return sorted(ends, key=lambda trial: (complexity(trial.terms[-1]), trial.fitted_rms))


def _grams(near: Tangent, parts: Sequence[Columns], weights: Array, here: slice) -> Array:
    """Return Gram matrices (V, P + 1, P + 1) of fits with each of V variants that do not depend on the torque.

    The left-hand side comes last, the parameters of the variant before it.

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
    """Return squared errors (V,) and parameters (V, P) of V fits from their Gram matrices (V, P + 1, P + 1).

    The equations' left-hand side y comes last.
    """
    scale = np.sqrt(np.maximum(np.diagonal(grams, axis1=1, axis2=2), 1e-300))  # (V, P + 1)
    grams = grams / (scale[:, :, None] * scale[:, None, :])
    normal, target = grams[:, :-1, :-1] + RIDGE * np.eye(grams.shape[1] - 1), grams[:, :-1, -1:]
    theta = np.linalg.solve(normal, target)
    left = 1.0 - 2 * (np.swapaxes(target, 1, 2) @ theta) + np.swapaxes(theta, 1, 2) @ grams[:, :-1, :-1] @ theta
    squares = np.maximum(left[:, 0, 0], 0.0) * scale[:, -1] ** 2
    return squares, theta[:, :, 0] * scale[:, -1:] / scale[:, :-1]
