"""Find the unit of an angle from the motion, in which gravity acts with the sine of radians."""

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
SMOOTHING = 0.05  # [s], window of the second derivative
CLEAR = 0.1  # ratio to the misfit of radians below which another unit is found
BETTER = 0.82  # the same for gravity about an unknown zero with the wave number of turns
LONG = 8.0  # [s], least motion for `BETTER`
NEAR = 1.2  # largest ratio of equal wave numbers; those of radians and turns differ by 6.3
ORDERS = (5, 6, 7)  # orders of cogging over radians that resemble gravity over turns
WOUND = 10 * np.pi  # [rad], largest range of a spring at a joint


@dataclass(frozen=True)
class UnitSuspicion:
    """Unit other than the one of the column, found from a motion."""

    unit: str  # deg, rev or rad
    range: tuple[float, float]  # range of the angle as it was read [rad]
    residual: float  # ratio of the misfit to that in the unit of the column
    is_certain: bool = True  # False if a spring over radians also explains the motion

    @property
    def name(self) -> str:
        """Return `degrees`, `turns` or `radians`."""
        return {"deg": "degrees", "rev": "turns", "rad": "radians"}[self.unit]

    @property
    def text(self) -> str:
        """Return the evidence for the unit, for an error message."""
        if self.unit == "rad":
            return f"gravity acts on position as on radians, with a residual of {self.residual:.1%} of that in its unit"
        if self.unit == "rev":
            return f"gravity acts on position as on turns, with a residual of {self.residual:.1%} of that in radians"
        low, high = self.range
        return f"position runs from {low:.4g} to {high:.4g} and gravity acts on it as on degrees"

    def note(self, columns: Mapping[str, str]) -> Note:
        """Return a note on the possible unit, with the option `columns` that selects it."""
        low, high = (Quantity(end, unit="rad") for end in self.range)
        return Note(NoteKind.MAY_BE_DEGREES, ("position",), {"low": low, "high": high}, columns=columns)


@dataclass(frozen=True)
class AccelerationFit:
    """Regression of the acceleration of N samples on torque, friction and columns of gravity.

    Attributes:
        position: smoothed position (N,) [rad].
        velocity: velocity (N,) [rad/s].
        acceleration: acceleration (N,) [rad/s^2].
        torque: smoothed torque, scaled to a maximum of 1 (N,).
        is_odd: whether the second of each sample is odd (N,).
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
        """Average the samples to about 200 Hz and at most 100,000 samples; return None for fewer than 20."""
        stride = max(1, round(rate / 200.0))
        count = min(len(position) // stride, 100_000)
        if count < 20:
            return None
        torque = torque / max(np.abs(torque).max(), np.finfo(float).tiny)  # scale is a fitted parameter
        q, tau = (x[: count * stride].reshape(count, stride).mean(axis=1) for x in (position, torque))
        step = stride / rate
        window = (min(max(5, round(SMOOTHING / step)), count) - 1) | 1  # odd
        v, a = (filter_savitzky_golay(q, window, 3, order, step) for order in (1, 2))
        is_odd = (np.arange(count) * step).astype(np.intp) % 2 == 1
        return cls(filter_savitzky_golay(q, window, 3), v, a, filter_savitzky_golay(tau, window, 3), is_odd, step)

    def compute_misfit(self, *gravity: Array) -> float:
        """Return the residual norm [rad/s^2] of even and odd seconds, each predicted by the fit of the others."""
        v, a, odd = self.velocity, self.acceleration, self.is_odd
        phi = np.column_stack([self.torque, v, np.sign(v), np.ones_like(v), *gravity])
        phi /= np.abs(phi).max(axis=0) + np.finfo(float).tiny
        residuals = [a[~h] - phi[~h] @ np.linalg.lstsq(phi[h], a[h], rcond=None)[0] for h in (odd, ~odd)]
        return float(np.linalg.norm(np.concatenate(residuals)))

    def compute_misfit_in_unit(self, factor: float) -> float:
        """Return the misfit [rad/s^2] with gravity, if position times `factor` is in radians."""
        x = factor * self.position
        return min(self.compute_misfit(np.sin(x)), self.compute_misfit(np.sin(x), np.cos(x)))

    def compute_misfit_with_spring(self) -> float:
        """Return the least misfit [rad/s^2] with a spring, with gravity, or with neither."""
        q = self.position
        return min(self.compute_misfit(*columns) for columns in ((), (q,), (q, np.sin(q)), (q, np.sin(q), np.cos(q))))

    def has_wave_number(self, factor: float) -> bool:
        """Return whether the best f of sin(f q + phase), from factor / 2 to 2 factor, is near the factor."""
        numbers = factor * np.geomspace(0.5, 2.0, 25)
        best = numbers[
            np.argmin([self.compute_misfit(np.sin(f * self.position), np.cos(f * self.position)) for f in numbers])
        ]
        return bool(1 / NEAR < best / factor < NEAR)


def suspect_unit(position: Array, torque: Array, rate: float, *, turns: bool = True) -> UnitSuspicion | None:
    """Find another unit of an angle (N,) that was read as radians, from the torque of gravity.

    Turns are found if their misfit is below `CLEAR` times that of radians, with or without a spring. In small swings
    about an unknown zero, gravity is nearly linear. The misfit of turns must then be below `BETTER` times that of
    radians, at the wave number of turns. Turns are rejected if cogging of an order near 2 pi explains the motion better
    by more than 5 %. Degrees that cover more than 2 pi are found by a smaller difference. The unit is uncertain for
    motion below 30 degrees, where the sine is linear like a spring over radians. It is also uncertain for driven motion
    of one frequency, in which position is proportional to acceleration and gravity may imitate an error of the torque.

    Args:
        position: uniformly sampled angle of one segment (N,).
        torque: torque (N,) in any unit.
        rate: samples per second [Hz].
        turns: whether to test for turns.
    """
    fit = AccelerationFit.from_motion(position, torque, rate)
    if fit is None:
        return None
    if turns:
        q, radians = fit.position, fit.compute_misfit_with_spring()
        gravity_over_radians, gravity_over_turns = fit.compute_misfit_in_unit(1.0), fit.compute_misfit_in_unit(TURN)
        has_turn_period = (
            len(position) > LONG * rate
            and gravity_over_turns < BETTER * gravity_over_radians
            and gravity_over_turns < 1.05 * radians
            and fit.has_wave_number(TURN)
        )
        cogging = min(fit.compute_misfit(np.sin(order * q), np.cos(order * q)) for order in ORDERS)
        is_turns = (gravity_over_turns < CLEAR * radians or has_turn_period) and gravity_over_turns < 1.05 * cogging
        if radians > 1e-3 * np.sqrt(len(q)) and is_turns:
            return UnitSuspicion("rev", _find_range(position), gravity_over_turns / max(radians, gravity_over_radians))
    suspicion = _suspect_degrees(position, fit)
    if suspicion is None or not suspicion.is_certain:
        return suspicion
    return replace(suspicion, is_certain=not (torque.any() and has_one_frequency(fit.position, fit.period)))


def suspect_radians(position: Array, torque: Array, rate: float, factor: float) -> UnitSuspicion | None:
    """Find radians in an angle (N,) that was read as degrees or turns, from the torque of gravity.

    `factor` undoes the conversion of the column. The misfit is below `CLEAR` times that in the unit of the column.
    """
    if (fit := AccelerationFit.from_motion(position, torque, rate)) is None:
        return None
    as_read, radians = fit.compute_misfit_with_spring(), fit.compute_misfit_in_unit(factor)
    if radians >= CLEAR * as_read:
        return None
    return UnitSuspicion("rad", _find_range(position), radians / as_read) if fit.has_wave_number(factor) else None


def _suspect_degrees(position: Array, fit: AccelerationFit) -> UnitSuspicion | None:
    """Find degrees if gravity fits them better, for a position that covers more than 2 pi."""
    if np.ptp(position) <= 2 * np.pi:
        return None
    v, count = fit.velocity, len(fit.velocity)
    radians, degrees = (fit.compute_misfit_in_unit(factor) for factor in (1.0, DEGREE))
    no_gravity = fit.compute_misfit()
    # In 100 real and simulated runs, the ratio is below 0.945 for degrees and above 0.975 for radians.
    if degrees >= 0.96 * min(radians, no_gravity) or no_gravity <= 1e-3 * np.sqrt(count):  # [rad/s^2], noise only
        return None
    time = np.linspace(-1.0, 1.0, count)
    alternative = min(
        radians,
        fit.compute_misfit(np.maximum(v, 0.0)),
        fit.compute_misfit(v * np.abs(v)),
        fit.compute_misfit(time, time**2),
    )
    tolerance = 0.01 * no_gravity  # ignores differences of tiny misfits
    if degrees + tolerance >= 0.96 * (min(alternative, no_gravity) + tolerance):
        return None
    return UnitSuspicion("deg", _find_range(position), degrees / radians, is_certain=bool(np.ptp(position) > WOUND))


def _find_range(position: Array) -> tuple[float, float]:
    return float(position.min()), float(position.max())
