"""Ways to go from a recording to parameters: this project's, the same with one care left out, and the paper's.

`Anatomy` tells why the cares matter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimators.paper.as_printed import PRINTED, as_logged
from estimators.schemes.six import PAPER, SCHEMES, Integral, Regressor, Scheme, scheme
from estimators.signals.measurements import Measurements, measure
from pendulum_env._typing import Array
from pendulum_env.physics import BASE
from pendulum_env.recording import Recording


@dataclass(frozen=True)
class Way:
    """One way to go from recordings to parameters.

    Attributes:
        id: name in files.
        text: what it does, as a heading.
        schemes: the six regressions.
        measured: how motion and torque are taken from a recording.
    """

    id: str
    text: str
    schemes: Sequence[Regressor]
    measured: Callable[[Recording], Measurements] = measure

    def segments(self, recording: Recording) -> list[Measurements]:
        """Measurements of a recording without gaps."""
        return [self.measured(recording)]


def at_rest_in_stick(recording: Recording) -> Measurements:
    """Measurements whose velocity is 0 where its sign is lost in noise, so that sgn q' is 0 in stick."""
    m = measure(recording)
    return replace(m, velocity=np.where(m.moving, m.velocity, 0.0))


def command_as_logged(recording: Recording) -> Measurements:
    """Measurements whose torque is the command of the same row, as if it had not been held since: half a sample off."""
    m = measure(recording)
    return replace(m, torque=np.append(m.held[1:], m.held[-1]), held=m.torque)


def differentiated_backwards(recording: Recording) -> Measurements:
    """Measurements whose velocity is the backward difference of the encoder, and acceleration that of the velocity."""
    m, raw = measure(recording), as_logged(recording)
    margin = (len(raw) - len(m)) // 2
    same = slice(margin, margin + len(m))
    return replace(m, position=raw.position[same], velocity=raw.velocity[same], acceleration=raw.acceleration[same])


STICK_KEPT = tuple(replace(own, guard=None) for own in SCHEMES)
WAYS: tuple[Way, ...] = (
    Way("ours", "this project", SCHEMES),
    Way("stick_kept", "stick kept, sgn q' as noise has it", STICK_KEPT),
    Way("stick_as_zero", "stick kept, sgn q' = 0 there", STICK_KEPT, at_rest_in_stick),
    Way("command_as_logged", "torque half a sample off", SCHEMES, command_as_logged),
    Way("differentiated_backwards", "backward differences", SCHEMES, differentiated_backwards),
    Way("paper", "energy from the start, inertia borrowed", PAPER),
    Way("printed", "the paper's equations as printed", PRINTED, as_logged),
)


class Anatomy(NamedTuple):
    """What the true parameters leave of the balances of one run: why some samples and schemes tell less than others.

    Attributes:
        at_rest: share of samples in stick.
        torque_at_rest, torque_clear: RMS of the torque they leave there, and clear of stick and reversals [N m].
        acceleration: RMS by which the backward difference of the backward difference errs [rad/s^2].
        memory_from_start, memory_in_windows: correlation of the energy balance's error with itself a second later.
    """

    at_rest: float
    torque_at_rest: float
    torque_clear: float
    acceleration: float
    memory_from_start: float
    memory_in_windows: float


def dissect(recording: Recording, theta: Array) -> Anatomy:
    """Anatomy of a run with true parameters theta (4,)."""
    m = measure(recording)

    def left(own: Scheme) -> Array:
        equations, usable = own.regression(m, BASE)
        return (equations.y - equations.phi @ theta)[usable]

    def memory(own: Scheme) -> float:
        error, lag = left(own), round(1.0 / m.period)
        return float(np.corrcoef(error[:-lag], error[lag:])[0, 1])

    rest = ~m.moving
    return Anatomy(
        at_rest=float(np.mean(rest)),
        torque_at_rest=rms(left(scheme("dynamic", guard=None))[rest]),
        torque_clear=rms(left(scheme("dynamic"))),
        acceleration=rms(differentiated_backwards(recording).acceleration - m.acceleration),
        memory_from_start=memory(scheme("energy", operator=Integral(window=None))),
        memory_in_windows=memory(scheme("energy")),
    )


def rms(values: Array) -> float:
    """Root mean square, the paper's norm (10); NaN counts as not measured."""
    return float(np.sqrt(np.nanmean(values**2))) if len(values) else 0.0
