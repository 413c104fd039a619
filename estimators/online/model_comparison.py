"""Comparison of models on the bins of one plant: fits, log predictive densities by block, and e-processes of gains."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from estimators.data.rows import BLOCK as STRETCH
from estimators.findings import Obstacle
from estimators.online.binning import BLOCK, Bin, Bins
from estimators.online.competitors import ONLINE, CompetingModels, thin_variants
from estimators.online.evidence import EProcess, ReferenceDistribution
from estimators.search_hints import is_possible, make_grid
from pendulum_env._typing import Array
from pendulum_env.physics import Term


@dataclass(frozen=True)
class PlantBins:
    """Joints of a plant and times of its bins.

    Attributes:
        joints: by name.
        length: time of motion that a bin stands for; each joint has its own bins [s].
        period: between samples [s].
    """

    joints: tuple[str, ...]
    length: float
    period: float

    def bins_in(self, seconds: float) -> int:
        """Return the number of bins in a time of motion [s]."""
        return round(seconds / self.length)

    @property
    def fit_bins(self) -> int:
        """Number of bins in the fit of a later model."""
        return self.bins_in(ONLINE.fit_time)

    @property
    def calibration_bins(self) -> int:
        """Number of bins in the first fit of all models."""
        return ceil(ONLINE.calibration_time / self.length)


class ModelComparison:
    """Predictions of the running model, alone, with each effect and with forgetting, for the bins of one plant.

    Attributes:
        terms: of the running model.
        fit_bins: bins of the first seconds of motion, to which all models are fitted before they predict.
        not_run: effects that are not run for now, with the reason.
        e_process: on each effect and, in the last place, on forgetting.
        blocks: log predictive densities of the last blocks, of the running model, with each effect and with forgetting.
        n_predicted: number of bins that the models have predicted.
        n_since_change: number of bins since the evidence of a change began to rise.
        reference: distribution of the gain of forgetting.
    """

    def __init__(
        self,
        terms: Sequence[Term],
        library: Mapping[str, type[Term]],
        plant: PlantBins,
        kept: Sequence[Bin] = (),
        reference: ReferenceDistribution | None = None,
    ) -> None:
        """Begin a comparison of terms with effects of a library; all models are fitted to the kept bins.

        The reference is the distribution of the gain of forgetting, if it is known; the comparison has its own copy.
        """
        self.terms, self._library, self._plant, self.fit_bins = tuple(terms), library, plant, list(kept)
        count = len(plant.joints)
        self._moved = np.bincount([one.joint for one in kept], minlength=count) * plant.length * count  # each joint [s]
        self._tried = np.zeros(count, dtype=bool)  # joints that effects are tried at
        self._scale = np.ones(count)  # of errors at each joint, relative to those of all
        self._often = max(1, round(STRETCH / (BLOCK * plant.length)))  # blocks in a stretch
        self._models: CompetingModels | None = None
        self._waiting: list[Bin] = []  # to be taken together
        self._block: Array | float = 0.0  # log predictive densities in the block to come (F,)
        self._errors: deque[float] = deque(maxlen=plant.bins_in(ONLINE.error_time))
        self.reference = deepcopy(reference) or ReferenceDistribution()
        self.blocks: deque[Array] = deque(maxlen=ONLINE.n_blocks * self._often)
        self.not_run: dict[str, Obstacle] = {}
        self.n_predicted = self.n_since_change = 0
        self._fit_when_possible()

    # ---------------------------------------------------------------------------------------------------------- a bin

    def take(self, one: Bin) -> bool:
        """Add a bin of motion; return whether a block has ended with it."""
        j = one.joint
        if self._moved[j] < ONLINE.fit_time:
            self.fit_bins.append(one)
        self._moved[j] += self._plant.length * len(self._moved)
        if self._models is None:
            self._fit_when_possible()
            return False
        self._waiting.append(one)
        if len(self._waiting) < ONLINE.bins_per_update:
            return False
        densities, errors = self._models.take(self.bins(self._waiting))
        self._waiting = []
        self._errors.extend(errors.tolist())
        self._block = block = self._block + densities.sum(axis=0)
        self.n_predicted += ONLINE.bins_per_update
        if self.n_predicted % BLOCK:
            return False
        self._block = 0.0
        self.blocks.append(block)
        gain = block[1:] - block[0]
        gain[-1] = self.reference.excess(float(gain[-1]))
        self.e_process.take(gain - ONLINE.min_gain * BLOCK)
        self.n_since_change = self.n_since_change + BLOCK if self.e_process.log_wealth[-1] > 0 else 0
        if self.is_stretch and len(self.fit_bins) == self.n_predicted + self._fitted:  # all bins are kept so far
            if round(len(self.fit_bins) * self._plant.length) in ONLINE.refinement_times:
                bins = self.bins(self.fit_bins)
                self._models = self._models.refine(bins, dict(self._grids(CompetingModels(self.terms, bins), bins)))
        return True

    @property
    def is_stretch(self) -> bool:
        """Return whether a stretch of a second has ended with the last block."""
        return self.n_predicted % (BLOCK * self._often) == 0

    def has_begun_to_move(self, joint: int) -> bool:
        """Return whether a joint has moved for long enough that had not when the models were fitted."""
        return self._models is not None and not self._tried[joint] and self._moved[joint] >= ONLINE.calibration_time

    # ------------------------------------------------------------------------------------------------------ the models

    def bins(self, bins: Sequence[Bin]) -> Bins:
        """Stack several bins."""
        return Bins.stack(bins, self._plant.period, self._plant.joints, self._scale)

    def linearise_rows(self, bins: Sequence[Bin]) -> tuple[Array, Array]:
        """Return rows of the running model, which has been fitted, over R bins: phi (R, P) and y (R,)."""
        assert self._models is not None
        return self._models.running_rows(self.bins(bins))

    @property
    def effect_evidence(self) -> float:
        """Return the share of the effects in the joint evidence, forgetting aside [nat]."""
        return float(np.logaddexp.reduce(self.e_process.log_wealth[:-1]) - np.log(len(self.e_process.log_wealth)))

    @property
    def leaders(self) -> list[tuple[tuple[Term, ...], Array]]:
        """Return the best variant of each effect, and parameters; those of the running model alone come first."""
        return [] if self._models is None else self._models.leaders()

    @property
    def error(self) -> float:
        """Return the RMS a-priori error of the running model over the last seconds of motion [N m]."""
        return float(np.sqrt(np.mean(np.square(list(self._errors)))))

    @property
    def stretches(self) -> Array:
        """Return log predictive densities (N, F) in blocks of a second, in shorter ones while there are few."""
        blocks = np.array(self.blocks)
        if len(blocks) < ONLINE.min_blocks * self._often:
            return blocks
        return np.asarray(blocks[len(blocks) % self._often :].reshape(-1, self._often, blocks.shape[1]).sum(axis=1))

    def best_density(self, blocks: int) -> float:
        """Return the log density of the last blocks under the best model, forgetting aside [nat]."""
        return float(np.array(self.blocks)[-blocks:, :-1].sum(axis=0).max())

    def _fit_when_possible(self) -> None:
        """Fit all models to the kept bins if there are enough; the models predict from then on."""
        plant = self._plant
        if len(self.fit_bins) * plant.length < ONLINE.calibration_time:
            return
        self._tried = self._moved >= 0.5 * ONLINE.calibration_time
        bins = self.bins(self.fit_bins)
        base = CompetingModels(self.terms, bins)
        if len(plant.joints) > 1:
            for joint in {one.joint for one in self.fit_bins}:
                own = base.residual[bins.at == plant.joints[joint]]
                self._scale[joint] = np.sqrt(max(float(np.mean(own**2)), 1e-12))
            self._scale /= self._scale.mean()
            bins = self.bins(self.fit_bins)
            base = CompetingModels(self.terms, bins)
        variants = {id: own for id, own in self._grids(base, bins) if own}
        self.not_run = {
            id: Obstacle.JOINT_AT_REST if self._is_idle(kind) else Obstacle.NO_VARIANT
            for id, kind in self._library.items()
            if id not in variants
        }
        self._fitted, self.e_process = len(self.fit_bins), EProcess(len(variants) + 1)
        memories = [seconds / plant.length for seconds in ONLINE.forgetting_times]
        self._models = CompetingModels(self.terms, bins, [thin_variants(own) for own in variants.values()], memories)

    def _is_idle(self, effect: type[Term]) -> bool:
        """Return whether an effect's joint has not moved for long enough."""
        return not any(self._tried[[name == effect.at for name in self._plant.joints]])

    def _grids(self, base: CompetingModels, bins: Bins) -> Iterator[tuple[str, list[Term]]]:
        """Yield the possible variants of each effect, by the residuals of a model on bins."""
        names = [column.name for term in self.terms for column in term.columns]
        known = dict(zip(names, base.theta_of()[0].tolist(), strict=False))
        for id, effect in self._library.items():
            if self._is_idle(effect):
                continue
            own = bins.at == effect.at
            x, residual = bins.select_joint(effect.at).middle, (base.residual * bins.scale)[own]
            possible = [term for term in make_grid(effect, x, residual) if is_possible(term, x)]
            fewest = min((len(term.columns) for term in possible), default=0)
            variants = [term for term in possible if len(term.columns) == fewest]  # a batch has as many in all of it
            follows = {s.name: known[s.follows] for s in effect.nonlinear_parameters if s.follows in known}
            yield id, list(dict.fromkeys(replace(term, **follows) for term in variants) if follows else variants)
