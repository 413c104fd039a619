"""Recordings: time, position and torque, uniformly sampled between gaps."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import singledispatch
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from pendulum_env._typing import Array
from pendulum_env.errors import ColumnError, RecordingError
from pendulum_env.notebook import Shown
from pendulum_env.physics.mechanism import LinkLoad
from pendulum_env.recording.actuator import MOTOR, Actuator
from pendulum_env.recording.angle_unit import suspect_unit
from pendulum_env.recording.channel import NEWTON_METRE, Load, TorqueConstant
from pendulum_env.recording.clock import LOOSE, count_from_zero, count_seconds, find_date, is_uniform, sum_durations
from pendulum_env.recording.columns import FileColumn
from pendulum_env.recording.notes import Note, warn_of_notes
from pendulum_env.recording.origin import Origin
from pendulum_env.recording.rounding import compute_steps
from pendulum_env.recording.vocabulary import QUANTITIES
from pendulum_env.units import JointUnits

ARRAYS = "{'time': time, 'position': position, 'torque': torque}"  # argument of `read_recording`, in messages
NO_TORQUE = 1e-9  # [N m], largest rounding error of zero torque
BEYOND_NOISE = 3.0  # least ratio of a load torque to its noise
NOISE_ORDER = 4  # order of differences, which remove the load torque but not its noise
NOISE_GAIN = 0.6745 * 70**0.5  # median of |differences| per standard deviation; 70: squares of 1, -4, 6, -4, 1


class MovedTorque(NamedTuple):
    """Noise of a torque that was moved in time.

    Attributes:
        noise: standard deviation of the white noise before the move [N m].
        response: impulse response of the filter that moved the torque (L,), with an answer of odd length about zero.
            It leaves out the inverse of a filter of the log that filtered the noise, too.
        is_sampled: whether torque was sampled while changing, so that a jump may be anywhere between samples.
        answer: slope of this noise over the noise of the position [N m/rad]: a controller answers its encoder.
    """

    noise: float
    response: Array
    is_sampled: bool = True
    answer: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown):
    """N finite samples of one run, in segments of uniform time; the arrays are read-only float64 views.

    Samples of all segments are concatenated, and time increases. Time is uniform within segments, with one period for
    the whole recording; motion in the gaps between segments is unknown. Filters, integrals and simulations therefore
    restart in each of `segments`. Time since 1970 or dates (datetime64) are converted to time from the first sample,
    with the date in `start_date`.

    Without torque, the recording is a free swing with zero torque.

    `torque[k]` is held from `time[k]` to `time[k + 1]` (zero-order hold, as of a DAC); `position[k]` and `velocity[k]`
    are sampled at `time[k]`. While the motor is off (`enabled` 0), torque is zero. `load_torque[k]` is an external
    torque at `time[k]`, with the sign of `torque`; both add up.

    Raises:
        RecordingError: if the arrays differ in shape, a segment has fewer than two samples, values are not finite, time
            is not uniform and increasing, or gravity shows that position is in degrees or turns. `read_recording`
            accepts gaps and jitter.
    """

    time: Array  # (N,) [s]
    position: Array  # (N,) [rad], unwrapped, 0 hangs down, counter-clockwise positive
    torque: Array = None  # type: ignore[assignment]  # (N,) [N m]; default zero
    velocity: Array | None = None  # (N,) [rad/s], of the sensor; None if not recorded
    notes: tuple[Note, ...] = ()  # changes and guesses while reading
    starts: tuple[int, ...] = (0,)  # index of the first sample of each segment
    reference: Array | None = None  # (N,) of the controller [rad], of a speed controller [rad/s]
    supply: Array | None = None  # (N,) [V], bus voltage
    enabled: Array | None = None  # (N,), 1 while the motor is on and 0 while it is off
    temperature: Array | None = None  # (N,) [deg C], temperature of the joint
    load_torque: Array | None = None  # (N,) [N m], measured at the output, positive if it moves the joint forward
    load: Load | None = None  # known load on the joint; None if unknown
    torque_unit: str = NEWTON_METRE  # or the unit of a current with unknown gain, `A`
    torque_constant: TorqueConstant | None = None  # constant that converted a current to the torque
    known_inertia: float = 0.0  # [kg m^2], scale of a free swing; 1 if torque is per inertia, 0 if unknown
    drive: Actuator | None = None  # controller that follows the reference
    moved: MovedTorque | None = None  # noise of a torque that was moved in time
    origin: Origin | None = None  # columns of the file
    start_date: datetime | None = None  # date of the file's first sample
    clock_start: float = 0.0  # [s], time 0 on the clock of the log
    log_format: Mapping[str, Any] = field(default_factory=dict)  # reading options, as keys of a study
    name: str = field(default="recording", kw_only=True)
    is_checked: bool = field(default=False, kw_only=True)  # whether time and units were checked

    def __post_init__(self) -> None:
        if (time := np.asarray(self.time)).dtype.kind in "mM":  # dates or durations
            seconds, date = count_seconds(time)
            object.__setattr__(self, "time", seconds)
            self._set_start(date, date.timestamp() if date else 0.0)
        for quantity in QUANTITIES:
            values = getattr(self, quantity)
            if quantity == "torque" and values is None:
                values = np.zeros(self.get_shape(quantity))
            if values is not None:
                object.__setattr__(self, quantity, self._convert_column(quantity, values))
        if self.enabled is not None:  # commands to a motor that is off have no effect
            object.__setattr__(self, "torque", self._convert_column("torque", self.torque * (self.enabled > 0)))
        if len(self.time) < 2:
            raise RecordingError(f"recording {self.name!r} holds {len(self.time)} samples and needs at least 2")
        object.__setattr__(self, "starts", tuple(int(start) for start in self.starts))
        bounds = (*self.starts, len(self.time))
        if bounds[0] != 0 or np.diff(bounds).min() < 2:
            raise RecordingError(
                f"recording {self.name!r} has segments that start at {self.starts} of {len(self.time)} samples: "
                "the first starts at 0, and each needs at least 2"
            )
        if not is_uniform(self.time, self.starts, LOOSE):
            raise RecordingError(
                f"recording {self.name!r} has time that is not uniform and increasing: read it with "
                f"read_recording({ARRAYS}), which makes it uniform and ends segments at gaps"
            )
        date = find_date(float(self.time[0]))
        if date is not None or not is_uniform(self.time - self.time[0], self.starts, LOOSE):  # steps rounded by float64
            self._set_start(date, float(self.time[0]))
            object.__setattr__(self, "time", self._convert_column("time", count_from_zero(self.time, self.starts)))
        if self.origin is None and self.position.ndim == 1 and not self.is_checked:
            self._check_unit()
        object.__setattr__(self, "is_checked", True)

    def start_from_zero(self) -> Self:
        """Return the recording with time from its first sample; `clock_start` has the time before."""
        if (start := float(self.time[0])) == 0.0:
            return self
        return replace(self, time=self.time - start, clock_start=self.clock_start + start)

    def _set_start(self, date: datetime | None, seconds: float) -> None:
        """Set the date of the first sample, unless given, and add its time [s] to the start of the clock."""
        object.__setattr__(self, "start_date", self.start_date or date)
        object.__setattr__(self, "clock_start", self.clock_start + seconds)

    def _check_unit(self) -> None:
        """Refuse degrees or turns; add a note and warn if the unit is uncertain."""
        part = max(self.segment_slices, key=lambda run: run.stop - run.start)
        suspicion = suspect_unit(self.position[part], self.torque[part], self.rate)
        if suspicion is None:
            return
        columns = {"position": f"position:{suspicion.unit}"}
        if suspicion.is_certain:
            raise ColumnError(
                f"recording {self.name!r}: {suspicion.text}: read it with read_recording({ARRAYS}, columns={columns}) "
                f"if it is in {suspicion.name}, with 'position:rad' if it is not"
            )
        note = suspicion.note(columns)
        object.__setattr__(self, "notes", (*self.notes, note))
        warn_of_notes(f"recording {self.name!r}", [note])

    def _convert_column(self, quantity: str, values: ArrayLike) -> Array:
        try:
            column = np.asarray(values, dtype=np.float64).view()
        except (TypeError, ValueError) as error:
            raise RecordingError(f"recording {self.name!r} has {quantity} that is not numbers: {error}") from None
        if column.shape != (shape := self.get_shape(quantity)) or len(np.shape(self.time)) != 1:
            raise RecordingError(
                f"recording {self.name!r} has {quantity} of shape {column.shape} with time of shape "
                f"{np.shape(self.time)}, where {shape} is needed: all arrays must be equally long, time one-dimensional"
            )
        if not np.isfinite(column).all():
            raise RecordingError(f"recording {self.name!r} has {quantity} that is not finite: remove NaN and inf")
        column.flags.writeable = False
        return column

    def get_shape(self, quantity: str) -> tuple[int, ...]:
        """Return the shape of a quantity."""
        return np.shape(self.time)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r}: {self.summary}>"

    @property
    def units(self) -> JointUnits:
        """Return the units of quantities; the joint is linear if the file's position is in metres."""
        return JointUnits(self.torque_unit, self.origin is not None and self.origin.is_prismatic)

    @property
    def _position_column(self) -> FileColumn | None:
        """Return the column of the position in the file; None if it is unknown, or is that of a velocity."""
        return None if self.origin is None or self.has_integrated_position else self.origin.columns["position"]

    @property
    def position_step(self) -> float:
        """Return the least change of the position from row to row of a file [rad]; 0 if unknown."""
        column = self._position_column
        return 0.0 if column is None else abs(column.scale) * column.step

    @property
    def position_steps(self) -> Array | None:
        """Return the step of each position by significant digits (N,) [rad], of a file; None for a constant step."""
        column = self._position_column
        if column is None or column.digits is None:
            return None
        return abs(column.scale) * compute_steps((self.position - column.offset) / column.scale, column.digits)

    @property
    def summary(self) -> str:
        """Return duration, rate and number of samples as text: `30 s at 1000 Hz, 30000 samples`."""
        parts = f" in {len(self.starts)} segments" if len(self.starts) > 1 else ""
        return f"{self.duration:.3g} s at {self.rate:.6g} Hz, {len(self)} samples{parts}"

    @property
    def rate(self) -> float:
        """Return the sample rate within segments [Hz]."""
        return (len(self) - len(self.starts)) / self.duration

    @property
    def duration(self) -> float:
        """Return the sum of the durations of all segments [s]."""
        return sum_durations(self.time, self.starts)

    @property
    def segment_slices(self) -> tuple[slice, ...]:
        """Return the samples of each segment."""
        return tuple(map(slice, self.starts, (*self.starts[1:], len(self))))

    @property
    def segments(self) -> tuple[Self, ...]:
        """Return the recordings of all segments; the recording itself without gaps."""
        if len(self.starts) == 1:
            return (self,)
        return tuple(self.slice(part.start, part.stop) for part in self.segment_slices)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the joints (n,); the joint of a pendulum has an empty name."""
        return ("",)

    @property
    def joints(self) -> tuple["Recording", ...]:
        """Return the recording of each joint (n,)."""
        return (self,)

    @property
    def link_load(self) -> LinkLoad | None:
        """Return the known load on a link; None for a joint without links."""
        return None

    @property
    def columns(self) -> dict[str, Array]:
        """Return the recorded series (N,) by the names of the columns of a file."""
        return self.series

    @property
    def series(self) -> dict[str, Array]:
        """Return the recorded series by quantity, (N,) each, or (N, n) for quantities of n joints."""
        values_by_quantity = {quantity: getattr(self, quantity) for quantity in QUANTITIES}
        return {quantity: values for quantity, values in values_by_quantity.items() if values is not None}

    @property
    def powered(self) -> Array:
        """Return 1 while the motor is on and 0 while it is off (N,); 1 if not recorded."""
        return np.ones(len(self)) if self.enabled is None else self.enabled

    @property
    def has_torque(self) -> bool:
        """Return whether a motor torque, or a load torque above its noise, acts on the joint."""
        if (np.abs(self.torque) > NO_TORQUE).any():
            return True
        if self.load_torque is None:
            return False
        noise = float(np.median(np.abs(np.diff(self.load_torque, NOISE_ORDER)))) if len(self) > NOISE_ORDER else 0.0
        size = float(np.sqrt(np.mean(self.load_torque**2)))
        return size > max(NO_TORQUE, BEYOND_NOISE * noise / NOISE_GAIN)

    @property
    def has_varying_load(self) -> bool:
        """Return whether a measured load torque changes."""
        return self.load_torque is not None and bool(np.ptp(self.load_torque) > 0)

    @property
    def actuator(self) -> Actuator:
        """Return the controller of the joint, or a motor with logged torque."""
        return self.drive or MOTOR

    @property
    def has_logged_torque(self) -> bool:
        """Return whether torque was logged or is zero, and is not computed from a controller."""
        return not self.actuator.is_controller or self.origin is None or "torque" in self.origin.columns

    @property
    def is_free(self) -> bool:
        """Return whether the joint swings freely, without torque and controller."""
        return not (self.actuator.is_controller or self.has_torque)

    @property
    def has_integrated_position(self) -> bool:
        """Return whether position is the integral of the velocity, from an unknown zero."""
        return self.origin is not None and self.origin.has_integral

    @property
    def goal(self) -> Array | None:
        """Return the reference of a position controller (N,) [rad], or None."""
        return self.reference if self.actuator.acts_on_position else None

    def convert_to_newton_metres(self, constant: TorqueConstant) -> Self:
        """Return the recording with torque in N m; the torque constant becomes the gain of its controller."""
        torque, drive = constant.value * self.torque, self.drive and self.drive.with_gain(constant.value, constant.of)
        return replace(self, torque=torque, torque_unit=NEWTON_METRE, torque_constant=constant, drive=drive)

    def slice(self, start: int | None, stop: int | None) -> Self:
        """Return the samples start to stop - 1, as in Python slicing, with unchanged time.

        A single remaining sample of the first or last segment is dropped.
        """
        first, end, _ = slice(start, stop).indices(len(self))
        if first + 1 in self.starts:
            first += 1
        if end - 1 in self.starts:
            end -= 1
        part = slice(first, max(first, end))
        series: dict[str, Any] = {quantity: values[part] for quantity, values in self.series.items()}
        return replace(
            self,
            **series,
            starts=(0, *(begin - first for begin in self.starts if first < begin < end)),
        )

    def split(self, fraction: float) -> tuple[Self, Self]:
        """Return the first `fraction` of the samples and the rest: `train, holdout = recording.split(0.7)`."""
        index = round(fraction * len(self))
        if not 2 <= index <= len(self) - 2:
            raise RecordingError(
                f"recording {self.name!r} cannot be split at {fraction:g} of {len(self)} samples: "
                "both parts need at least 2, choose a fraction between 0 and 1"
            )
        return self.slice(None, index), self.slice(index, None)


@singledispatch
def complete_torque(actuator: Actuator, recording: Recording) -> Recording:
    """Return a recording of an actuator with its torque, by the function that is registered for its type."""
    return recording
