"""Torques that depend on the angle alone and store energy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics.term import Column, Samples, Shape, Term, one


@dataclass(frozen=True)
class GravityTilt(Term):
    """Gravity out of phase, g cos q: a tilted base, an offset centre of mass, or a wrong encoder zero."""

    id = "gravity_tilt"
    law = "g cos q"
    kind = "potential"
    reveal = "swings beyond 30 degrees, to tell it from a constant"

    @property
    def columns(self) -> tuple[Column, ...]:
        return (
            Column("gravity_tilt", "N m", force=lambda x: np.cos(x.position), potential=lambda x: np.sin(x.position)),
        )


@dataclass(frozen=True)
class Cogging(Term):
    """Torque of the magnets on the slots, s sin Nq + c cos Nq, N periods in a turn."""

    order: float = 12.0

    id = "cogging"
    law = "s sin Nq + c cos Nq"
    kind = "potential"
    reveal = "slow full turns"
    shapes = (Shape("order", "1", 2, 200, integer=True),)

    @property
    def columns(self) -> tuple[Column, ...]:
        n = self.order
        return (
            Column(
                "cogging.sin",
                "N m",
                force=lambda x: np.sin(n * x.position),
                potential=lambda x: (1.0 - np.cos(n * x.position)) / n,
            ),
            Column(
                "cogging.cos",
                "N m",
                force=lambda x: np.cos(n * x.position),
                potential=lambda x: np.sin(n * x.position) / n,
            ),
        )

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        return [cls(float(order)) for order in range(2, 61)]


@dataclass(frozen=True)
class Spring(Term):
    """Elastic pull towards a rest angle, k (q - q0): a cable or hose; linear in k and in k q0."""

    id = "spring"
    law = "k q - k q0"
    kind = "potential"
    reveal = "swings beyond 60 degrees or several turns, to tell it from gravity"

    @property
    def columns(self) -> tuple[Column, ...]:
        return (
            Column("spring.stiffness", "N m/rad", force=lambda x: x.position, potential=lambda x: 0.5 * x.position**2),
            Column("spring.preload", "N m", force=one, potential=lambda x: x.position),
        )


@dataclass(frozen=True)
class HardStop(Term):
    """Stiff one-sided contact beyond an angle: k (q - stop) once q is past it.

    A positive stop acts on larger angles, a negative one on smaller angles.
    """

    stop: float = 1.0

    id = "hard_stop"
    law = "k (q - q_stop) beyond q_stop"
    kind = "potential"
    reveal = "motion up to the end of the range"
    beyond = "no stop within the range of motion, and none beyond it would show"
    shapes = (Shape("stop", "rad", -1e6, 1e6),)

    @property
    def columns(self) -> tuple[Column, ...]:
        return (
            Column(
                "hard_stop", "N m/rad", force=lambda x: self._depth(x), potential=lambda x: 0.5 * self._depth(x) ** 2
            ),
        )

    def _depth(self, x: Samples) -> np.ndarray:
        """Penetration beyond the stop, signed [rad]."""
        side = np.where(np.asarray(self.stop) >= 0, 1.0, -1.0)
        return side * np.maximum(side * (np.asarray(x.position) - self.stop), 0.0)

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        # The arm rests or turns round at a stop, so it lies near an end of the range that was seen.
        q = np.asarray(x.position)
        low, high = float(q.min()), float(q.max())
        share = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4])
        upper = [cls(stop) for stop in high - share * (high - low) if stop > 0]
        lower = [cls(stop) for stop in low + share * (high - low) if stop < 0]
        return upper + lower
