"""Excitation signals: torque over time for identification.

Each signal is a record of numbers. `signal(time)` is a pure function of time, scalar or (N,), bounded by `amplitude`.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Annotated, NamedTuple, Protocol, Self

import numpy as np
from msgspec import Meta, Struct, json

from pendulum_env._typing import JSON, Array, ArrayLike, Index
from pendulum_env.errors import FileError, UserError
from pendulum_env.lookup import find
from pendulum_env.reading import Number, convert

LARGEST_TORQUE = 1e6  # [N m], upper limit of an amplitude; the largest robots have about 1e4
Torque = Annotated[float, Meta(ge=1e-9, le=LARGEST_TORQUE)]  # [N m], amplitude in a file
Frequency = Annotated[float, Meta(ge=1e-6, le=1e3)]  # [Hz]
DEFAULT_SPEED = 4.0  # [rad/s] default speed limit of a designed motion


class Excitation(Protocol):
    """Torque command over time, bounded by its amplitude."""

    @property
    def amplitude(self) -> float:
        """Bound of |torque| [N m]."""

    def signal(self, time: ArrayLike) -> Array:
        """Return the torque [N m] at `time` [s], in the same shape."""


class TwoTone(Struct, frozen=True, tag_field="kind", tag="two_tone"):
    """Excitation of the paper, 3 sin(12.07 t + r1) + 3 sin(2.25 t + r2).

    The fast sine excites the inertia, the slow one gravity. r1 and r2 are random phases. The paper omits t in print.
    """

    amplitude: Torque
    phases: tuple[Number, Number]  # [rad]

    @classmethod
    def draw(cls, rng: np.random.Generator, seconds: float, amplitude: float) -> Self:
        """Draw random phases."""
        first, second = rng.uniform(0, 2 * np.pi, 2).tolist()
        return cls(amplitude, (first, second))

    def signal(self, time: ArrayLike) -> Array:
        """Return the torque [N m]."""
        t = np.asarray(time, dtype=float)
        return 0.5 * self.amplitude * (np.sin(12.07 * t + self.phases[0]) + np.sin(2.25 * t + self.phases[1]))


class Multisine(Struct, frozen=True, tag_field="kind", tag="multisine"):
    """Sines at multiples of one base frequency: a periodic signal with a flat spectrum."""

    amplitude: Torque
    base: Frequency  # [Hz]
    harmonics: tuple[Annotated[int, Meta(ge=1, le=1000)], ...]
    phases: tuple[Number, ...]  # [rad]

    @classmethod
    def draw(cls, rng: np.random.Generator, seconds: float, amplitude: float) -> Self:
        """Draw ten harmonics of 0.1 Hz up to 4 Hz, with random phases."""
        return cls.draw_band(rng, amplitude, 0.1, np.arange(2, 41), 10)

    @classmethod
    def draw_band(cls, rng: np.random.Generator, amplitude: float, base: float, harmonics: Index, count: int) -> Self:
        """Draw some of the harmonics of a base frequency [Hz], with random phases."""
        chosen = np.sort(rng.choice(harmonics, count, replace=False))
        return cls(amplitude, base, tuple(chosen.tolist()), tuple(rng.uniform(0, 2 * np.pi, count).tolist()))

    def signal(self, time: ArrayLike) -> Array:
        """Return the torque [N m]."""
        return self.amplitude / self._compute_peak() * self._sum(2 * np.pi * self.base * np.asarray(time, dtype=float))

    def _sum(self, angle: Array) -> Array:
        angles = np.multiply.outer(angle, np.array(self.harmonics)) + np.array(self.phases)
        return np.asarray(np.sin(angles).sum(axis=-1))

    def _compute_peak(self) -> float:
        # Between the points of a grid of M, a trigonometric polynomial of degree n exceeds its largest grid value by
        # a factor of at most 1 / cos(pi n / M) (Ehlich and Zeller, Mathematische Zeitschrift 86, 1964).
        degree = max(self.harmonics)
        grid = np.linspace(0, 2 * np.pi, 32 * degree, endpoint=False)
        return float(np.abs(self._sum(grid)).max() / np.cos(np.pi / 32))


class Chirp(Struct, frozen=True, tag_field="kind", tag="chirp"):
    """Linear sweep from a low to a high frequency, repeated after its duration."""

    amplitude: Torque
    low: Frequency  # [Hz]
    high: Frequency  # [Hz]
    seconds: Annotated[float, Meta(ge=1e-3, le=1e6)]
    phase: Number  # [rad]

    @classmethod
    def draw(cls, rng: np.random.Generator, seconds: float, amplitude: float) -> Self:
        """Draw a chirp from about 0.1 to about 4 Hz over the whole recording."""
        low, high, phase = rng.uniform(0.08, 0.2), rng.uniform(3, 5), rng.uniform(0, 2 * np.pi)
        return cls(amplitude, float(low), float(high), seconds, float(phase))

    def signal(self, time: ArrayLike) -> Array:
        """Return the torque [N m]."""
        t = np.mod(np.asarray(time, dtype=float), self.seconds)
        cycles = self.low * t + (self.high - self.low) * t**2 / (2 * self.seconds)
        return np.asarray(self.amplitude * np.sin(2 * np.pi * cycles + self.phase))


class Levels(Struct, frozen=True, tag_field="kind", tag="levels"):
    """Piecewise constant torque, repeated after the last level."""

    amplitude: Torque
    edges: tuple[Annotated[float, Meta(ge=1e-6, le=1e6)], ...]  # end of each level [s], increasing
    levels: tuple[Annotated[float, Meta(ge=-LARGEST_TORQUE, le=LARGEST_TORQUE)], ...]  # [N m]

    def signal(self, time: ArrayLike) -> Array:
        """Return the torque [N m]."""
        t = np.mod(np.asarray(time, dtype=float), self.edges[-1])
        return np.asarray(np.array(self.levels)[np.searchsorted(self.edges, t, side="right")])

    @classmethod
    def draw_binary(cls, rng: np.random.Generator, seconds: float, amplitude: float) -> Self:
        """Draw pseudo-random signs with a clock of about 0.2 s and a flat spectrum below its frequency."""
        clock = float(rng.uniform(0.12, 0.25))  # [s]
        count = int(seconds / clock) + 1
        levels = amplitude * rng.choice([-1.0, 1.0], count)
        return cls(amplitude, tuple((clock * np.arange(1, count + 1)).tolist()), tuple(levels.tolist()))

    @classmethod
    def draw_steps(
        cls, rng: np.random.Generator, seconds: float, amplitude: float, shortest: float = 0.2, longest: float = 1.2
    ) -> Self:
        """Draw random levels, each held for a random time [s], with which the pendulum settles and overshoots."""
        edges = np.cumsum(rng.uniform(shortest, longest, int(seconds / shortest) + 1))
        edges = edges[: int(np.searchsorted(edges, seconds)) + 1]
        return cls(amplitude, tuple(edges.tolist()), tuple(rng.uniform(-amplitude, amplitude, len(edges)).tolist()))


STILL = Levels(0.0, (1.0,), (0.0,))  # zero torque


class SignalKind(NamedTuple):
    """Kind of excitation."""

    default_amplitude: float  # [N m], default amplitude
    draw: Callable[[np.random.Generator, float, float], Excitation]  # from generator, duration [s] and amplitude [N m]


EXCITATIONS: dict[str, SignalKind] = {
    "paper": SignalKind(6.0, TwoTone.draw),
    "multisine": SignalKind(5.0, Multisine.draw),
    "chirp": SignalKind(4.5, Chirp.draw),
    "prbs": SignalKind(3.5, Levels.draw_binary),
    "steps": SignalKind(5.0, Levels.draw_steps),
}


def excitation(
    name: str, rng: np.random.Generator | int, seconds: float = 30.0, amplitude: float | None = None
) -> Excitation:
    """Draw an excitation signal.

    Args:
        name: one of `EXCITATIONS`.
        rng: random generator, or a seed.
        seconds: length of the recording [s]. After it, chirp, prbs and steps repeat; the other kinds are endless.
        amplitude: bound of |torque| [N m]; each kind has a default.

    Raises:
        ValueError: if the name is unknown, or if seconds or amplitude is not positive.
    """
    kind = find("excitation", name, EXCITATIONS)
    amplitude = kind.default_amplitude if amplitude is None else amplitude
    for argument, value in (("seconds", seconds), ("amplitude", amplitude)):
        if not 0 < value < np.inf:
            raise UserError(f"an excitation needs {argument} above zero, got {value:g}")
    if amplitude > LARGEST_TORQUE:
        raise UserError(f"an excitation needs an amplitude of at most {LARGEST_TORQUE:g} N m, got {amplitude:g}")
    return kind.draw(np.random.default_rng(rng), seconds, amplitude)


def draw_family(rng: np.random.Generator, seconds: float, amplitude: float) -> list[Excitation]:
    """Draw candidate signals of all kinds, with bounds from a third to all of an amplitude [N m].

    Slow signals move through large angles with few reversals; fast signals accelerate; a chirp does both in turn. Steps
    overshoot from rest, and long steps bring the pendulum to rest at many angles.
    """
    slow, fast = 1 / seconds, 0.5  # [Hz]
    signals: list[Excitation] = []
    for bound in (amplitude / 3, amplitude / 2, amplitude / 1.5, amplitude):
        signals += [
            Multisine.draw_band(rng, bound, slow, np.arange(1, 9), 4),
            Multisine.draw(rng, seconds, bound),
            Multisine.draw_band(rng, bound, fast, np.arange(4, 21), 6),
            Chirp.draw(rng, seconds, bound),
            TwoTone.draw(rng, seconds, bound),
            Levels.draw_steps(rng, seconds, bound),
            Levels.draw_steps(rng, seconds, bound, 1.5, 3.0),
        ]
    return signals


Signal = TwoTone | Multisine | Chirp | Levels  # signals that a file can hold


def encode_signal(signal: Excitation) -> JSON:
    """Return the dictionary for JSON of a signal, with its kind."""
    encoded: JSON = json.decode(json.encode(signal, enc_hook=float))  # tuples become lists, NumPy numbers floats
    return encoded


def decode_signal(data: JSON, key: str = "") -> Excitation:
    """Return the signal of a dictionary from `encode_signal`.

    Raises:
        ValueError: if the dictionary is not a valid signal.
    """
    expected = "a signal is one of two_tone, multisine, chirp, levels with all of its numbers, within its amplitude"
    try:
        signal: Signal = convert(data, Signal, key)  # type: ignore[arg-type]  # msgspec accepts unions
    except UserError as error:
        raise FileError(f"{expected}: {error}") from None
    match signal:
        case Multisine(harmonics=harmonics, phases=phases):
            is_complete = len(phases) == len(harmonics) > 0
        case Levels(edges=edges, levels=levels):
            is_complete = len(edges) == len(levels) > 0 and all(a < b for a, b in pairwise(edges))
        case _:
            is_complete = True
    if is_complete and np.abs(signal.signal(np.linspace(0, 60, 6001))).max() <= signal.amplitude * (1 + 1e-9):
        return signal
    raise FileError(expected)
