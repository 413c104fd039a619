"""Residuals of models, joint by joint: noise or structure, and the share of it that other models explain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.kept import kept
from estimators.regression.least_squares import information, least_squares, robust_covariance
from estimators.search_hints import grid
from estimators.selection.criterion import Criterion
from estimators.selection.data import fit_terms
from estimators.selection.prepared import Comparable
from estimators.weak_form.dataset import Structure
from pendulum_env._typing import Array
from pendulum_env.physics import Term
from pendulum_env.physics.table import ByTime

Terms = tuple[Term, ...]


class Power(NamedTuple):
    """Power of a model's residual at a joint [N^2 m^2]: torque noise absorbed by the model is part of it.

    Attributes:
        all: mean square.
        shared: mean square of the part that neighbouring windows share.
    """

    all: float
    shared: float


@dataclass
class Left:
    """Residuals of models on training and held-out data; results are cached.

    Attributes:
        train: recordings to fit.
        holdout: recordings to predict.
        criterion: what counts as noise.
        base: terms whose fit gives the inertia.
    """

    train: Comparable
    holdout: Comparable
    criterion: Criterion
    base: Terms

    def __post_init__(self) -> None:
        self.parts = (self.train, self.holdout)
        self.joints = self.train.data.joints
        self.inertia = self.train.inertias(self.base)
        self.floors = self.train.floors
        self._unseen = {at: self.holdout.data.part(at).noise(self.inertia[at]) for at in self.joints}

    @kept
    def power(self, terms: Terms) -> list[dict[str, Power]]:
        """Power of a fitted model's residual at each joint, on the training and on the held-out data."""
        found = []
        for part in self.parts:
            if any(isinstance(term, ByTime) for term in terms):
                residual = part.regression.residual(drifting_in(part, terms))
            else:
                residual = part.regression.equations(terms).error(self.train.regression.solve(terms))
            known, powers = self._structures_of(part, residual), {}
            for at in self.joints:
                hidden = part.regression.hidden_noise([term for term in terms if term.at == at])
                own = part.data.part(at).power(residual[part.data.where(at)])
                powers[at] = Power(own + sum(variance for _, variance in hidden), known[at].shared ** 2)
            found.append(powers)
        return found

    @kept
    def structures(self, terms: Terms) -> tuple[dict[str, Structure], dict[str, Structure]]:
        """Structure of the residual at each joint, of the training data and `unseen`."""
        fitted = self._structures_of(self.train, self.train.regression.residual(terms))
        return fitted, self._structures_of(self.holdout, self.unseen(terms))

    def _structures_of(self, part: Comparable, residual: Array) -> dict[str, Structure]:
        data = part.data
        return {at: data.part(at).structure(residual[data.where(at)], self.inertia[at]) for at in self.joints}

    def is_noise(self, part: Comparable, residual: Array) -> bool:
        """Whether a residual (R,) [N m] of the training or of the held-out data is no more than noise."""
        return self._are_noise(part, self._structures_of(part, residual))

    def _are_noise(self, part: Comparable, structures: Mapping[str, Structure]) -> bool:
        return all(self.criterion.is_noise(own, self.noise_of(part, at)) for at, own in structures.items())

    def is_noise_at(self, at: str, terms: Terms) -> bool:
        """Whether the terms leave only noise on the training data of a joint."""
        return self._are_noise(self.train, {at: self.structures(terms)[0][at]})

    @property
    def floor(self) -> float:
        """Torque error due to measurement noise alone, on the training data of the first joint [N m]."""
        return self.noise_of(self.train)

    def noise_of(self, part: Comparable, at: str | None = None) -> float:
        """Torque error due to measurement noise alone [N m]."""
        return (self.floors if part is self.train else self._unseen)[self.joints[0] if at is None else at]

    def are_noise(self, terms: Terms) -> tuple[bool, bool]:
        """Whether the terms leave only noise, on training and on held-out data."""
        first, second = self.structures(terms)
        return self._are_noise(self.train, first), self._are_noise(self.holdout, second)

    def fits(self, terms: Terms) -> bool:
        """Whether the terms leave only noise on all data."""
        return all(self.are_noise(terms))

    def unseen(self, terms: Terms) -> Array:
        """Held-out residual (R,) [N m], with the parameters corrected within their uncertainty.

        The right law has the same parameters in all data. A law that only imitates another along one motion needs
        different ones along the next.
        """
        known, regression = fit_terms(self.train, terms)[1], self.holdout.regression
        balance = regression.balance(terms)
        free = np.flatnonzero(np.diag(known.covariance))  # others are known, or at their bounds
        slopes = balance.slopes(known.theta, regression.shape_jacobian(terms, known.theta)[0])[:, free]
        error, weights = balance.error(known.theta), balance.weights
        step = least_squares(slopes * weights[:, None], error * weights)
        covariance = robust_covariance(
            slopes * weights[:, None], (error - slopes @ step) * weights, self.holdout.data.clusters
        )
        told, asked = information(known.covariance[np.ix_(free, free)]), information(covariance)
        return np.asarray(error - slopes @ least_squares(told + asked, asked @ step))

    def explained(self, after: Terms, before: Terms) -> float:
        """Share of one model's explainable residual power that another explains, the largest over the joints.

        It is the smaller share of training and held-out data. Where the smaller model leaves white noise in training
        data, all of its power is to be explained; held-out data with white noise count only then. Explainable power
        otherwise is the power that the larger model removes, impacts included, plus the power of the rest that
        neighbouring windows share, with a floor set by the number of windows; where that correlation is insignificant,
        all power above the noise floor. The largest, as parameters of the links may imitate an effect at its own joint,
        at the cost of other joints.
        """
        return max(self._explained_at(at, after, before) for at in self.joints)

    def _explained_at(self, at: str, after: Terms, before: Terms) -> float:
        least, shares, structures = self.train.data.part(at).precision() ** 2, [], self.structures(before)
        shown = [
            self.criterion.shows(own[at], self.noise_of(part, at))
            for part, own in zip(self.parts, structures, strict=True)
        ]
        both = zip(self.parts, self.power(before), self.power(after), structures, shown, strict=True)
        for part, lefts, less, own, shows in both:
            old, new = lefts[at], less[at]
            gone = old.all - new.all
            if not shows and part is self.holdout and shown[0]:
                continue
            if gone <= least:
                shares.append(0.0)
            elif not shows:
                shares.append(gone / old.all)
            elif own[at].sure >= self.criterion.sure:
                shares.append(gone / (gone + new.shared + new.all / len(part.data.part(at).weights) ** 0.5))
            else:
                shares.append(gone / max(old.all - self.noise_of(part, at) ** 2, gone))
        return min(shares)

    def explains(self, after: Terms, before: Terms) -> bool:
        """Whether that share is large enough to add an effect."""
        return self.explained(after, before) > self.criterion.share


def drifting_in(part: Comparable, terms: Sequence[Term]) -> Terms:
    """The terms with functions of time on a grid that covers some data."""
    return tuple(grid(type(t), part.samples, np.empty(0))[0] if isinstance(t, ByTime) else t for t in terms)
