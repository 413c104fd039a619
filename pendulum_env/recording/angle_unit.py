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
HALF_WIDTHS = (0.02, 0.05, 0.1, 0.2)  # [s], half widths of the windows; the best depends on the noise of the encoder
FEWEST, MOST = 50, 1000  # least and largest number of windows
MOVING = 0.03  # least speed of a window, as a share of the fast speed
ONE_WAY = 1 - 1e-9  # least mean of sgn q' in a window
CLEAR = 0.85  # ratio to the misfit in the unit of the column below which another unit is found
NOISE = 1e-3  # [rad/s^2], misfit that any recording may have
ORDERS, TIED = (5, 6, 7), 1.05  # orders of cogging over radians that resemble gravity over turns, which fits them less
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
class AccelerationFits:
    """Regressions of the acceleration on torque, friction, springs and gravity, in R windows between reversals.

    All series are averaged under the same window, so that a long window lowers noise without a bias.

    Attributes:
        position: position of each sample (N,) [rad].
        kernel: weights of a window (2 m + 1,).
        is_used: mask of the windows (N - 2 m,).
        acceleration: mean acceleration of each window (R,) [rad/s^2].
        known: columns of torque and of a constant (R, 2).
        friction: columns of viscous and dry friction (R, 2).
    """

    position: Array
    kernel: Array
    is_used: Mask
    acceleration: Array
    known: Array
    friction: Array

    @classmethod
    def from_motion(cls, position: Array, torque: Array, rate: float, half: int) -> "AccelerationFits | None":
        """Average the samples in blocks of about 5 ms, and 2 `half` + 1 blocks in windows; return None for too few.

        The torque is averaged as the acceleration: it accelerates a rotor of unit inertia, with the same averages.
        """
        stride = _choose_stride(rate)
        count, period = min(len(position) // stride, 100_000), stride / rate
        if count < 4 * half + 2:
            return None
        held = torque - torque.mean()
        speed = np.cumsum(held) - held
        rotor = np.cumsum(speed + 0.5 * held) - (speed + 0.5 * held)  # times the squared rate
        q, free = (x[: count * stride].reshape(count, stride).mean(axis=1) for x in (position, rotor))
        kernel = (1.0 - np.linspace(-1.0, 1.0, 2 * half + 1) ** 2) ** 4
        kernel /= kernel.sum()
        velocity = filter_savitzky_golay(q, 2 * (half // 2) + 3, 3, 1, period)[1:-1]
        series = np.diff(q, 2) / period**2, np.diff(free, 2), (q[2:] - q[:-2]) / (2 * period), np.sign(velocity)
        a, u, v, sign = (np.convolve(each, kernel, "valid") for each in series)
        speed = np.abs(v)
        is_used = (np.abs(sign) > ONE_WAY) & (speed > MOVING * np.percentile(speed, 95))
        is_used &= np.arange(len(v)) % max(1, half // 2, len(v) // MOST) == 0
        if np.count_nonzero(is_used) < FEWEST:
            return None
        columns = np.column_stack([u / max(float(np.abs(u).max()), 1e-300), np.ones(len(u)), v, sign])[is_used]
        return cls(q[1:-1], kernel, is_used, a[is_used], columns[:, :2], columns[:, 2:])

    def average(self, series: Array) -> Array:
        """Return the mean of a series (N,) in each window (R,)."""
        return np.asarray(np.convolve(series, self.kernel, "valid")[self.is_used])

    def compute_misfit(self, *free: Array, spring: bool = False) -> float:
        """Return the RMS residual [rad/s^2] with some columns (R,).

        Friction and the linear part of a spring oppose the motion; its quadratic part may have any sign.
        """
        opposing, known = [*self.friction.T], np.column_stack([self.known, *free])
        if spring:
            opposing.append(self.average(self.position))
            known = np.column_stack([known, self.average(self.position**2)])
        columns = np.column_stack([known, *opposing])
        columns /= np.maximum(np.abs(columns).max(axis=0), 1e-300)
        triangle = np.asarray(np.linalg.qr(np.column_stack([columns, self.acceleration]), mode="r"))
        phi, y, used = triangle[:, :-1], triangle[:, -1], list(range(columns.shape[1]))
        theta = np.linalg.lstsq(phi, y, rcond=None)[0]
        while (theta[known.shape[1] :] > 0).any():  # what opposes the motion has a negative factor
            del used[known.shape[1] + int(np.argmax(theta[known.shape[1] :]))]
            theta = np.linalg.lstsq(phi[:, used], y, rcond=None)[0]
        residual = y - phi[:, used] @ theta
        return float(np.linalg.norm(residual) / np.sqrt(max(1, len(self.acceleration) - columns.shape[1])))

    def compute_misfit_in_unit(self, factor: float, *free: Array, spring: bool = False) -> float:
        """Return the misfit [rad/s^2] with gravity about any zero, if position times `factor` is in radians."""
        sine, cosine = (self.average(wave(factor * self.position)) for wave in (np.sin, np.cos))
        return min(self.compute_misfit(*waves, *free, spring=spring) for waves in ((sine,), (sine, cosine)))

    def compute_misfit_of_alternatives(self, spring: bool = False) -> float:
        """Return the least misfit [rad/s^2] of laws over radians that resemble gravity in another unit."""
        time, speed = np.linspace(-1.0, 1.0, len(self.acceleration)), self.friction[:, 0]
        drift = np.column_stack([time, time**2])
        laws = ((), (np.maximum(speed, 0.0),), (speed * np.abs(speed),), (*drift.T,))
        return min(self.compute_misfit_in_unit(1.0, *law, spring=spring) for law in laws)

    def compute_misfit_of_cogging(self) -> float:
        """Return the least misfit [rad/s^2] of gravity and cogging over radians that resemble gravity over turns."""
        waves = ([self.average(wave(order * self.position)) for wave in (np.sin, np.cos)] for order in ORDERS)
        return min(self.compute_misfit_in_unit(1.0, *columns) for columns in waves)


def suspect_unit(position: Array, torque: Array, rate: float, *, turns: bool = True) -> UnitSuspicion | None:
    """Find another unit of an angle (N,) that was read as radians, from the torque of gravity.

    Another unit is found if gravity over it explains the acceleration with a misfit below `CLEAR` times that of gravity
    and other laws over radians, in windows of at least one length. A spring is one of these laws for turns, which must
    also fit as well as gravity with cogging of an order near 2 pi. Degrees must cover more than 2 pi. They are
    uncertain if a spring over radians explains the motion, too: below 30 degrees the sine is linear. They are also
    uncertain for driven motion of one frequency, in which position is proportional to acceleration and gravity may
    imitate an error of the torque.

    Args:
        position: uniformly sampled angle of one segment (N,).
        torque: torque (N,) in any unit.
        rate: samples per second [Hz].
        turns: whether to test for turns.
    """
    has_range, is_wound = np.ptp(position) > 2 * np.pi, np.ptp(position) > WOUND
    found = list[UnitSuspicion]()
    for fits in _list_fits(position, torque, rate):
        radians, with_spring = (fits.compute_misfit_of_alternatives(spring) for spring in (False, True))
        if turns and with_spring > NOISE:
            ratio = (misfit := fits.compute_misfit_in_unit(TURN)) / with_spring
            if ratio < CLEAR and misfit < TIED * fits.compute_misfit_of_cogging():
                found.append(UnitSuspicion("rev", _find_range(position), ratio))
        if has_range and radians > NOISE:
            ratio = (misfit := fits.compute_misfit_in_unit(DEGREE)) / radians
            if ratio < CLEAR:
                is_certain = bool(is_wound or misfit < CLEAR * with_spring)
                found.append(UnitSuspicion("deg", _find_range(position), ratio, is_certain))
    best = min(found, key=lambda suspicion: suspicion.residual, default=None)
    if best is None or best.unit == "rev" or not (torque.any() and has_one_frequency(position, 1.0 / rate)):
        return best
    return replace(best, is_certain=False)


def suspect_radians(position: Array, torque: Array, rate: float, factor: float) -> UnitSuspicion | None:
    """Find radians in an angle (N,) that was read as degrees or turns, from the torque of gravity.

    `factor` undoes the conversion of the column. The misfit is below `CLEAR` times that in the unit of the column.
    """
    misfits = [
        (fits.compute_misfit_of_alternatives(spring=True), fits.compute_misfit_in_unit(factor))
        for fits in _list_fits(position, torque, rate)
    ]
    ratio = min((radians / as_read for as_read, radians in misfits if as_read > NOISE), default=1.0)
    return UnitSuspicion("rad", _find_range(position), ratio) if ratio < CLEAR else None


def _list_fits(position: Array, torque: Array, rate: float) -> list[AccelerationFits]:
    """List the fits in windows of each length with enough windows."""
    halves = {max(3, round(half_width * rate / _choose_stride(rate))) for half_width in HALF_WIDTHS}
    fits = (AccelerationFits.from_motion(position, torque, rate, half) for half in sorted(halves))
    return [each for each in fits if each is not None]


def _choose_stride(rate: float) -> int:
    """Return the number of samples in a block of about 5 ms."""
    return max(1, round(rate / 200.0))


def _find_range(position: Array) -> tuple[float, float]:
    return float(position.min()), float(position.max())
