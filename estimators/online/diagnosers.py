"""Many pendulums diagnosed at once: their samples are gathered together, and each has models of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.online.binning import Binner
from estimators.online.diagnosis import Diagnoser, OnlineDiagnosis
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Mask
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.physics import BASE, Term


class Diagnosers:
    """Diagnoses B pendulums, one sample of each per step; each is a `Diagnoser` whose samples are gathered together."""

    def __init__(self, rate: float, batch: int, terms: Sequence[Term] = BASE, **options: Any) -> None:
        """Take the samples per second [Hz], B, the model, and options of `Diagnoser`.

        Raises:
            ValueError: as `Diagnoser` does.
        """
        options["smoothing"] = options.get("smoothing") or Smoothing.of_encoder(COUNTS, rate)
        self.each = tuple(Diagnoser(rate, terms, **options) for _ in range(batch))
        self.rate, self._binner = rate, Binner(rate, options["smoothing"], batch)

    @property
    def said(self) -> tuple[OnlineDiagnosis, ...]:
        """What is said of each."""
        return tuple(one.said for one in self.each)

    def reset(self, which: Mask) -> None:
        """Those pendulums (B,) start anew with the next sample."""
        if which.any():
            self._binner.reset(which)
            for b in np.flatnonzero(which):
                self.each[b].reset()

    def take(self, time: Array, position: Array, torque: Array) -> tuple[OnlineDiagnosis, ...]:
        """Take in a sample of every pendulum, as `OnlineEstimator.take`."""
        for one in self._binner.take(time, position, torque):
            self.each[one.of].take_bin(one)
        return self.said
