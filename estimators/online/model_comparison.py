"""Comparison of models on the bins of one plant: fits, log predictive densities by block, and e-processes of gains."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from math import ceil

import numpy as np

from estimators.decisions.criterion import Criterion
from estimators.decisions.score import BLOCK as STRETCH
from estimators.findings import Obstacle
from estimators.online.binning import BLOCK, Bin, Bins, PlantBins
from estimators.online.competitors import CompetingModels, thin_variants
from estimators.online.evidence import EProcess, ReferenceDistribution
from estimators.search_hints import is_possible, make_grid
from estimators.signals.differentiation import estimate_scatter
from pendulum_env._typing import Array
from pendulum_env.physics import Term

# chosen on simulated plants by `benchmarks.online_diagnosis`
CALIBRATION_TIME = 1.0  # [s] of motion in the first fit of all models
REFINEMENT_TIMES = (2, 4, 8, 16)  # [s] of motion before a refinement of the grids
FIT_TIME = 16.0  # [s] of motion in the first fit of a later model
N_BLOCKS = 60  # number of latest blocks of a second for the probabilities
BINS_PER_UPDATE = 5  # bins with equations evaluated together
ERROR_TIME = 10.0  # [s] of motion, averaging time of the reported error
MIN_BLOCKS = 5  # blocks of a second for the probabilities; blocks of 0.2 s are used before
MIN_GAIN = 0.01  # [nat] per bin, least gain that counts: errors smaller by 1 %
FORGETTING_TIMES = (1.0, 4.0)  # [s] of motion, memories of the models with forgetting


class ModelComparison:
    """Predictions of the running model, alone, with each effect and with forgetting, for the bins of one plant.

    Attributes:
        terms: terms of the running model.
        fit_bins: bins of the first seconds of motion, to which all models are fitted before they predict.
        not_run: effects that are not run at present, with the reason.
        e_process: e-process of each effect, and in the last place of forgetting.
        blocks: log predictive densities of the last blocks, of the running model, with each effect and with forgetting.
        n_calibration: number of bins in the first fit of all models.
        n_scatter: number of bins from which the scatter of the errors is estimated.
        n_fit: number of bins in the fit of a later model.
        n_predicted: number of bins that the models have predicted.
        n_since_change: number of bins since the evidence of a change began to rise.
        reference: distribution of the gain of forgetting.
    """

    def __init__(
        self,
        terms: Sequence[Term],
        library: Mapping[str, type[Term]],
        plant: PlantBins,
        bins: Sequence[Bin] = (),
        reference: ReferenceDistribution | None = None,
    ) -> None:
        """Begin a comparison of terms with effects of a library; all models are fitted to the kept bins.

        The reference is the distribution of the gain of forgetting, if it is known; the comparison has its own copy.
        """
        self.terms, self._library, self._plant, self.fit_bins = tuple(terms), library, plant, list(bins)
        count = len(plant.joints)
        n_bins = np.bincount([bin_.joint for bin_ in bins], minlength=count)  # of each joint
        self._motion_time = n_bins * plant.length * count  # of each joint [s]
        self._is_tried = np.zeros(count, dtype=bool)  # joints that effects are tried at
        self._scale = np.ones(count)  # of errors at each joint, relative to those of all
        self._stretch_blocks = max(1, round(STRETCH / (BLOCK * plant.length)))  # blocks in a stretch
        self._models: CompetingModels | None = None
        self._waiting_bins: list[Bin] = []  # not yet predicted
        self._block_density: Array | float = 0.0  # log predictive densities in the block to come (F,)
        self._squares: deque[Array] = deque(maxlen=plant.count_bins(ERROR_TIME))
        self.reference = deepcopy(reference) or ReferenceDistribution()
        self.blocks: deque[Array] = deque(maxlen=N_BLOCKS * self._stretch_blocks)
        self.not_run: dict[str, Obstacle] = {}
        self.n_predicted = self.n_since_change = 0
        self.n_calibration = ceil(CALIBRATION_TIME / plant.length)
        self.n_scatter = plant.count_bins(ERROR_TIME)
        self.n_fit = plant.count_bins(FIT_TIME)
        self._fit_when_possible()

    # ---------------------------------------------------------------------------------------------------------- a bin

    def take(self, bin_: Bin) -> bool:
        """Add a bin of motion; return whether a block has ended with it.

        Bins are only kept until all models can be fitted. Later bins are predicted `BINS_PER_UPDATE` at a time. The end
        of a block updates the e-process, and at `REFINEMENT_TIMES` the grids.
        """
        j = bin_.joint
        if self._motion_time[j] < FIT_TIME:
            self.fit_bins.append(bin_)
        self._motion_time[j] += self._plant.length * len(self._motion_time)
        if self._models is None:
            self._fit_when_possible()
            return False
        self._waiting_bins.append(bin_)
        if len(self._waiting_bins) < BINS_PER_UPDATE:
            return False
        bin_densities, squares = self._models.take(self.stack_bins(self._waiting_bins))
        self._waiting_bins = []
        self._squares.extend(squares)
        self._block_density = block = self._block_density + bin_densities.sum(axis=0)
        self.n_predicted += BINS_PER_UPDATE
        if self.n_predicted % BLOCK:
            return False
        self._block_density = 0.0
        self.blocks.append(block)
        gain = block[1:] - block[0]
        gain[-1] = self.reference.take_gain(float(gain[-1]))
        self.e_process.take(gain - MIN_GAIN * BLOCK)
        self.n_since_change = self.n_since_change + BLOCK if self.e_process.log_wealth[-1] > 0 else 0
        if self.is_stretch and len(self.fit_bins) == self.n_predicted + self._n_fitted:  # all bins are kept so far
            if round(len(self.fit_bins) * self._plant.length) in REFINEMENT_TIMES:
                bins = self.stack_bins(self.fit_bins)
                fresh = dict(self._list_variants(CompetingModels(self.terms, bins), bins))
                self._models = self._models.refine(bins, fresh)
        return True

    @property
    def is_stretch(self) -> bool:
        """Return whether a stretch of a second has ended with the last block."""
        return self.n_predicted % (BLOCK * self._stretch_blocks) == 0

    def has_begun_to_move(self, joint: int) -> bool:
        """Return whether a joint has moved long enough to be fitted, but had not when the models were fitted."""
        return self._models is not None and not self._is_tried[joint] and self._motion_time[joint] >= CALIBRATION_TIME

    # ------------------------------------------------------------------------------------------------------ the models

    def stack_bins(self, bins: Sequence[Bin]) -> Bins:
        """Stack several bins."""
        return Bins.stack(bins, self._plant, self._scale)

    def linearise_rows(self, bins: Sequence[Bin]) -> tuple[Array, Array]:
        """Return rows over R bins, linearised at the fitted running model: phi (R, P) and y (R,)."""
        assert self._models is not None
        rows, theta = self.stack_bins(bins).evaluate_running(self.terms), self._models.y_on_base[0]
        return rows.linearise(theta, rows.predict(theta)[0])

    @property
    def effect_evidence(self) -> float:
        """Return the share of the effects in the joint evidence, without forgetting [nat]."""
        return float(np.logaddexp.reduce(self.e_process.log_wealth[:-1]) - np.log(len(self.e_process.log_wealth)))

    @property
    def leaders(self) -> list[tuple[tuple[Term, ...], Array]]:
        """Return the best variant of each effect with its parameters; the running model alone comes first."""
        return [] if self._models is None else self._models.select_best()

    @property
    def error(self) -> float:
        """Return the RMS a-priori error of the running model over the last seconds of motion [N m]."""
        return float(np.sqrt(np.mean(self._squares, axis=0)[0]))

    @property
    def typical_errors(self) -> Array:
        """Return the scaled median error with each effect over the last seconds of motion [N m]."""
        return np.asarray(np.sqrt(np.median(self._squares, axis=0)[1:-1]) / 0.6745)

    @property
    def floor(self) -> float:
        """Return the RMS error by noise and discretisation [N m]; NaN while it is unknown, and of an arm.

        Discretisation leaves a share `Criterion.accuracy` of the torque. A command that changes in each sample looks
        like noise. Therefore, noise of the torque is at most the scatter of the errors from bin to bin, and the floor
        at most the error.
        """
        columns = [column for term in self.terms for column in term.columns]
        if self._models is None or len(self._plant.joints) > 1 or self.fit_bins[0].phi.size:
            return float("nan")
        x, theta = self.stack_bins(self.fit_bins[-BLOCK:]).middle, self._models.y_on_base[0]
        phi, y = self.linearise_rows(self.fit_bins[-self.n_scatter :])
        scatter = estimate_scatter(y - phi @ theta) / self._plant.scatter_gain
        inertia = sum(value * np.mean(column.mass(x)) for column, value in zip(columns, theta, strict=True))
        noise = self.fit_bins[-1]
        noises = np.minimum(noise.torque_noise, scatter), inertia * noise.acceleration_noise
        return float(np.minimum(np.linalg.norm([*noises, Criterion().accuracy * np.std(y)]), self.error))

    @property
    def stretches(self) -> Array:
        """Return log predictive densities (N, F) in blocks of a second; in shorter blocks while these are few."""
        blocks = np.array(self.blocks)
        if len(blocks) < MIN_BLOCKS * self._stretch_blocks:
            return blocks
        whole = blocks[len(blocks) % self._stretch_blocks :]
        return np.asarray(whole.reshape(-1, self._stretch_blocks, blocks.shape[1]).sum(axis=1))

    def compute_best_density(self, blocks: int) -> float:
        """Return the log density of a number of latest blocks under the best model without forgetting [nat]."""
        return float(np.array(self.blocks)[-blocks:, :-1].sum(axis=0).max())

    def _fit_when_possible(self) -> None:
        """Fit all models to the kept bins if these cover `CALIBRATION_TIME`; the models predict from then on.

        With several joints, the error scale of each joint comes from a first fit.
        """
        plant = self._plant
        if len(self.fit_bins) * plant.length < CALIBRATION_TIME:
            return
        self._is_tried = self._motion_time >= 0.5 * CALIBRATION_TIME
        bins = self.stack_bins(self.fit_bins)
        base = CompetingModels(self.terms, bins)
        if len(plant.joints) > 1:
            for joint in {bin_.joint for bin_ in self.fit_bins}:
                residual = base.residual[bins.at == plant.joints[joint]]
                self._scale[joint] = np.sqrt(max(float(np.mean(residual**2)), 1e-12))
            self._scale /= self._scale.mean()
            bins = self.stack_bins(self.fit_bins)
            base = CompetingModels(self.terms, bins)
        variants = {id: grid for id, grid in self._list_variants(base, bins) if grid}
        self.not_run = {
            id: Obstacle.JOINT_AT_REST if self._is_idle(kind) else Obstacle.NO_VARIANT
            for id, kind in self._library.items()
            if id not in variants
        }
        self._n_fitted, self.e_process = len(self.fit_bins), EProcess(len(variants) + 1)
        memories = [seconds / plant.length for seconds in FORGETTING_TIMES]
        self._models = CompetingModels(self.terms, bins, [thin_variants(grid) for grid in variants.values()], memories)

    def _is_idle(self, effect: type[Term]) -> bool:
        """Return whether the joint of an effect has not moved for long enough to be fitted."""
        return not any(self._is_tried[[name == effect.at for name in self._plant.joints]])

    def _list_variants(self, base: CompetingModels, bins: Bins) -> Iterator[tuple[str, list[Term]]]:
        """Yield each effect at a moving joint with its possible variants on a grid.

        Variants with the fewest columns are kept. Parameters that follow one of the model take its value in `base`.
        """
        names = [column.name for term in self.terms for column in term.columns]
        known = dict(zip(names, base.compute_theta()[0].tolist(), strict=False))
        for id, effect in self._library.items():
            if self._is_idle(effect):
                continue
            in_joint = bins.at == effect.at
            x, residual = bins.select_joint(effect.at).middle, (base.residual * bins.scale)[in_joint]
            possible = [term for term in make_grid(effect, x, residual) if is_possible(term, x)]
            fewest = min((len(term.columns) for term in possible), default=0)
            variants = [term for term in possible if len(term.columns) == fewest]  # a batch needs equal numbers
            follows = {s.name: known[s.follows] for s in effect.nonlinear_parameters if s.follows in known}
            yield id, list(dict.fromkeys(replace(term, **follows) for term in variants) if follows else variants)
