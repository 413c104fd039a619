"""Residuals of models, joint by joint: noise or structure, and the share of it that a larger model explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, cast

import numpy as np

from estimators.checks.closed_loop import find_feedback, have_one_frequency
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.data.removed_noise import list_absorbed_noise
from estimators.decisions.criterion import Criterion, ResidualStructure
from estimators.decisions.errors import Terms
from estimators.decisions.gate import Gate
from estimators.memoize import memoized
from estimators.regression.least_squares import solve_least_squares
from estimators.search_hints import make_grid
from estimators.selection.process_noise import ProcessNoise, find_process_noise
from pendulum_env._typing import Array
from pendulum_env.physics import Table, Term, list_ids


class Power(NamedTuple):
    """Power of a model's residual at a joint [N^2 m^2].

    Attributes:
        total: mean square, plus the variance of torque noise that the model removes.
        correlated: mean square of the part that neighbouring windows share.
    """

    total: float
    correlated: float


@dataclass
class Residuals:
    """Residuals of models on training and held-out data; results are memoised.

    Attributes:
        train: data to fit.
        holdout: data to predict.
        criterion: limits of noise.
        base: terms of the fit that gives the inertia.
    """

    train: RegressionData
    holdout: RegressionData
    criterion: Criterion
    base: Terms

    def __post_init__(self) -> None:
        self.parts = (self.train, self.holdout)
        self.joints = tuple(self.train.layout.joints)
        self.inertia = self.train.inertias(self.base)
        self.floors = self.train.floors
        self._is_pendulum = self.train.layout.predicts_torque and self.joints == ("",)  # torque of one joint
        self._recordings = [*self.train.recordings, *self.holdout.recordings]
        self.holdout_floors = {at: self.holdout.layout.noise(at, self.inertia[at]) for at in self.joints}

    def noise_floor(self, part: RegressionData | None = None, at: str | None = None) -> float:
        """Return the noise floor of a part of the data at a joint [N m], by default the training data, first joint."""
        return (self.holdout_floors if part is self.holdout else self.floors)[self.joints[0] if at is None else at]

    @memoized
    def structures(self, terms: Terms) -> tuple[dict[str, ResidualStructure], dict[str, ResidualStructure]]:
        """Return the structure of a fit's residual at each joint, on training and on held-out data."""
        of_train = self._structures_in(self.train, self.train.residual(terms))
        return of_train, self._structures_in(self.holdout, self.holdout_residual(terms))

    def _structures_in(self, part: RegressionData, residual: Array) -> dict[str, ResidualStructure]:
        """Return the structure at each joint of a residual (R,) [N m] of a part of the data."""
        layout = part.layout
        return {at: layout.structure(at, residual[layout.joints[at]], self.inertia[at]) for at in self.joints}

    def is_noise(self, terms: Terms) -> bool:
        """Return whether the residual of a fit is noise at every joint, on all data."""
        return all(self.is_noise_by_part(terms))

    def is_noise_by_part(self, terms: Terms) -> tuple[bool, bool]:
        """Return whether the residual of a fit is noise at every joint, on training and on held-out data."""
        train, holdout = (
            self._are_noise(part, structures)
            for part, structures in zip(self.parts, self.structures(terms), strict=True)
        )
        return train, holdout

    def is_noise_at(self, at: str, terms: Terms) -> bool:
        """Return whether the residual of a fit is noise at a joint, on the training data."""
        return self._are_noise(self.train, {at: self.structures(terms)[0][at]})

    def is_noise_in(self, part: RegressionData, residual: Array) -> bool:
        """Return whether a residual (R,) [N m] of one part of the data is noise at every joint.

        The noise of a pendulum is that of its sensors, or white torque noise that is not logged.
        """
        is_noise = self._are_noise(part, self._structures_in(part, residual))
        return is_noise or self.find_process_noise(part, residual) is not None

    def find_process_noise(self, part: RegressionData, residual: Array) -> ProcessNoise | None:
        """Return the torque noise of a part that is not logged, if a residual (R,) [N m] shows that; else None.

        The residual exceeds the noise of the sensors, and is white.
        """
        if not self._is_pendulum or self._are_noise(part, self._structures_in(part, residual)):
            return None
        return find_process_noise(part.data, residual, self.inertia[self.joints[0]], self.criterion)

    def _are_noise(self, part: RegressionData, structures: Mapping[str, ResidualStructure]) -> bool:
        """Return whether residuals of a part of the data, by joint, are noise at every joint."""
        return all(
            self.criterion.is_noise(structure, self.noise_floor(part, at)) for at, structure in structures.items()
        )

    def relative_rms(self, terms: Terms) -> float:
        """Return the residual of a fit over its noise floor, the largest over joints, training and held-out data."""
        pairs = zip(self.parts, self.structures(terms), strict=True)
        return max(
            structure.rms / max(self.noise_floor(part, at), 1e-300)
            for part, structures in pairs
            for at, structure in structures.items()
        )

    def make_loop_gates(self, after: Terms, before: Terms) -> list[Gate]:
        """Return the gate of a lag or delay that a larger model adds, if the motion may not determine it.

        In motion of one frequency it is not determined (`frequencies`). In a closed loop its residual must be noise:
        the controller reacts to each torque that the model lacks, and a lag or delay fits this reaction.
        """
        ids = list_ids(before)
        if not any((term.lead or term.delay) and term.id not in ids for term in after):
            return []
        if self.has_one_frequency:
            return [Gate("frequencies", 1, 2, False)]
        if not self.has_feedback:
            return []
        size, limit = self.relative_rms(after), self.criterion.misfit
        return [Gate("residual_in_loop", size, limit, size <= limit)]

    @cached_property
    def has_one_frequency(self) -> bool:
        """Return whether a pendulum moves at one frequency in all recordings; rows of positions are not tested."""
        return self._is_pendulum and have_one_frequency(self._recordings)

    @cached_property
    def has_feedback(self) -> bool:
        """Return whether the recorded torque of a pendulum reacts to the motion; simulated rows depend on goals."""
        return self._is_pendulum and bool(find_feedback(self._recordings))

    def holdout_residual(self, terms: Terms) -> Array:
        """Return the held-out residual (R,) [N m], with the parameters of the fit updated by the held-out data.

        The update is the least squares fit to both parts, to first order; each part is weighted by its residual. So
        parameters that the training data poorly determine cause no residual. Covariances by clusters would be singular:
        an arm has more parameters than a short recording has clusters. Tables by angle that do not cover the held-out
        data are refitted to them.
        """
        if self.are_refitted(terms) and all(term.axis == "position" for term in terms if isinstance(term, Table)):
            return self.holdout.residual(set_grid(self.holdout, terms))
        fit, rows, targets = fit_terms(self.train, terms)[1], list[Array](), list[Array]()
        free = np.flatnonzero(np.diag(fit.covariance))  # others are known, or at their bounds
        for part in self.parts:
            balance = part.equations(terms)
            slopes = balance.slopes(fit.theta, part.maker.nonlinear_jacobian(terms, fit.theta)[0])[:, free]
            error = balance.error(fit.theta)
            weights = balance.weights / max(float(np.sqrt(np.mean((error * balance.weights) ** 2))), 1e-150)
            rows.append(slopes * weights[:, None])
            targets.append(error * weights)
        return np.asarray(error - slopes @ solve_least_squares(np.concatenate(rows), np.concatenate(targets)))

    def are_refitted(self, terms: Terms) -> bool:
        """Return whether terms have a table that does not cover the held-out data."""
        tables = [term for term in terms if isinstance(term, Table)]
        return not all(table.covers(self.holdout.data.part(table.at).samples) for table in tables)

    @memoized
    def power(self, terms: Terms) -> list[dict[str, Power]]:
        """Return the power of a fit's residual at each joint, on training and on held-out data.

        Tables that do not cover the held-out data are refitted to each.
        """
        powers_by_part = []
        for part in self.parts:
            if self.are_refitted(terms):
                residual = part.residual(set_grid(part, terms))
            else:
                residual = part.equations(terms, by_noise=True).error(self.train.solve(terms))
            structures, powers = self._structures_in(part, residual), {}
            for at in self.joints:
                absorbed = list_absorbed_noise(part, [term for term in terms if term.at == at])
                total = structures[at].rms ** 2 + sum(variance for _, variance in absorbed)
                powers[at] = Power(total, structures[at].correlated_rms ** 2)
            powers_by_part.append(powers)
        return powers_by_part

    def explained_share(self, after: Terms, before: Terms, above_floor: bool = False) -> float:
        """Return the share of one model's explainable residual power that a larger model explains, at its best joint.

        The share is the smaller of training and held-out data. Explainable power is

        - all power, if the residual of the smaller model has no structure;
        - removed power + correlated power of the rest + power of the rest / sqrt(number of rows), if its
          neighbouring windows are correlated;
        - all power above the noise floor otherwise, or with `above_floor`.

        Held-out data without structure do not count if the training data have structure. Removed power below the
        precision of the rows counts as zero. Joints other than the best may lose by a compensation of link parameters.
        """
        return max(self._explained_at(at, after, before, above_floor) for at in self.joints)

    def _explained_at(self, at: str, after: Terms, before: Terms, above_floor: bool) -> float:
        """Return the `explained_share` at a joint."""
        least, shares, structures = self.train.layout.precision[at] ** 2, [], self.structures(before)
        structured = [
            self.criterion.has_structure(of_part[at], self.noise_floor(part, at))
            for part, of_part in zip(self.parts, structures, strict=True)
        ]
        parts = zip(self.parts, self.power(before), self.power(after), structures, structured, strict=True)
        for part, olds, news, of_part, has_structure in parts:
            old, new = olds[at], news[at]
            removed = old.total - new.total
            if not has_structure and part is self.holdout and structured[0]:
                continue
            if removed <= least:
                shares.append(0.0)
            elif not has_structure:
                shares.append(removed / old.total)
            elif of_part[at].z_score >= self.criterion.z_score and not above_floor:
                resolution = new.total / len(part.layout.clusters[part.locate_rows(at)]) ** 0.5
                shares.append(removed / (removed + new.correlated + resolution))
            else:
                shares.append(removed / max(old.total - self.noise_floor(part, at) ** 2, removed))
        return min(shares)


def set_grid(part: RegressionData, terms: Sequence[Term]) -> Terms:
    """Return the terms with each table that does not cover some data on a grid that does."""
    terms_on_grid = list[Term]()
    for term in terms:
        if isinstance(term, Table) and not term.covers(x := part.data.part(term.at).samples):
            grid = [cast(Table, table) for table in make_grid(type(term), x, np.empty(0))[::-1]]
            same_size, count = [table for table in grid if table.extent.pieces == term.extent.pieces], len(term.columns)
            nearest = min(same_size[:1] or grid, key=lambda table: abs(len(table.columns) - count), default=None)
            others = [other for other in terms if other is not term]
            term = term if nearest is None else nearest.without_known_functions(others)
        terms_on_grid.append(term)
    return tuple(terms_on_grid)
