"""Errors of models of servos: of the motion that is simulated with the controller in the loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from estimators.selection.errors import Errors
from pendulum_env._typing import Array

__all__ = ["Errors", "LoopErrors"]


@dataclass(frozen=True, repr=False)
class LoopErrors(Errors):
    """Errors of a model of a servo on some data; those in the loop decide.

    Attributes:
        in_loop: mean absolute position error of simulations with the controller in the loop [rad].
        in_loop_rms: RMS of the same [rad].
    """

    in_loop: float = np.nan
    in_loop_rms: float = np.nan
    is_in_loop: ClassVar[bool] = True

    @classmethod
    def extend(cls, errors: Errors, missed: Array) -> LoopErrors:
        """Extend errors by those in the loop, from position differences (R,) [rad]."""
        return cls(
            **vars(errors), in_loop=float(np.mean(np.abs(missed))), in_loop_rms=float(np.sqrt(np.mean(missed**2)))
        )

    @property
    def loop(self) -> tuple[float, ...]:
        """Return mean and RMS of the error in the loop [rad]."""
        return self.in_loop, self.in_loop_rms

    @property
    def kinds(self) -> dict[str, str]:
        """Return the name of the error in the loop with its unit."""
        return {"in_loop": "rad"}
