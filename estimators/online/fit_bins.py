"""Bins of the first seconds of motion, to which models are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np

from estimators.online.binning import Bin, Bins, PlantBins
from estimators.online.competitors import CompetingModels
from estimators.online.settings import ONLINE
from estimators.online.work import Work
from pendulum_env._typing import Mask
from pendulum_env.physics import Term


class FitBins:
    """Bins of the first seconds of motion of each joint.

    Attributes:
        bins: the bins, in the order of time.
        is_tried: mask of the joints at which effects are tried (J,); all before the first fit.
        n_needed: number of bins in the first fit of all models.
        n_most: number of bins in the longest fit.
    """

    def __init__(self, plant: PlantBins, bins: Sequence[Bin] = ()) -> None:
        """Begin with kept bins of a plant."""
        self._plant, self.bins = plant, list(bins)
        count, models = len(plant.joints), ONLINE.models
        self._motion_time = np.bincount([bin_.joint for bin_ in bins], minlength=count) * plant.length * count  # [s]
        self.is_tried: Mask = np.ones(count, dtype=bool)
        self.n_needed, self.n_most = ceil(models.calibration / plant.length), plant.count_bins(models.fit_time)
        self._scale = np.ones(count)  # of errors at each joint, relative to those of all

    def take(self, bin_: Bin) -> None:
        """Keep a bin if its joint has moved only briefly."""
        if self._motion_time[bin_.joint] < ONLINE.models.fit_time:
            self.bins.append(bin_)
        self._motion_time[bin_.joint] += self._plant.length * len(self._motion_time)

    def are_sufficient(self) -> bool:
        """Return whether the bins suffice for the first fit of all models."""
        return len(self.bins) * self._plant.length >= ONLINE.models.calibration

    def has_begun_to_move(self, joint: int) -> bool:
        """Return whether a joint has moved long enough to be fitted, but had not when the models were fitted."""
        return bool(not self.is_tried[joint] and self._motion_time[joint] >= ONLINE.models.calibration)

    def is_idle(self, effect: type[Term]) -> bool:
        """Return whether the joint of an effect has not moved for long enough to be fitted."""
        return not any(self.is_tried[[name == effect.at for name in self._plant.joints]])

    def stack(self, bins: Sequence[Bin]) -> Work[Bins]:
        """Stack several bins."""
        parts, size = [], ONLINE.work.bins
        for first in range(0, len(bins), size):
            yield
            parts.append(Bins.stack(bins[first : first + size], self._plant, self._scale))
        return Bins.join(parts)

    def fit_running(self, terms: Sequence[Term]) -> Work[tuple[CompetingModels, Bins]]:
        """Fit the running model, and return it with the stacked bins; choose the joints at which effects are tried.

        With several joints, the error scale of each joint comes from a first fit.
        """
        self.is_tried = self._motion_time >= 0.5 * ONLINE.models.calibration
        bins = yield from self.stack(self.bins)
        base = yield from CompetingModels.fit(terms, bins)
        if len(self._plant.joints) == 1:
            return base, bins
        for joint in {bin_.joint for bin_ in self.bins}:
            residual = base.residual[bins.at == self._plant.joints[joint]]
            self._scale[joint] = np.sqrt(max(float(np.mean(residual**2)), 1e-12))
        self._scale /= self._scale.mean()
        bins = yield from self.stack(self.bins)
        return (yield from CompetingModels.fit(terms, bins)), bins
