"""Residuals of models, joint by joint: noise or structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from estimators.checks.closed_loop import find_feedback, have_one_frequency
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.decisions.criterion import Criterion, ResidualStructure, is_noise
from estimators.decisions.errors import Terms
from estimators.memoize import memoized
from estimators.regression.least_squares import solve_least_squares
from estimators.search_hints import make_grid
from estimators.selection.process_noise import ProcessNoise, find_process_noise
from pendulum_env._typing import Array
from pendulum_env.physics import Table, Term


@dataclass(eq=False, repr=False)
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
        self._is_pendulum = self.train.layout.predicts_torque and self.joints == ("",)  # torque of one joint
        self.holdout_floors = {at: self.holdout.layout.noise(at, self.inertia[at]) for at in self.joints}

    def noise_floor(self, part: RegressionData | None = None, at: str | None = None) -> float:
        """Return the noise floor of a part of the data at a joint [N m], by default the training data, first joint."""
        return (self.holdout_floors if part is self.holdout else self.train.floors)[
            self.joints[0] if at is None else at
        ]

    @memoized
    def structures(self, terms: Terms) -> tuple[dict[str, ResidualStructure], dict[str, ResidualStructure]]:
        """Return the structure of a fit's residual at each joint, on training and on held-out data."""
        of_train = self.find_structures(self.train, self.train.residual(terms))
        return of_train, self.find_structures(self.holdout, self.holdout_residual(terms))

    def find_structures(self, part: RegressionData, residual: Array) -> dict[str, ResidualStructure]:
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
        is_noise = self._are_noise(part, self.find_structures(part, residual))
        return is_noise or self.find_process_noise(part, residual) is not None

    def find_process_noise(self, part: RegressionData, residual: Array) -> ProcessNoise | None:
        """Return the torque noise of a part that is not logged, if a residual (R,) [N m] shows that; else None.

        The residual exceeds the noise of the sensors, and is white.
        """
        if not self._is_pendulum or self._are_noise(part, self.find_structures(part, residual)):
            return None
        return find_process_noise(part.data, residual, self.inertia[self.joints[0]], self.criterion.white)

    def _are_noise(self, part: RegressionData, structures: Mapping[str, ResidualStructure]) -> bool:
        """Return whether residuals of a part of the data, by joint, are noise at every joint."""
        return all(
            is_noise(structure, self.noise_floor(part, at), self.criterion) for at, structure in structures.items()
        )

    def relative_rms(self, terms: Terms) -> float:
        """Return the residual of a fit over its noise floor, the largest over joints, training and held-out data."""
        pairs = zip(self.parts, self.structures(terms), strict=True)
        return max(
            structure.rms / max(self.noise_floor(part, at), 1e-300)
            for part, structures in pairs
            for at, structure in structures.items()
        )

    @cached_property
    def has_one_frequency(self) -> bool:
        """Return whether a pendulum moves at one frequency in all recordings; rows of positions are not tested."""
        recordings = [*self.train.recordings, *self.holdout.recordings]
        return self._is_pendulum and have_one_frequency(recordings, self.criterion)

    @cached_property
    def has_feedback(self) -> bool:
        """Return whether the recorded torque of a pendulum reacts to the motion; simulated rows have a reference."""
        recordings = [*self.train.recordings, *self.holdout.recordings]
        return self._is_pendulum and bool(find_feedback(recordings, self.criterion))

    def holdout_residual(self, terms: Terms) -> Array:
        """Return the held-out residual (R,) [N m], with the parameters of the fit updated by the held-out data.

        The update is the least squares fit to both parts, to first order; each part is weighted by its residual. So
        parameters that the training data poorly determine cause no residual. Covariances by clusters would be singular:
        links have more parameters than a short recording has clusters. Tables by angle that do not cover the held-out
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
