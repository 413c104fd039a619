"""Screening: how much of the unexplained torque would each effect explain, on data it was not fitted to?

All candidates and all their shape parameters are compared through Gram matrices of the windowed equations, one per
block of time, so that a cross-validated error costs a few small solves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.dataset import Dataset
from estimators.least_squares import block_grams, cross_validate
from estimators.shapes import Residuals, cross_entropy, freed, gauss_newton, scan
from pendulum_env._typing import Array
from pendulum_env.physics import Term

REACH = 0.03  # of the recording, within which an instant is scanned for
STARTS = 2  # variants of the grid from which a search over shape parameters starts
CALL = 10.0  # nats by which data have to call for an unusual value of a shape parameter
FOLLOWS = 3  # turns in which a shape parameter is set to the parameter that it follows

Columns = tuple[Array, Array]  # windowed linear columns (R, P) and the sum of fixed columns (R,)


@dataclass(frozen=True)
class Trial:
    """A set of terms with its errors on the training data [N m]: fitted, and of blocks predicted from the others.

    Both count the torque noise that the terms filter out, of variance `hidden` [(N m)^2].
    """

    terms: tuple[Term, ...]
    fitted_rms: float
    predicted_rms: float
    hidden: float = 0.0


@dataclass
class Screen:
    """Trials of term sets on one dataset; what was evaluated once is kept."""

    data: Dataset
    _columns: dict[Term, Columns] = field(default_factory=dict)
    _muffled: dict[Term, float] = field(default_factory=dict)
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

    def _gain(self, terms: Sequence[Term], phi: Array, y: Array, theta: Array) -> float:
        """Factor that makes residuals comparable: a law must not win by explaining torque with torque.

        Residuals count relative to the torque that motion has to explain: what fixed columns and columns proportional
        to the torque leave of it.
        """
        of_torque = [column.of_torque for term in terms for column in term.columns]
        left = y - phi[:, of_torque] @ theta[of_torque] if any(of_torque) else y
        return float(np.linalg.norm(self._torque)) / max(float(np.linalg.norm(left)), 1e-12)

    def _judge(self, systems: Sequence[tuple[Sequence[Term], Array, Array]]) -> list[Trial]:
        """Fitted and predicted errors of V systems (terms, phi, y)."""
        stacked = np.stack([np.column_stack([phi, y]) for _, phi, y in systems]) * self.data.weights[None, :, None]
        fitted, predicted, solutions = cross_validate(block_grams(stacked, self.data.blocks))
        trials = []
        for (terms, phi, y), theta, *squares in zip(systems, solutions, fitted, predicted, strict=True):
            gain, hidden = self._gain(terms, phi, y, theta) ** 2 / self._normal, self._hidden_noise(terms)
            rms = [float(np.sqrt(max(gain * square + hidden, 0.0))) for square in squares]
            trials.append(Trial(tuple(terms), rms[0], rms[1], hidden))
        return trials

    def nats(self, better: Trial, worse: Trial) -> float:
        """Log likelihood ratio of two trials from their cross-validated errors."""
        count = len(self.data.weights)
        return count * float(np.log(max(worse.predicted_rms, 1e-12) / max(better.predicted_rms, 1e-12)))

    def trials(self, terms: Sequence[Term], variants: Sequence[Term]) -> list[Trial]:
        """Errors of `terms` with each of V variants of one further effect added."""
        phi, y = self.shared(terms)
        columns = self.columns(variants)
        return self._judge(
            [
                ((*terms, variant), np.column_stack([phi, own]), y - fixed)
                for variant, (own, fixed) in zip(variants, columns, strict=True)
            ]
        )

    def trial(self, terms: Sequence[Term]) -> Trial:
        """Errors of one set of terms."""
        return self._judge([(terms, *self.shared(terms))])[0]

    def _hidden_noise(self, terms: Sequence[Term]) -> float:
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
            residuals = self._residuals(terms)
            places = {variant.shape[effect.rugged] for variant in variants}
            niches = [[v for v in variants if v.shape[effect.rugged] == place] for place in sorted(places)]
            found = [self.trial((*terms, cross_entropy(niche, residuals))) for niche in niches]
            best = min(found, key=lambda trial: trial.fitted_rms)
            refined = self.trial((*terms, gauss_newton(best.terms[-1], residuals)))
            return min(best, refined, key=lambda trial: trial.fitted_rms)
        ranked = sorted(self.trials(terms, variants), key=lambda trial: trial.fitted_rms)
        if all(shape.integer for shape in effect.shapes):
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
        residuals, time = self._residuals(others), self.data.samples.time

        def with_its(term: Term) -> Trial:
            return self.trial((*trial.terms[:place], term, *trial.terms[place + 1 :]))

        refined = with_its(scan(gauss_newton(term, residuals), residuals, REACH * float(np.ptp(time))))
        if not following and refined.fitted_rms > trial.fitted_rms:
            refined = trial
        unusual = freed(refined.terms[place])
        if unusual is not None:
            other = with_its(gauss_newton(unusual, residuals))
            return other if self.nats(other, refined) > CALL else refined
        return refined

    def _residuals(self, terms: Sequence[Term]) -> Residuals:
        """Function that gives the weighted residual (R,) of the best fit of the terms with each of several variants.

        The terms' own columns are projected out once, each variant's then take a small solve.
        """
        phi, y = self.shared(terms)
        w = self.data.weights
        frame, _ = np.linalg.qr(phi * w[:, None])

        def clear(columns: Array) -> Array:
            return np.asarray(columns - frame @ (frame.T @ columns))

        def residuals(variants: Sequence[Term]) -> list[Array]:
            left = []
            for variant, (own, fixed) in zip(variants, self.data.columns(variants), strict=True):
                target, extra = clear((y - fixed) * w), clear(own * w[:, None])
                size = np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
                extra = extra / size
                theta = np.linalg.solve(extra.T @ extra + 1e-12 * np.eye(len(size)), extra.T @ target)
                gain = 1.0
                if any(column.of_torque for term in (*terms, variant) for column in term.columns) or variant.fixed:
                    full = np.column_stack([phi, own])
                    gain = self._gain((*terms, variant), full, y - fixed, self.project(full, y - fixed)[1])
                left.append(gain * (target - extra @ theta))
            return left

        return residuals
