"""A suggested experiment: a torque signal, its aims and the expected motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from pendulum_env._typing import JSON, Array
from pendulum_env.errors import FileError
from pendulum_env.excitation import Excitation, decode_signal, encode_signal
from pendulum_env.notebook import summarise
from pendulum_env.reading import NonNegative, Number, Text, convert
from pendulum_env.units import TURNING, JointUnits

LONGEST = 100_000.0  # longest experiment in a file [s]
RATE = 500.0  # sampling rate of the experiment's torque [Hz]


@dataclass(frozen=True)
class Aim:
    """Aim of an experiment: to distinguish an effect from its absence, or from a term of the model.

    Attributes:
        effect: id of the effect.
        instead: id of the model's term that fits equally; None if the recordings do not excite the effect.
    """

    effect: Text
    instead: Text | None = None


@dataclass(frozen=True)
class Suggestion:
    """Suggested experiment.

    Attributes:
        signal: torque over time; None of a free swing.
        seconds: length of the experiment [s].
        settles: aims that it reaches.
        peak_torque: largest absolute torque [N m].
        reach: lowest and highest angle by the fitted model [rad].
        peak_speed: highest speed by the fitted model [rad/s].
        release: angle of a free swing, at rest [rad]; None with a signal.
        units: names of the units of the joint.
    """

    signal: Excitation | None
    seconds: float
    settles: tuple[Aim, ...]
    peak_torque: float
    reach: tuple[float, float]
    peak_speed: float
    release: float | None = None
    units: JointUnits = field(default=TURNING, compare=False)

    def __str__(self) -> str:
        return summarise(self)

    def samples(self) -> tuple[Array, Array]:
        """Return times (N,) [s] and torques (N,) [N m] of the experiment, at 500 Hz."""
        time = np.arange(round(self.seconds * RATE)) / RATE
        if self.signal is None:
            return time, np.zeros(len(time))
        return time, np.asarray(self.signal.signal(time), dtype=float)

    def csv(self) -> str:
        """Return the torque over time as CSV, columns `time` [s] and `torque` [N m], for other controllers."""
        rows = (f"{t:.3f},{torque:.6g}" for t, torque in zip(*self.samples(), strict=True))
        return "\n".join(["time,torque", *rows, ""])

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        excitation = {"signal": encode_signal(self.signal)} if self.signal is not None else {"release": self.release}
        return {
            "settles": [{"effect": aim.effect, "instead": aim.instead} for aim in self.settles],
            "seconds": self.seconds,
            "peak_torque": self.peak_torque,
            "reach": list(self.reach),
            "peak_speed": self.peak_speed,
            **excitation,
        }

    @classmethod
    def from_json(cls, data: JSON, key: str = "") -> Suggestion:
        """Make a suggestion from a dictionary of `json`; errors name `key`, its key in a file.

        Raises:
            ValueError: if the dictionary has another form.
        """
        content = convert(data, _SuggestionFile, key)
        low, high = content.reach
        if low >= high:
            raise FileError(f"'{f'{key}.reach'.lstrip('.')}' is [{low:g}, {high:g}]: expected the lower angle first")
        if content.signal is None and content.release is None:
            raise FileError(
                f"'{f'{key}.signal'.lstrip('.')}' is missing: expected the signal, or the angle of 'release'"
            )
        signal = None if content.signal is None else decode_signal(content.signal, f"{key}.signal".lstrip("."))
        expected = content.peak_torque, content.reach, content.peak_speed
        return cls(signal, content.seconds, content.settles, *expected, content.release if signal is None else None)


class _SuggestionFile(Struct):
    """Suggestion in a diagnosis file."""

    seconds: Annotated[float, Meta(gt=0.0, le=LONGEST)]
    settles: tuple[Aim, ...]
    peak_torque: NonNegative
    reach: tuple[Number, Number]
    peak_speed: NonNegative
    signal: dict[str, Any] | None = None
    release: Number | None = None
