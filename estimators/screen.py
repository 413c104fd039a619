"""Screening: how much of the unexplained torque would each effect explain, on data it was not fitted to?

All candidates and all their shape parameters are compared through Gram matrices of the windowed equations, one per
block of time, so that a cross-validated error costs a few small solves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.least_squares import block_grams, cross_validate
from estimators.shapes import continuous, cross_entropy, gauss_newton
from estimators.windows import Dataset
from pendulum_env._typing import Array
from pendulum_env.physics import Term

STARTS = 3  # variants of the grid from which a search over shape parameters starts
FOLLOWS = 3  # turns in which a shape parameter is set to the parameter that it follows

Columns = tuple[Array, Array]  # windowed linear columns (R, P) and the sum of fixed columns (R,)


@dataclass(frozen=True)
class Trial:
    """A set of terms with its errors on the training data [N m]: fitted, and of blocks predicted from the others."""

    terms: tuple[Term, ...]
    fitted_rms: float
    predicted_rms: float


@dataclass
class Screen:
    """Trials of term sets on one dataset; what was evaluated once is kept."""

    data: Dataset
    _columns: dict[Term, Columns] = field(default_factory=dict)
    _best: dict[tuple[tuple[Term, ...], str], Trial | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._torque = self.data.torque()
        self._normal = float(np.sum(self.data.weights**2))

    def columns(self, variants: Sequence[Term]) -> list[Columns]:
        """Windowed columns of each variant of one effect."""
        missing = [variant for variant in variants if variant not in self._columns]
        if missing:
            self._columns.update(zip(missing, self.data.columns(missing), strict=True))
        return [self._columns[variant] for variant in variants]

    def shared(self, terms: Sequence[Term]) -> tuple[Array, Array]:
        """Columns (R, P) of several terms side by side, and the torque (R,) that they have to explain."""
        parts = [self.columns([term])[0] for term in terms]
        return np.column_stack([phi for phi, _ in parts]), self._torque - sum(fixed for _, fixed in parts)

    def _gain(self, y: Array) -> float:
        """Factor that makes residuals comparable: a law that takes torque away must not win by leaving nothing."""
        return float(np.linalg.norm(self._torque)) / max(float(np.linalg.norm(y)), 1e-12)

    def _judge(self, systems: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
        """Fitted and predicted mean squared errors (V,) of V systems (phi, y)."""
        weighted = np.stack([np.column_stack(system) for system in systems]) * self.data.weights[None, :, None]
        fitted, predicted = cross_validate(block_grams(weighted, self.data.blocks))
        gain = np.array([self._gain(y) ** 2 for _, y in systems]) / self._normal
        return np.asarray(gain * fitted), np.asarray(gain * predicted)

    def trials(self, terms: Sequence[Term], variants: Sequence[Term]) -> list[Trial]:
        """Errors of `terms` with each of V variants of one further effect added."""
        phi, y = self.shared(terms)
        systems = [(np.column_stack([phi, own]), y - fixed) for own, fixed in self.columns(variants)]
        errors = zip(variants, *self._judge(systems), strict=True)
        hidden = self._hidden_noise(terms)
        return [self._trial((*terms, v), f, p, hidden + self._hidden_noise([v])) for v, f, p in errors]

    def trial(self, terms: Sequence[Term]) -> Trial:
        """Errors of one set of terms."""
        fitted, predicted = self._judge([self.shared(terms)])
        return self._trial(tuple(terms), fitted[0], predicted[0], self._hidden_noise(terms))

    @staticmethod
    def _trial(terms: tuple[Term, ...], fitted: float, predicted: float, hidden: float) -> Trial:
        return Trial(terms, float(np.sqrt(max(fitted + hidden, 0.0))), float(np.sqrt(max(predicted + hidden, 0.0))))

    def _hidden_noise(self, terms: Sequence[Term]) -> float:
        """Variance of torque noise that terms filter out of the equations [(N m)^2]; it counts as error all the same.

        A lag smooths the noise of the torque channel along with the torque: that must not make it look likelier.
        """
        return sum(self.data.muffled(term) for term in terms if term.fixed and type(term).start is not Term.start)

    def project(self, phi: Array, y: Array) -> tuple[Array, Array]:
        """Weighted residual (R,) of y after a fit of phi, and the parameters (P,)."""
        w = self.data.weights
        theta = np.linalg.lstsq(phi * w[:, None], y * w, rcond=1e-10)[0]
        return (y - phi @ theta) * w, np.asarray(theta)

    def residual(self, terms: Sequence[Term]) -> Array:
        """Unexplained torque (R,) after a fit of the terms [N m]."""
        residual, _ = self.project(*self.shared(terms))
        return np.asarray(residual / self.data.weights)

    def best(self, terms: Sequence[Term], effect: type[Term]) -> Trial | None:
        """Best variant of an effect beside the terms; None where the data offer no variant to try."""
        key = (tuple(terms), effect.id)
        if key not in self._best:
            self._best[key] = self._search(terms, effect)
        return self._best[key]

    def _search(self, terms: Sequence[Term], effect: type[Term]) -> Trial | None:
        variants = list(effect.grid(self.data.samples, self.residual(terms)))
        if not variants:
            return None
        if effect.rugged:
            phi, y = self.shared(terms)

            def errors(drawn: Sequence[Term]) -> list[float]:
                return [float(np.linalg.norm(r)) for r in self._residuals(phi, y, drawn)]

            return self.trial((*terms, cross_entropy(variants, errors)))
        ranked = sorted(self.trials(terms, variants), key=lambda trial: trial.fitted_rms)
        if not effect.shapes or not (continuous(effect) or any(shape.follows for shape in effect.shapes)):
            return ranked[0]
        return min((self.refine(trial, effect.id) for trial in ranked[:STARTS]), key=lambda trial: trial.fitted_rms)

    def refine(self, trial: Trial, id: str) -> Trial:
        """Search the continuous shape parameters of one term of a trial from where they are."""
        place = next(i for i, term in enumerate(trial.terms) if term.id == id)
        term = trial.terms[place]
        if term.rugged:
            return trial
        others = (*trial.terms[:place], *trial.terms[place + 1 :])
        phi, y = self.shared(others)
        following = [shape for shape in term.shapes if shape.follows]
        for _ in range(FOLLOWS if following else 0):
            own, fixed = self.data.columns([term])[0]
            _, theta = self.project(np.column_stack([phi, own]), y - fixed)
            known = dict(zip((c.name for other in others for c in other.columns), theta, strict=False))
            term = replace(term, **{s.name: float(known[s.follows]) for s in following if s.follows in known})
        term = gauss_newton(term, lambda variants: self._residuals(phi, y, variants))
        refined = self.trial((*trial.terms[:place], term, *trial.terms[place + 1 :]))
        return refined if following or refined.fitted_rms <= trial.fitted_rms else trial

    def _residuals(self, phi: Array, y: Array, variants: Sequence[Term]) -> list[Array]:
        """Weighted residuals (R,) of y after a fit of phi with each variant; not kept, they are many."""
        columns = self.data.columns(variants)
        return [
            self._gain(y - fixed) * self.project(np.column_stack([phi, own]), y - fixed)[0] for own, fixed in columns
        ]
