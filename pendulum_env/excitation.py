"""Excitation signals: torque over time that makes a pendulum show its parameters.

Each is a small record of numbers that were drawn once, from then on a plain function of time: `signal(time)` gives the
same torque for one instant or for N of them, in any order, and never exceeds `amplitude`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, Self

import numpy as np

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.lookup import find


class Excitation(Protocol):
    """A torque command over time, bounded by its amplitude."""

    @property
    def amplitude(self) -> float:
        """Bound of |torque| [N m]."""

    def signal(self, time: ArrayLike) -> Array:
        """Torque at a time or at times (N,), in the same shape [N m]."""


class Drawn(Protocol):
    """A kind of excitation: what the registry holds."""

    usual: float  # [N m], the amplitude it has unless another is asked for

    def draw(self, rng: np.random.Generator, seconds: float, amplitude: float) -> Excitation:
        """One signal of the kind, laid out for a recording of that many seconds."""


@dataclass(frozen=True)
class TwoTone:
    """The paper's excitation 3 sin(12.07 t + r1) + 3 sin(2.25 t + r2): a fast tone for inertia, a slow one for gravity.

    The paper prints the sines without t; the frequencies only make sense with it. r1 and r2 are random phases.
    """

    amplitude: float
    phases: tuple[float, float]  # [rad]

    usual: ClassVar[float] = 6.0

    @classmethod
    def draw(cls, rng: np.random.Generator, seconds: float, amplitude: float = usual) -> Self:
        """Random phases."""
        first, second = rng.uniform(0, 2 * np.pi, 2)
        return cls(amplitude, (float(first), float(second)))

    def signal(self, time: ArrayLike) -> Array:
        """Torque [N m]."""
        t = np.asarray(time, dtype=float)
        return 0.5 * self.amplitude * (np.sin(12.07 * t + self.phases[0]) + np.sin(2.25 * t + self.phases[1]))


@dataclass(frozen=True)
class Multisine:
    """Sines at multiples of one base frequency: moderate motion with a flat spectrum, over and over."""

    amplitude: float
    base: float  # [Hz]
    harmonics: tuple[int, ...]
    phases: tuple[float, ...]  # [rad]

    usual: ClassVar[float] = 5.0

    @classmethod
    def draw(cls, rng: np.random.Generator, seconds: float, amplitude: float = usual) -> Self:
        """Ten harmonics of 0.1 Hz up to 4 Hz, with random phases."""
        harmonics = np.sort(rng.choice(np.arange(2, 41), 10, replace=False))
        return cls(amplitude, 0.1, tuple(harmonics.tolist()), tuple(rng.uniform(0, 2 * np.pi, 10).tolist()))

    def signal(self, time: ArrayLike) -> Array:
        """Torque [N m]."""
        return self.amplitude / self._peak() * self._sum(2 * np.pi * self.base * np.asarray(time, dtype=float))

    def _sum(self, angle: Array) -> Array:
        angles = np.multiply.outer(angle, np.array(self.harmonics)) + np.array(self.phases)
        return np.asarray(np.sin(angles).sum(axis=-1))

    def _peak(self) -> float:
        # Between the points of a grid of M, a trigonometric polynomial of degree n exceeds its largest value there by
        # no more than 1 / cos(pi n / M) (Ehlich and Zeller, Mathematische Zeitschrift 86, 1964).
        degree = max(self.harmonics)
        grid = np.linspace(0, 2 * np.pi, 32 * degree, endpoint=False)
        return float(np.abs(self._sum(grid)).max() / np.cos(np.pi / 32))


@dataclass(frozen=True)
class Chirp:
    """A sweep of frequency: slow full turns first, fast wagging last, and from the start again after its duration."""

    amplitude: float
    low: float  # [Hz]
    high: float  # [Hz]
    seconds: float
    phase: float  # [rad]

    usual: ClassVar[float] = 4.5

    @classmethod
    def draw(cls, rng: np.random.Generator, seconds: float, amplitude: float = usual) -> Self:
        """From about 0.1 to about 4 Hz over the whole recording."""
        low, high, phase = rng.uniform(0.08, 0.2), rng.uniform(3, 5), rng.uniform(0, 2 * np.pi)
        return cls(amplitude, float(low), float(high), seconds, float(phase))

    def signal(self, time: ArrayLike) -> Array:
        """Torque [N m]."""
        t = np.mod(np.asarray(time, dtype=float), self.seconds)
        cycles = self.low * t + (self.high - self.low) * t**2 / (2 * self.seconds)
        return np.asarray(self.amplitude * np.sin(2 * np.pi * cycles + self.phase))


@dataclass(frozen=True)
class Levels:
    """Torque held at given levels between given times, and from the start again after the last one."""

    amplitude: float
    edges: tuple[float, ...]  # end of each level [s], increasing
    levels: tuple[float, ...]  # [N m]

    def signal(self, time: ArrayLike) -> Array:
        """Torque [N m]."""
        t = np.mod(np.asarray(time, dtype=float), self.edges[-1])
        return np.asarray(np.array(self.levels)[np.searchsorted(self.edges, t, side="right")])


class PRBS:
    """Pseudo-random binary torque: full power at every frequency below its clock of about 0.2 s."""

    usual: ClassVar[float] = 3.5

    @staticmethod
    def draw(rng: np.random.Generator, seconds: float, amplitude: float = usual) -> Levels:
        """Signs drawn for every tick of the clock."""
        clock = float(rng.uniform(0.12, 0.25))  # [s]
        count = int(seconds / clock) + 1
        edges = clock * np.arange(1, count + 1)
        return Levels(amplitude, tuple(edges.tolist()), tuple((amplitude * rng.choice([-1.0, 1.0], count)).tolist()))


class Steps:
    """Random levels held for random times: the arm settles, starts from rest and overshoots."""

    usual: ClassVar[float] = 5.0

    @staticmethod
    def draw(rng: np.random.Generator, seconds: float, amplitude: float = usual) -> Levels:
        """Levels within the amplitude, held for 0.2 to 1.2 s."""
        edges = np.cumsum(rng.uniform(0.2, 1.2, int(seconds / 0.2) + 1))
        edges = edges[: int(np.searchsorted(edges, seconds)) + 1]
        return Levels(amplitude, tuple(edges.tolist()), tuple(rng.uniform(-amplitude, amplitude, len(edges)).tolist()))


EXCITATIONS: dict[str, Drawn] = {
    "paper": TwoTone,
    "multisine": Multisine,
    "chirp": Chirp,
    "prbs": PRBS,
    "steps": Steps,
}


def excitation(
    name: str, rng: np.random.Generator, seconds: float = 30.0, amplitude: float | None = None
) -> Excitation:
    """Draw an excitation signal.

    Args:
        name: one of `EXCITATIONS`.
        rng: where its random numbers come from.
        seconds: length of the recording it is meant for; it goes on beyond.
        amplitude: bound of |torque| [N m]; each kind has its usual one.

    Raises:
        ValueError: if the name is unknown, or if seconds or amplitude is not positive.
    """
    kind = find("excitation", name, EXCITATIONS)
    amplitude = kind.usual if amplitude is None else amplitude
    for what, value in (("seconds", seconds), ("amplitude", amplitude)):
        if not 0 < value < np.inf:
            raise ValueError(f"an excitation needs {what} above zero, got {value:g}")
    return kind.draw(rng, seconds, amplitude)
