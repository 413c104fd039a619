"""An experiment that would settle what a diagnosis leaves open: a torque signal and what to expect of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import JSON, Array
from pendulum_env.excitation import Excitation, signal_json, signal_of
from pendulum_env.reading import Value

LONGEST = 100_000.0  # [s] of an experiment
RATE = 500.0  # [Hz], of the experiment's torque as samples


@dataclass(frozen=True)
class Aim:
    """What an experiment is to settle: whether `effect` is there, and not `instead` that looks the same so far.

    Attributes:
        effect: id of the effect in question.
        instead: id of the model's term that it may be mistaken for; None if the data hardly show it at all.
    """

    effect: str
    instead: str | None = None

    @property
    def text(self) -> str:
        """`tell spring from gravity_tilt`, `show spring if it is there`."""
        return f"tell {self.effect} from {self.instead}" if self.instead else f"show {self.effect} if it is there"


@dataclass(frozen=True)
class Suggestion:
    """An experiment worth doing.

    Attributes:
        signal: torque over time.
        seconds: length of the experiment.
        settles: what it settles.
        peak_torque: largest torque of the signal [N m].
        reach: lowest and highest angle that the fitted model goes to [rad].
        peak_speed: and its highest speed [rad/s].
    """

    signal: Excitation
    seconds: float
    settles: tuple[Aim, ...]
    peak_torque: float
    reach: tuple[float, float]
    peak_speed: float

    @property
    def text(self) -> str:
        """The experiment in one sentence."""
        low, high = np.degrees(self.reach)
        kind = signal_json(self.signal)["kind"].replace("_", " ")
        return (
            f"to {', '.join(aim.text for aim in self.settles)}: record {self.seconds:g} s of {kind} torque up "
            f"to {self.peak_torque:.2g} N m, with angles from {low:.0f} to {high:.0f} degrees and up to "
            f"{self.peak_speed:.2g} rad/s to be expected (`record --excitation suggested` plays it)"
        )

    def samples(self) -> tuple[Array, Array]:
        """Times (N,) [s] and torques (N,) [N m] of the experiment."""
        time = np.arange(round(self.seconds * RATE)) / RATE
        return time, np.asarray(self.signal.signal(time), dtype=float)

    def csv(self) -> str:
        """The torque over time as CSV, columns `time` [s] and `torque` [N m], for a controller of one's own."""
        rows = (f"{t:.3f},{torque:.6g}" for t, torque in zip(*self.samples(), strict=True))
        return "\n".join(["time,torque", *rows, ""])

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "text": self.text,
            "settles": [{"effect": aim.effect, "instead": aim.instead} for aim in self.settles],
            "seconds": self.seconds,
            "peak_torque": self.peak_torque,
            "reach": list(self.reach),
            "peak_speed": self.peak_speed,
            "signal": signal_json(self.signal),
        }

    @classmethod
    def of(cls, data: Value) -> Suggestion:
        """Suggestion from what stands in a diagnosis.

        Raises:
            ValueError: if it is none.
        """
        reach = [angle.number() for angle in data["reach"].items()]
        if len(reach) != 2:
            raise data["reach"].fault("a list of two angles")
        aims = []
        for entry in data["settles"].items(100):
            instead = entry.get("instead")
            aims.append(Aim(entry["effect"].text(), None if instead is None else instead.text()))
        return cls(
            signal_of(data["signal"]),
            data["seconds"].number(0.0, LONGEST, above=True),
            tuple(aims),
            data["peak_torque"].number(0.0),
            (reach[0], reach[1]),
            data["peak_speed"].number(0.0),
        )
