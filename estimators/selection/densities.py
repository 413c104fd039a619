"""Log predictive densities of blocks of time under a model, and the gain in density of one model over another."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.data.removed_noise import compute_removed_noise, list_absorbed_noise
from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Terms
from estimators.decisions.score import Bootstrap, Gain, cross_validate_density, predict_density
from estimators.memoize import memoized
from estimators.selection.fits import Fits
from estimators.selection.residuals import Residuals, set_grid
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Model, Table, Term


@dataclass(eq=False, repr=False)
class Densities:
    """Log densities of each block under models, those of the training data first, (S,) [nat]; results are memoised.

    Attributes:
        fits: fits of terms to the data.
        residuals: residuals of the same fits.
        criterion: limits of decisions.
        bootstrap: random weights of all blocks.
    """

    fits: Fits
    residuals: Residuals
    criterion: Criterion
    bootstrap: Bootstrap

    @cached_property
    def held_out(self) -> slice:
        """Blocks that belong to held-out data."""
        return slice(len(self.fits.train.layout.scored.of_block), None)

    @memoized
    def compute(self, terms: Terms) -> Array:
        """Return the log predictive density of each block.

        Tables that do not cover the held-out data, as functions of time, are refitted to each part of the data. A model
        with lags has the density of the recorded torque, unless that is significantly better than the acting torque
        without any one lag: then that of the acting torque. So a filter that only reduces the torque has no gain.
        """
        if self.residuals.are_refitted(terms):
            return self.compute_refitted(terms)
        of_torque, (first, second) = self._compute_of_torque(terms), [part.layout.scored for part in self.fits.parts]
        train, holdout = (part.equations(terms, by_noise=True).unfiltered for part in self.fits.parts)
        if train is not None and holdout is not None:
            weighted_equations = replace(train, weights=self.fits.train.equations(terms).weights)
            recorded = np.concatenate(
                [
                    cross_validate_density(weighted_equations, first),
                    predict_density(weighted_equations.solve(), holdout, second),
                ]
            )
            for lag in (term for term in terms if term.lead):
                without = tuple(other for other in terms if other is not lag)
                has_lags = any(other.lead for other in without)
                acting = self.compute(without) if has_lags else self._compute_of_torque(without, lag)
                if self.bootstrap.gain(recorded, acting).p_value > self.criterion.p_value:
                    return recorded
        return of_torque

    def _compute_of_torque(self, terms: Terms, without: Term | None = None) -> Array:
        """Return the log density of each block (S,) [nat], by the residual of the acting torque.

        For a comparison with a model that has a lag `without`, the noise of the torque's derivative times the lag's
        time constant is added at its joint.
        """
        parts = self.fits.parts
        absorbed = [list_absorbed_noise(part, terms) for part in parts]
        if without is not None:
            inertia = self.residuals.inertia[without.at or self.residuals.joints[0]]
            for of_part, part in zip(absorbed, parts, strict=True):
                noise = [w.noise.compute_rate_std(inertia) for w in part.data.part(without.at).windows]
                of_part.append((part.locate_rows(without.at), float(np.mean(np.square(noise))) * without.lead**2))
        fits, inertias = self.fits.train.maker.fit_folds(terms), self.residuals.inertia
        removed = [compute_removed_noise(part, fits.terms, fits.theta, inertias) for part in parts]
        (train_rows, first), (holdout_rows, second) = (
            (part.equations(terms, by_noise=True), part.layout.scored) for part in parts
        )
        return np.concatenate(
            [
                cross_validate_density(train_rows, first, absorbed[0], fits.theta_without_fold, removed[0]),
                predict_density(fits.theta, holdout_rows, second, absorbed[1], removed[1]),
            ]
        )

    @memoized
    def compute_refitted(self, terms: Terms) -> Array:
        """Return the cross-validated log density of each block, those of the training data first, (S,) [nat].

        Training and held-out data are fitted separately, since drift differs between them; tables that do not cover the
        held-out data get a grid over each. Folds are pieces of `criterion.drift_piece` seconds, from which a drift can
        be predicted.
        """
        parts = []
        for part in self.fits.parts:
            terms_on_grid = set_grid(part, terms)
            equations, pieces = part.equations(terms_on_grid), part.layout.make_blocks(self.criterion.drift_piece)
            parts.append(cross_validate_density(equations, pieces, list_absorbed_noise(part, terms_on_grid)))
        return np.concatenate(parts)

    def compare(self, after: Terms, before: Terms) -> tuple[Bootstrap, list[Array]]:
        """Return random weights of the blocks by which two models are compared, and the densities of both there.

        If the models differ in a table by angle that covers the held-out angles, only held-out data count. Folds of the
        training data may lack the angles of the part that they predict, and this part alone would decide.
        """
        has_table = any(isinstance(term, Table) and term.axis == "position" for term in set(after) ^ set(before))
        if has_table and not any(map(self.residuals.are_refitted, (after, before))):
            return self.compare_held_out(after, before)
        return self.bootstrap, self._compute_pair(after, before)

    def compare_held_out(self, after: Terms, before: Terms) -> tuple[Bootstrap, list[Array]]:
        """Return random weights of the held-out blocks, and the densities of two models there."""
        return self._bootstrap_of_holdout, [density[self.held_out] for density in self._compute_pair(after, before)]

    def _compute_pair(self, after: Terms, before: Terms) -> list[Array]:
        """Return the densities of two models; both are refitted to each part of the data if one of them must be."""
        is_refitted = any(map(self.residuals.are_refitted, (after, before)))
        return [(self.compute_refitted if is_refitted else self.compute)(terms) for terms in (after, before)]

    @cached_property
    def _bootstrap_of_holdout(self) -> Bootstrap:
        """Random weights of the held-out blocks alone."""
        return Bootstrap(self.bootstrap.of_block[self.held_out])

    def predict_held_out(self, model: Model) -> Array:
        """Return the log density of each held-out block (S,) under the parameters of a model [nat]."""
        holdout, terms, theta = self.fits.list_parts(model)[1], model.terms, np.asarray(model.theta)
        rows, absorbed = holdout.equations(terms, by_noise=True), list_absorbed_noise(holdout, terms)
        removed = compute_removed_noise(holdout, terms, theta, self.residuals.inertia)
        return predict_density(theta, rows, holdout.layout.scored, absorbed, removed)

    def compare_parameters(self, after: Array, before: Array) -> Gain:
        """Return the gain of parameters over others, from their `predict_held_out`."""
        return self._bootstrap_of_holdout.gain(after, before)

    def sum_held_out(self, terms: Terms) -> float:
        """Return the log density of the held-out data [nat]."""
        return float(np.sum(self.compute(terms)[self.held_out]))


def number_recordings(fits: Fits) -> Index:
    """Return the recording of each block (S,), in which held-out parts of fitted recordings belong to these."""
    of_train, of_holdout = (part.layout.scored.of_block for part in fits.parts)
    is_split = fits.train.recordings == fits.holdout.recordings  # parts of the same recordings
    return np.concatenate([of_train, of_holdout if is_split else of_holdout + of_train.max() + 1])
