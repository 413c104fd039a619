"""The record that everything else works on: uniformly sampled time, position and torque."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from pendulum_env._typing import Array


class RecordingError(ValueError):
    """A recording cannot be used; the message is one sentence with where, why and what to do about it."""


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """N samples of one run, uniform in time, all finite; the arrays are read-only float64 views.

    `torque[k]` is held from `time[k]` to `time[k + 1]` (zero-order hold, as a DAC does it), while `position[k]` and
    `velocity[k]` are taken at the instant `time[k]`.

    Raises:
        RecordingError: if the arrays differ in shape, hold fewer than two samples, are not finite, or if time is not
            uniform and increasing. Files with slightly uneven time are mended by `read_recording`, not here.
    """

    name: str
    time: Array  # (N,) [s]
    position: Array  # (N,) [rad], unwrapped, 0 hangs down, counter-clockwise positive
    torque: Array  # (N,) [N m]
    velocity: Array | None = None  # (N,) [rad/s], as the sensor reports it; None if it was not recorded
    notes: tuple[str, ...] = ()  # what was changed at reading, e.g. "resampled to 333.3 Hz"

    def __post_init__(self) -> None:
        for quantity in ("time", "position", "torque", "velocity"):
            values = getattr(self, quantity)
            if values is not None:
                object.__setattr__(self, quantity, self._column(quantity, values))
        if len(self.time) < 2:
            raise RecordingError(f"recording {self.name!r} holds {len(self.time)} samples and needs at least 2")
        if not is_uniform(self.time):
            raise RecordingError(
                f"recording {self.name!r} has time that is not uniform and increasing: resample it, "
                "or write it to a file and use read_recording, which does"
            )

    def _column(self, quantity: str, values: ArrayLike) -> Array:
        try:
            column = np.asarray(values, dtype=np.float64).view()
        except (TypeError, ValueError) as error:
            raise RecordingError(f"recording {self.name!r} has {quantity} that is not numbers: {error}") from None
        if column.shape != (length := np.shape(self.time)) or column.ndim != 1:
            raise RecordingError(
                f"recording {self.name!r} has {quantity} of shape {column.shape} with time of shape {length}: "
                "all arrays must be one-dimensional and equally long"
            )
        if not np.isfinite(column).all():
            raise RecordingError(f"recording {self.name!r} has {quantity} that is not finite: remove NaN and inf")
        column.flags.writeable = False
        return column

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        return f"<Recording {self.name!r}: {self.summary}>"

    def _repr_html_(self) -> str:
        from pendulum_env.notebook import show_recording  # only a notebook asks for it

        return show_recording(self)

    @property
    def summary(self) -> str:
        """Length, rate and number of samples: `30 s at 1000 Hz, 30000 samples`."""
        return f"{self.duration:.3g} s at {self.rate:.6g} Hz, {len(self)} samples"

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return (len(self) - 1) / self.duration

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    def slice(self, start: int | None, stop: int | None) -> Self:
        """Samples start to stop - 1, indices as in Python slicing; time is not shifted. Needs at least two samples."""
        part = slice(start, stop)
        velocity = None if self.velocity is None else self.velocity[part]
        return replace(
            self, time=self.time[part], position=self.position[part], torque=self.torque[part], velocity=velocity
        )

    def split(self, fraction: float) -> tuple[Self, Self]:
        """The first `fraction` of the samples, and the rest: `train, holdout = recording.split(0.7)`.

        Raises:
            RecordingError: if either part would hold fewer than two samples.
        """
        cut = round(fraction * len(self))
        if not 2 <= cut <= len(self) - 2:
            raise RecordingError(
                f"recording {self.name!r} cannot be split at {fraction:g} of {len(self)} samples: "
                "both parts need at least 2, choose a fraction between 0 and 1"
            )
        return self.slice(None, cut), self.slice(cut, None)


def is_uniform(time: Array) -> bool:
    """Whether time (N,) [s] is an increasing uniform grid, up to 1e-6 of a step and the rounding of float64."""
    step = (time[-1] - time[0]) / (len(time) - 1)
    return bool(step > 0 and unevenness(time) <= 1e-6 * step + 4 * np.spacing(np.abs(time[[0, -1]]).max()))


def unevenness(time: Array) -> float:
    """Largest distance [s] of time (N,) from the uniform grid with the same ends."""
    distance = np.linspace(time[0], time[-1], len(time))
    distance -= time  # in place: recordings may be large
    return float(np.abs(distance, out=distance).max())
