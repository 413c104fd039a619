"""Candidates: the variant of each effect that fits best beside the terms that a model has.

All shape parameters of an effect are compared through Gram matrices of the windowed equations, so that a fit of many
variants costs one batch of small solves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from estimators.regression.least_squares import RIDGE, Balance, Tangent
from estimators.weak_form.dataset import Dataset
from estimators.weak_form.shapes import Residuals, cross_entropy, gauss_newton, scan
from pendulum_env._typing import Array
from pendulum_env.physics import Term

REACH = 0.03  # of the recording, within which an instant is scanned for
STARTS = 2  # variants of the grid from which a search over shape parameters starts
FOLLOWS = 3  # turns in which a shape parameter is set to the parameter that it follows

NUDGE = 1e-6  # of the largest torque, for slopes by it
PUSHES = np.array([0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0])  # of it, either way, for bent laws of it


class Columns(NamedTuple):
    """Windowed columns of a term, and their slopes by the torque.

    Attributes:
        linear: (R, P).
        fixed: sum of the columns without a parameter (R,) [N m].
        slope: of the linear ones (R, P) [1/(N m)], zero but for effects that depend on the torque.
        taken: what more the fixed ones are under each push of the torque (R, J), where they depend on it at once.
        passed: share of the torque that they leave, if they depend on what it was before.
    """

    linear: Array
    fixed: Array
    slope: Array
    taken: Array | None = None
    passed: float = 1.0


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
    _weights: dict[tuple[Term, ...], Array] = field(default_factory=dict)
    _rates: dict[Term, Array] = field(default_factory=dict)
    _muffled: dict[Term, float] = field(default_factory=dict)
    _ranked: dict[tuple[tuple[Term, ...], str], list[Trial]] = field(default_factory=dict)
    _variants: dict[tuple[tuple[Term, ...], str], list[Trial]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._torque = self.data.net_torque()

    def columns(self, variants: Sequence[Term]) -> list[Columns]:
        """Windowed columns of each variant of one effect."""
        missing = [variant for variant in variants if variant not in self._columns]
        if missing:
            self._columns.update(zip(missing, self._cut(missing), strict=True))
        return [self._columns[variant] for variant in variants]

    def _cut(self, variants: Sequence[Term]) -> list[Columns]:
        nudged = self._nudged.columns(variants) if depends_on_torque(variants[0]) else None
        return columns_by_torque(variants, self.data.columns(variants), nudged, self.data.rows.lost, self.data.torque())

    @cached_property
    def _nudged(self) -> Dataset:
        return self.data.with_more_torque(nudge_of(self.data.torque()))

    def rates(self, terms: Sequence[Term]) -> Array:
        """Time derivatives of the linear columns of some terms (R, P)."""
        for term in terms:
            if term not in self._rates:
                self._rates[term] = self.data.rates(term)
        return np.column_stack([self._rates[term] for term in terms])

    def balance(self, terms: Sequence[Term]) -> Balance:
        """Equations of some terms, recordings of which they leave more unexplained counting less."""
        return self._balance(terms, [self.columns([term])[0] for term in terms], self.weights(terms))

    def weights(self, terms: Sequence[Term]) -> Array:
        """Weight of each equation (R,): of several recordings those count less of which the terms leave more."""
        if len(self.data.windows) == 1 or not terms:
            return self.data.weights
        key = tuple(terms)
        if key not in self._weights:
            balance = self._balance(terms, [self.columns([term])[0] for term in terms], self.data.weights)
            left = balance.error(balance.solve()) ** 2
            owner = self.data.recording_of_window
            level = np.sqrt(np.bincount(owner, left) / np.maximum(np.bincount(owner), 1)) + 1e-300
            self._weights[key] = (level[np.unique(owner)].min() / level)[owner]  # some recordings may have no window
        return self._weights[key]

    def _balance(self, terms: Sequence[Term], parts: Sequence[Columns], w: Array) -> Balance:
        balance = Balance(
            np.column_stack([part.linear for part in parts]),
            self._torque - sum(part.fixed for part in parts),
            np.column_stack([part.slope for part in parts]),
            *_bounds(terms),
            w,
        )
        taken = [part.taken for part in parts if part.taken is not None]
        if taken:
            pushes = np.tile(pushes_of(self.data.torque()), (len(w), 1))
            balance = replace(balance, response=pushes - sum(taken), pushes=pushes)
        lead, passed = sum(term.lead for term in terms), float(np.prod([part.passed for part in parts]))
        if lead > 0:
            others = sum(part.fixed for part, term in zip(parts, terms, strict=True) if not term.lead)
            ahead, loaded = balance.phi + lead * self.rates(terms), self._torque - lead * self._load_rates
            balance = replace(balance, recorded=replace(balance, phi=ahead, y=loaded - others))
        return replace(balance, passed=passed)

    @cached_property
    def _load_rates(self) -> Array:
        return self.data.load_rates()

    def solve(self, terms: Sequence[Term]) -> Array:
        """Linear parameters (P,) of the terms, fitted to all windows."""
        return self.balance(terms).solve()

    def trials(self, terms: Sequence[Term], variants: Sequence[Term]) -> list[Trial]:
        """`terms` with each of V variants of one further effect added, and their errors."""
        shared, w = [self.columns([term])[0] for term in terms], self.weights(terms)
        models = [(*terms, variant) for variant in variants]
        parts = self.columns(variants)

        def exact(model: Sequence[Term], own: Columns) -> float:
            balance = self._balance(model, [*shared, own], w)
            return float(np.sum((w * balance.error(balance.solve())) ** 2))

        if not terms or depends_on_torque(variants[0]) or is_known(*terms, variants[0]):
            squares = np.array([exact(*pair) for pair in zip(models, parts, strict=True)])
        else:
            near = self._balance(terms, shared, w).tangent()
            squares, theta = squared_errors(_grams(near, parts, w))
            theta[:, : len(near.theta)] += near.theta
            least, most = _bounds(models[0])
            for k in np.flatnonzero(np.any((theta < least) | (theta > most), axis=1)):
                squares[k] = exact(models[k], parts[k])
        return [
            Trial(model, float(np.sqrt(square / (w @ w) + self.hidden_noise(model))))
            for model, square in zip(models, squares, strict=True)
        ]

    def trial(self, terms: Sequence[Term]) -> Trial:
        """Errors of one set of terms."""
        *others, last = terms
        return self.trials(others, [last])[0]

    def hidden_noise(self, terms: Sequence[Term]) -> float:
        """Variance of torque noise that terms filter out of the equations [(N m)^2]; it counts as error all the same.

        A lag smooths the noise of the torque channel along with the torque: that must not make it look likelier.
        """
        total = 0.0
        for term in terms:
            if term.fixed and term.has_state() and term not in self._muffled:
                self._muffled[term] = self.data.muffled(term)
            total += self._muffled.get(term, 0.0)
        return total

    def residual(self, terms: Sequence[Term]) -> Array:
        """Torque (R,) that a fit of the terms does not predict [N m]."""
        balance = self.balance(terms)
        return balance.error(balance.solve())

    def variants(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """Best variants of an effect beside the terms, one for each set of shape parameters that are told.

        Those with the fewest come first. Empty where the data offer no variant to try.
        """
        key = (tuple(terms), effect.id)
        if key not in self._variants:
            self._variants[key] = self._search(terms, effect)
        return self._variants[key]

    def ranked(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """The terms with each variant of the grid of an effect, the smallest error first."""
        key = (tuple(terms), effect.id)
        if key not in self._ranked:
            variants = list(effect.grid(self.data.samples, self.residual(terms)))
            trials = self.trials(terms, variants) if variants else []
            self._ranked[key] = sorted(trials, key=lambda trial: trial.fitted_rms)
        return self._ranked[key]

    def _search(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        if effect.rugged:
            return self._searched_one_by_one(terms, effect)
        ranked = self.ranked(terms, effect)
        if all(shape.integer for shape in effect.shapes):
            return ranked[:1]
        sets = dict.fromkeys(trial.terms[-1].free for trial in ranked)
        starts = [[trial for trial in ranked if trial.terms[-1].free == free][:STARTS] for free in sets]
        ends = [min((self.refine(t, effect.id) for t in few), key=lambda trial: trial.fitted_rms) for few in starts]
        return sorted(ends, key=lambda trial: (len(trial.terms[-1].free), trial.fitted_rms))

    def _searched_one_by_one(self, terms: Sequence[Term], effect: type[Term]) -> list[Trial]:
        """The best of the searches from each value of the shape parameter that the error is rugged over."""
        variants = list(effect.grid(self.data.samples, self.residual(terms)))
        if not variants:
            return []
        residuals = self._residuals(terms)
        places = {variant.shape[effect.rugged] for variant in variants}
        niches = [[v for v in variants if v.shape[effect.rugged] == place] for place in sorted(places)]
        found = [self.trial((*terms, cross_entropy(niche, residuals))) for niche in niches]
        best = min(found, key=lambda trial: trial.fitted_rms)
        refined = self.trial((*terms, gauss_newton(best.terms[-1], residuals)))
        return [min(best, refined, key=lambda trial: trial.fitted_rms)]

    def refine(self, trial: Trial, id: str) -> Trial:
        """Search the continuous shape parameters of one term of a trial from where they are."""
        place = next(i for i, term in enumerate(trial.terms) if term.id == id)
        term = trial.terms[place]
        if term.rugged:
            return trial
        others = (*trial.terms[:place], *trial.terms[place + 1 :])
        following = [shape for shape in term.shapes if shape.follows]
        for _ in range(FOLLOWS if following else 0):
            theta = self.solve((*others, term))
            known = dict(zip((c.name for other in others for c in other.columns), theta, strict=False))
            term = replace(term, **{s.name: float(known[s.follows]) for s in following if s.follows in known})
        residuals, time = self._residuals(others), self.data.samples.time
        found = scan(gauss_newton(term, residuals), residuals, REACH * float(np.ptp(time)))
        refined = self.trial((*trial.terms[:place], found, *trial.terms[place + 1 :]))
        worse = refined.fitted_rms > trial.fitted_rms and not following
        return trial if worse or not found.possible(self.data.samples) else refined

    def _residuals(self, terms: Sequence[Term]) -> Residuals:
        """Function that gives the weighted residual (R,) of the best fit of the terms with each of several variants.

        The terms' own columns are projected out once, each variant's then take a small solve.
        """
        shared, w = [self.columns([term])[0] for term in terms], self.weights(terms)
        near = self._balance(terms, shared, w).tangent()
        frame = np.linalg.qr(near.slopes * w[:, None])[0]
        scale = w * near.scale

        def clear(columns: Array) -> Array:
            return np.asarray(columns - frame @ (frame.T @ columns))

        def exact(variant: Term, own: Columns) -> Array:
            balance = self._balance((*terms, variant), [*shared, own], w)
            return w * balance.error(balance.solve())

        def residual(variant: Term, own: Columns) -> Array:
            if depends_on_torque(variant) or is_known(*terms, variant) or not variant.columns:
                return exact(variant, own)
            target, extra = clear(w * near.error - scale * own.fixed), clear(scale[:, None] * own.linear)
            size = np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
            extra = extra / size
            theta = np.linalg.solve(extra.T @ extra + 1e-12 * np.eye(len(size)), extra.T @ target) / size
            least, most = _bounds([variant])
            if np.any((theta < least) | (theta > most)):
                return exact(variant, own)
            return np.asarray(target - (extra * size) @ theta)

        def residuals(variants: Sequence[Term]) -> list[Array]:
            return [residual(*pair) for pair in zip(variants, self._cut(variants), strict=True)]

        return residuals


def nudge_of(torque: Array) -> float:
    """Push of the torque [N m], for slopes by it."""
    return NUDGE * _largest(torque)


def pushes_of(torque: Array) -> Array:
    """Pushes of the torque (J,) [N m], growing, zero in their middle, by which bent laws of it are solved for it."""
    return _largest(torque) * np.concatenate([-PUSHES[::-1], [0.0], PUSHES])


def _largest(torque: Array) -> float:
    return max(float(np.abs(torque).max()), 1e-12)


def columns_by_torque(
    variants: Sequence[Term],
    plain: Sequence[tuple[Array, Array]],
    nudged: Sequence[tuple[Array, Array]] | None,
    lost: Callable[[Term, Array], Array],
    torque: Array,
) -> list[Columns]:
    """Columns of variants of one effect, with how they depend on the torque.

    Args:
        variants: of one effect.
        plain: their linear columns (R, P) and fixed ones (R,).
        nudged: the same under a torque that is larger by `nudge_of` all along; None if they do not depend on it.
        lost: what fixed columns are of a term without memory (R, J) under each of several pushes (J,) [N m].
        torque: as it is (R,) [N m].
    """
    if nudged is None:
        return [Columns(own, fixed, np.zeros_like(own)) for own, fixed in plain]
    slopes = [(more - own) / nudge_of(torque) for (own, _), (more, _) in zip(plain, nudged, strict=True)]
    parts = [Columns(own, fixed, slope) for (own, fixed), slope in zip(plain, slopes, strict=True)]
    if not variants[0].fixed:
        return parts
    if type(variants[0]).has_state():
        whole = float(np.linalg.norm(torque))
        left = [float(np.linalg.norm(torque - part.fixed)) for part in parts]
        return [
            part if variant.delay or rest >= whole else part._replace(passed=max(rest / whole, 1e-12))
            for variant, part, rest in zip(variants, parts, left, strict=True)
        ]
    pushes = pushes_of(torque)
    return [
        part._replace(taken=np.nan_to_num(lost(variant, pushes), nan=0.0, posinf=0.0, neginf=0.0) - part.fixed[:, None])
        for variant, part in zip(variants, parts, strict=True)
    ]


def depends_on_torque(*terms: Term) -> bool:
    """Whether the torque of one of the terms depends on the commanded torque."""
    return any(term.fixed or any(column.of_torque for column in term.columns) for term in terms)


def is_known(*terms: Term) -> bool:
    """Whether a linear parameter of the terms is known, and not to be fitted."""
    return any(column.is_known for term in terms for column in term.columns)


def _bounds(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Bounds of the linear parameters (P,) of some terms."""
    columns = [column for term in terms for column in term.columns]
    return np.array([column.least for column in columns]), np.array([column.most for column in columns])


def _grams(near: Tangent, parts: Sequence[Columns], weights: Array) -> Array:
    """Gram matrices (V, P + 1, P + 1) of fits with each of V variants that do not depend on the torque.

    Of what all share they are made once. The left-hand side comes last, the parameters of the variant before it.
    """
    shared = weights[:, None] * np.column_stack([near.slopes, near.error])
    own = (weights * near.scale)[:, None] * np.stack([np.column_stack([part.linear, -part.fixed]) for part in parts])
    first, more = shared.shape[1], own.shape[2]
    grams = np.empty((len(parts), first + more, first + more))
    grams[:, :first, :first], grams[:, :first, first:] = shared.T @ shared, shared.T @ own
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
