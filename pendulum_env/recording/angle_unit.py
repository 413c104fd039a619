"""Find the unit of an angle from the motion: gravity acts with the sine of radians."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pendulum_env._typing import Array, Mask
from pendulum_env.filters import filter_savitzky_golay
from pendulum_env.quantity import Quantity
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.vocabulary import UNITS
from pendulum_env.tone import has_one_frequency

DEGREE, TURN = UNITS["position"]["deg"], UNITS["position"]["rev"]  # [rad]
SMOOTHING = 0.05  # [s] window of the second derivative
CLEAR = 0.1  # of the misfit of radians, below which that of another unit tells the unit
BETTER = 0.82  # the same, of gravity about a zero that is unknown, if its wave number is that of turns as well
LONG = 8.0  # [s] of motion, from which such a difference is no accident
NEAR = 1.2  # ratio of wave numbers that are the same; those of radians and turns differ by 6.3
ORDERS = (5, 6, 7)  # of cogging, whose torque over radians resembles gravity over turns
WOUND = 10 * np.pi  # [rad] that a spring at a joint may be wound up and down, at the most


@dataclass(frozen=True)
class UnitSuspicion:
    """Unit other than radians that a motion suggests."""

    unit: str  # deg or rev
    range: tuple[float, float]  # of the angle, as it was read [rad]
    residual: float  # of gravity in that unit, in the proportion to that in radians
    is_certain: bool = True  # else a spring over radians explains the motion as well

    @property
    def name(self) -> str:
        """Return `degrees` or `turns`."""
        return {"deg": "degrees", "rev": "turns"}[self.unit]

    @property
    def text(self) -> str:
        """Return the evidence for that unit, as the subject of an error."""
        if self.unit == "rev":
            return f"gravity acts on position as on turns, with a residual of {self.residual:.1%} of that in radians"
        low, high = self.range
        return f"position runs from {low:.4g} to {high:.4g} and gravity acts on it as on degrees"

    def note(self, columns: Mapping[str, str]) -> Note:
        """Note that the angle may have that unit, with the columns that read it so."""
        low, high = (Quantity(end, unit="rad") for end in self.range)
        return Note(NoteKind.MAY_BE_DEGREES, ("position",), {"low": low, "high": high}, columns=columns)


@dataclass(frozen=True)
class AccelerationFit:
    """Regression of the acceleration of N samples on torque, friction and columns of gravity.

    Attributes:
        position: smoothed (N,) [rad].
        velocity: (N,) [rad/s].
        acceleration: (N,) [rad/s^2].
        torque: smoothed, of unit size (N,).
        is_odd: second of each sample is odd (N,).
        period: time between samples [s].
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    is_odd: Mask
    period: float

    @classmethod
    def from_motion(cls, position: Array, torque: Array, rate: float) -> "AccelerationFit | None":
        """Average the samples to some 200 Hz, 100,000 at most; None if there are fewer than 20."""
        stride = max(1, round(rate / 200.0))
        count = min(len(position) // stride, 100_000)
        if count < 20:
            return None
        torque = torque / max(np.abs(torque).max(), np.finfo(float).tiny)  # only its shape matters
        q, tau = (x[: count * stride].reshape(count, stride).mean(axis=1) for x in (position, torque))
        step = stride / rate
        window = (min(max(5, round(SMOOTHING / step)), count) - 1) | 1  # odd
        v, a = (filter_savitzky_golay(q, window, 3, order, step) for order in (1, 2))
        is_odd = (np.arange(count) * step).astype(np.intp) % 2 == 1
        return cls(filter_savitzky_golay(q, window, 3), v, a, filter_savitzky_golay(tau, window, 3), is_odd, step)

    def compute_misfit(self, *gravity: Array) -> float:
        """Return the residual norm of every other second, predicted by the fit of the seconds between [rad/s^2]."""
        v, a, odd = self.velocity, self.acceleration, self.is_odd
        phi = np.column_stack([self.torque, v, np.sign(v), np.ones_like(v), *gravity])
        phi /= np.abs(phi).max(axis=0) + np.finfo(float).tiny
        left = [a[~h] - phi[~h] @ np.linalg.lstsq(phi[h], a[h], rcond=None)[0] for h in (odd, ~odd)]
        return float(np.linalg.norm(np.concatenate(left)))

    def compute_misfit_in_unit(self, factor: float) -> float:
        """Return the misfit with gravity if position times `factor` is in radians."""
        x = factor * self.position
        return min(self.compute_misfit(np.sin(x)), self.compute_misfit(np.sin(x), np.cos(x)))

    def has_wave_number(self, factor: float) -> bool:
        """Return whether sin(f q + phase) explains the motion best with f near a factor, of half to twice of it."""
        numbers = factor * np.geomspace(0.5, 2.0, 25)
        best = numbers[
            np.argmin([self.compute_misfit(np.sin(f * self.position), np.cos(f * self.position)) for f in numbers])
        ]
        return bool(1 / NEAR < best / factor < NEAR)


def suspect_unit(position: Array, torque: Array, rate: float, *, turns: bool = True) -> UnitSuspicion | None:
    """Find another unit of an angle (N,) that was read as radians, from the action of gravity.

    Turns are found where their misfit is a tenth of that of radians, with or without a spring. Smaller swings about an
    unknown zero bend gravity less: there the misfit of turns has to be the lower one, at the wave number of turns.
    Cogging of an order near 2 pi must not explain the motion better by more than 5 %.
    Degrees that cover more than 2 pi are found by a smaller difference. Below 30 degrees the sine is straight, as is a
    spring over radians: the unit is uncertain. So it is in a motion of one frequency, whose position is proportional to
    its acceleration, if a torque drives it: gravity on degrees may imitate an error of the torque.

    Args:
        position: uniformly sampled, in one segment.
        torque: (N,), in any unit.
        rate: samples per second [Hz].
        turns: whether it may be in turns.
    """
    fit = AccelerationFit.from_motion(position, torque, rate)
    if fit is None:
        return None
    if turns:
        q = fit.position
        gravity, other = fit.compute_misfit_in_unit(1.0), fit.compute_misfit_in_unit(TURN)
        radians = min(
            fit.compute_misfit(),
            fit.compute_misfit(q),
            fit.compute_misfit(q, np.sin(q)),
            fit.compute_misfit(q, np.sin(q), np.cos(q)),
        )
        is_bent = (
            len(position) > LONG * rate
            and other < BETTER * gravity
            and other < 1.05 * radians
            and fit.has_wave_number(TURN)
        )
        cogging = min(fit.compute_misfit(np.sin(order * q), np.cos(order * q)) for order in ORDERS)
        is_turned = (other < CLEAR * radians or is_bent) and other < 1.05 * cogging
        if radians > 1e-3 * np.sqrt(len(q)) and is_turned:
            return UnitSuspicion("rev", _find_range(position), other / max(radians, gravity))
    found = _suspect_degrees(position, fit)
    if found is None or not found.is_certain:
        return found
    return replace(found, is_certain=not (torque.any() and has_one_frequency(fit.position, fit.period)))


def _suspect_degrees(position: Array, fit: AccelerationFit) -> UnitSuspicion | None:
    """Suspect degrees if gravity fits better on them; position has to cover more than 2 pi."""
    if np.ptp(position) <= 2 * np.pi:
        return None
    v, count = fit.velocity, len(fit.velocity)
    radians, degrees, none = fit.compute_misfit_in_unit(1.0), fit.compute_misfit_in_unit(DEGREE), fit.compute_misfit()
    # Of 100 real and simulated runs, those in degrees have ratios below 0.945 here, those in radians above 0.975.
    if degrees >= 0.96 * min(radians, none) or none <= 1e-3 * np.sqrt(count):  # [rad/s^2], mere noise
        return None
    time = np.linspace(-1.0, 1.0, count)
    other = min(
        radians,
        fit.compute_misfit(np.maximum(v, 0.0)),
        fit.compute_misfit(v * np.abs(v)),
        fit.compute_misfit(time, time**2),
    )
    spare = 0.01 * none  # what is left of next to nothing is no matter
    if degrees + spare >= 0.96 * (min(other, none) + spare):
        return None
    return UnitSuspicion("deg", _find_range(position), degrees / radians, is_certain=bool(np.ptp(position) > WOUND))


def _find_range(position: Array) -> tuple[float, float]:
    return float(position.min()), float(position.max())
