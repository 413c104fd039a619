"""Candidates: the variant of each effect that fits best beside the terms that a model has.

All shape parameters of an effect are compared through Gram matrices of the windowed equations, so that a fit of many
variants costs one batch of small solves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from estimators.regression.least_squares import RIDGE, Balance
from estimators.weak_form.dataset import Dataset
from estimators.weak_form.shapes import Residuals, cross_entropy, gauss_newton, scan
from pendulum_env._typing import Array
from pendulum_env.physics import Term

REACH = 0.03  # of the recording, within which an instant is scanned for
STARTS = 2  # variants of the grid from which a search over shape parameters starts
FOLLOWS = 3  # turns in which a shape parameter is set to the parameter that it follows

NUDGE = 1e-6  # of the largest torque, for slopes by it


class Columns(NamedTuple):
    """Windowed columns of a term, and their slopes by the torque.

    Attributes:
        linear: (R, P).
        fixed: sum of the columns without a parameter (R,) [N m].
        linear_slope: (R, P) [1/(N m)], zero but for effects that depend on the torque.
        fixed_slope: (R,).
    """

    linear: Array
    fixed: Array
    linear_slope: Array
    fixed_slope: Array


@dataclass(frozen=True)
class Trial:
    """A set of terms with the torque error of its fit [N m], which counts the torque noise that they filter out."""

    terms: tuple[Term, ...]
    fitted_rms: float


@dataclass
class Screen:
    """Trials of term sets on one dataset; what was evaluated once is kept."""

    data: Dataset
    _columns: dict[Term, Columns] = field(default_factory=dict)
    _weights: dict[tuple[Term, ...], Array] = field(default_factory=dict)
    _muffled: dict[Term, float] = field(default_factory=dict)
    _ranked: dict[tuple[tuple[Term, ...], str], list[Trial]] = field(default_factory=dict)
    _variants: dict[tuple[tuple[Term, ...], str], list[Trial]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._torque = self.data.net_torque()
        self._nudge = NUDGE * max(float(np.abs(self.data.torque()).max()), 1e-12)
        self._nudged = self.data.with_more_torque(self._nudge)

    def columns(self, variants: Sequence[Term]) -> list[Columns]:
        """Windowed columns of each variant of one effect."""
        missing = [variant for variant in variants if variant not in self._columns]
        if missing:
            self._columns.update(zip(missing, self._cut(missing), strict=True))
        return [self._columns[variant] for variant in variants]

    def _cut(self, variants: Sequence[Term]) -> list[Columns]:
        columns = self.data.columns(variants)
        if not depends_on_torque(variants[0]):
            return [Columns(own, fixed, np.zeros_like(own), np.zeros_like(fixed)) for own, fixed in columns]
        pairs = zip(columns, self._nudged.columns(variants), strict=True)
        return [
            Columns(own, fixed, (more - own) / self._nudge, (moved - fixed) / self._nudge)
            for (own, fixed), (more, moved) in pairs
        ]

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
        columns = [column for term in terms for column in term.columns]
        return Balance(
            np.column_stack([part.linear for part in parts]),
            self._torque - sum(part.fixed for part in parts),
            np.column_stack([part.linear_slope for part in parts]),
            1.0 - sum((part.fixed_slope for part in parts), np.zeros(len(w))),
            np.array([column.least for column in columns]),
            np.array([column.most for column in columns]),
            w,
        )

    def solve(self, terms: Sequence[Term]) -> Array:
        """Linear parameters (P,) of the terms, fitted to all windows."""
        return self.balance(terms).solve()

    def trials(self, terms: Sequence[Term], variants: Sequence[Term]) -> list[Trial]:
        """`terms` with each of V variants of one further effect added, and their errors."""
        shared = [self.columns([term])[0] for term in terms]
        models = [(*terms, variant) for variant in variants]
        pairs = zip(models, self.columns(variants), strict=True)
        w = self.weights(terms)
        balances = [self._balance(model, [*shared, own], w) for model, own in pairs]
        if depends_on_torque(*terms, variants[0]) or is_known(*terms, variants[0]):
            errors = [w * balance.error(balance.solve()) for balance in balances]
            squares = np.array([error @ error for error in errors])
        else:
            stacked = w[None, :, None] * np.stack([np.column_stack([own.phi, own.y]) for own in balances])
            squares, theta = squared_errors(np.swapaxes(stacked, 1, 2) @ stacked)
            for k, balance in enumerate(balances):
                if np.any((theta[k] < balance.least) | (theta[k] > balance.most)):
                    squares[k] = np.sum((w * balance.error(balance.solve())) ** 2)
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

        A lag smooths the noise of the torque channel along with the torque, and saturation flattens it: that must not
        make them look likelier.
        """
        total = 0.0
        for term in terms:
            if term.fixed and term not in self._muffled:
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
        shared = [self.columns([term])[0] for term in terms]
        w = self.weights(terms)
        frame = np.linalg.qr(np.column_stack([own.linear for own in shared]) * w[:, None])[0]

        def clear(columns: Array) -> Array:
            return np.asarray(columns - frame @ (frame.T @ columns))

        def linear(balance: Balance, count: int) -> Array:
            target, extra = clear(w * balance.y), clear(w[:, None] * balance.phi[:, balance.phi.shape[1] - count :])
            size = np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
            extra = extra / size
            theta = np.linalg.solve(extra.T @ extra + 1e-12 * np.eye(len(size)), extra.T @ target)
            if np.any((theta < balance.least[-count:] * size) | (theta > balance.most[-count:] * size)):
                return w * balance.error(balance.solve())
            return np.asarray(target - extra @ theta)

        def residual(variant: Term, own: Columns) -> Array:
            balance = self._balance((*terms, variant), [*shared, own], w)
            if balance.by_torque.any() or (balance.passed != 1.0).any() or is_known(*terms, variant):
                return w * balance.error(balance.solve())
            # a lag takes torque away: what is left has to be explained as well as all of it would be
            taken = float(np.linalg.norm(self._torque)) / max(float(np.linalg.norm(balance.y)), 1e-12)
            return (taken if own.fixed.any() else 1.0) * linear(balance, own.linear.shape[1])

        def residuals(variants: Sequence[Term]) -> list[Array]:
            return [residual(*pair) for pair in zip(variants, self._cut(variants), strict=True)]

        return residuals


def depends_on_torque(*terms: Term) -> bool:
    """Whether the torque of one of the terms depends on the commanded torque."""
    return any(term.fixed or any(column.of_torque for column in term.columns) for term in terms)


def is_known(*terms: Term) -> bool:
    """Whether a linear parameter of the terms is known, and not to be fitted."""
    return any(column.is_known for term in terms for column in term.columns)


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
