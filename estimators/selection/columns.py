"""Windowed columns of variants of effects, computed once, with their slopes by the torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from estimators.memoize import memoized
from estimators.regression.balance import Columns
from estimators.weak_form.dataset import Dataset
from pendulum_env._typing import Array
from pendulum_env.physics import Term

PERTURBATION = 1e-6  # of the largest torque, for slopes by it
PUSHES = np.array([0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0])  # of it, either way, for bent laws of it


@dataclass
class ColumnCutter:
    """Columns of terms on the windows of a dataset; results are memoised."""

    data: Dataset
    _known: dict[Term, Columns] = field(default_factory=dict)

    @memoized
    def _of_joint(self, joint: str) -> ColumnCutter:
        return ColumnCutter(self.data.part(joint))

    def at(self, joint: str) -> ColumnCutter:
        """Return the columns on the data of a joint; of all joints for a term without one joint."""
        return self if self.data.part(joint) is self.data else self._of_joint(joint)

    def columns(self, variants: Sequence[Term]) -> list[Columns]:
        """Return the windowed columns of each variant of one effect, on the rows of its joint."""
        if (own := self.at(variants[0].at)) is not self:
            return own.columns(variants)
        missing = [variant for variant in variants if variant not in self._known]
        if missing:
            self._known.update(zip(missing, self.cut(missing), strict=True))
        return [self._known[variant] for variant in variants]

    def cut(self, variants: Sequence[Term]) -> list[Columns]:
        """Return the columns of variants that a search meets only once: they are not memoised."""
        if (own := self.at(variants[0].at)) is not self:
            return own.cut(variants)
        plain, kind, torque = self.data.columns(variants), variants[0], self.data.torque()
        if not depends_on_torque(kind):
            return [Columns(own, fixed, np.zeros_like(own)) for own, fixed in plain]
        push = PERTURBATION * _largest(torque)
        pairs = zip(plain, self._perturbed.columns(variants), strict=True)
        slopes = [(more - own) / push for (own, _), (more, _) in pairs]
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
        lost = [self.data.rows.lost(own, self._pushes) for own in variants]
        return [
            part._replace(taken=np.nan_to_num(more, nan=0.0, posinf=0.0, neginf=0.0) - part.fixed[:, None])
            for part, more in zip(parts, lost, strict=True)
        ]

    @cached_property
    def _perturbed(self) -> Dataset:
        return self.data.with_more_torque(PERTURBATION * _largest(self.data.torque()))

    @memoized
    def rates(self, term: Term) -> Array:
        """Return time derivatives of the linear columns of a term (R, P), on the rows of its joint."""
        return self.data.rates(term)

    @property
    def _pushes(self) -> Array:
        """Increasing perturbations of the torque (J,) [N m], zero in the middle, to solve nonlinear laws for it."""
        return _largest(self.data.torque()) * np.concatenate([-PUSHES[::-1], [0.0], PUSHES])

    @cached_property
    def pushes(self) -> Array:
        """Perturbations of the torque in each equation of all joints (R, J) [N m]."""
        joints = [self.at(at) for at in self.data.joints]
        return np.concatenate([np.tile(own._pushes, (len(own.data.weights), 1)) for own in joints])


def _largest(torque: Array) -> float:
    return max(float(np.abs(torque).max()), 1e-12)


def depends_on_torque(*terms: Term) -> bool:
    """Return whether the torque of one of the terms depends on the commanded torque."""
    return any(term.fixed or any(column.of_torque for column in term.columns) for term in terms)


def is_known(*terms: Term) -> bool:
    """Return whether a linear parameter of the terms is given, and not to be fitted."""
    return any(column.is_known for term in terms for column in term.columns)


def bounds(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Return lower and upper bounds of the linear parameters of some terms, (P,) each."""
    columns = [column for term in terms for column in term.columns]
    return np.array([column.least for column in columns]), np.array([column.most for column in columns])
