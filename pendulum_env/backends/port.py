"""Interface of backends (simulation, recording, rig): a torque in and a measurement out, once per period."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple, Protocol

import numpy as np

from pendulum_env.backends.sensing import Sensor
from pendulum_env.physics import Model
from pendulum_env.recording import Recording


class Status(Enum):
    """State of a backend; the value says what it means for the episode."""

    RUNNING = "the joint obeys the torque"
    ENDED = "there is nothing more to measure: reset to start again"
    FAULT = "the drive has stopped: the sample's fault says why"


class Timing(NamedTuple):
    """Timing of a rig."""

    jitter: float  # how late the sample was taken after its tick [s]
    overruns: int  # ticks of this run that had passed already when their turn came


class Sample(NamedTuple):
    """Measurement at the end of the period of a torque."""

    time: float  # since `enable` [s]
    position: float  # unwrapped, as the encoder reads it [rad]
    velocity: float | None  # [rad/s]; None where only the position is measured
    torque: float  # applied over the period that ends now [N m]; 0 before the first
    status: Status = Status.RUNNING
    fault: str | None = None
    timing: Timing | None = None  # of a rig


@dataclass(frozen=True)
class Start:
    """Initial state of a simulated run; a rig or a recording ignores it."""

    position: float = 0.0  # [rad]
    velocity: float = 0.0  # [rad/s]
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    clear_fault: bool = False  # of a rig: the user confirms that the cause of a fault is gone


@dataclass(frozen=True)
class Traits:
    """Properties of a backend."""

    rate: float  # samples per second [Hz]
    counts: int | None = 0  # of the encoder per turn; 0 is exact, None where the measurement itself has to tell
    max_torque: float = math.inf  # largest torque that is let pass [N m]
    simulated: bool = False  # whether the plant is a model, that can start anywhere and be replaced
    recording: Recording | None = None  # what is played, whatever the torque, if that is all

    @property
    def follows(self) -> bool:
        """Return whether the torque moves the joint; in a recording, it does not."""
        return self.recording is None


class Backend(Protocol):
    """Pendulum with a torque input; `open, enable, exchange ..., disable, close`, where close never raises.

    A backend that is no machine needs no more than `enable` and `exchange`.

    Attributes:
        traits: what it is.
    """

    traits: Traits

    def open(self) -> None:
        """Get hold of what is needed; the joint stays without power."""
        return

    def enable(self, start: Start) -> Sample:
        """Begin a run, with zero torque: the first measurement, at time 0."""

    def exchange(self, torque: float) -> Sample:
        """Apply a torque [N m] for one period, then measure."""

    def disable(self) -> None:
        """End a run: no torque."""
        return

    def close(self) -> None:
        """Let go of everything; may be called at any time, and twice."""
        return


@dataclass(frozen=True)
class Setup:
    """Arguments of the environment; each backend uses some of them."""

    model: Model  # plant to simulate, with its effects
    rate: float  # samples per second [Hz]
    substeps: int  # integration steps in a period
    sensor: Sensor  # encoder and torque measurement of a simulated plant
    recording: str | None = None  # file to replay
    config: str | None = None  # file that describes the rig

    @property
    def period(self) -> float:
        """Return the time between samples [s]."""
        return 1.0 / self.rate


Maker = Callable[[Setup], Backend]
