"""Interface of backends (simulation, replay, rig): one torque and one measurement per period."""

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
    """State of a backend; the value describes it."""

    RUNNING = "the joint obeys the torque"
    ENDED = "there is nothing more to measure: reset to start again"
    FAULT = "the drive has stopped: the sample's fault says why"


class Timing(NamedTuple):
    """Timing of a rig's sample."""

    jitter: float  # delay of the sample after its tick [s]
    overruns: int  # ticks of this run that were missed by a period or more


class Sample(NamedTuple):
    """Measurement at the end of a period."""

    time: float  # since `enable` [s]
    position: float  # of the encoder, unwrapped [rad]
    velocity: float | None  # [rad/s]; None if only the position is measured
    torque: float  # applied over the period that ends at `time` [N m]; 0 at the start
    status: Status = Status.RUNNING
    fault: str | None = None
    timing: Timing | None = None  # of a rig


@dataclass(frozen=True)
class Start:
    """Initial state of a simulated run; a rig or a recording ignores it."""

    position: float = 0.0  # [rad]
    velocity: float = 0.0  # [rad/s]
    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    clear_fault: bool = False  # of a rig: whether the cause of the fault is removed


@dataclass(frozen=True)
class Traits:
    """Properties of a backend."""

    rate: float  # samples per second [Hz]
    counts: int | None = 0  # encoder counts per turn; 0: exact, None: found from the data
    max_torque: float = math.inf  # largest torque [N m]
    simulated: bool = False  # whether the plant is a model with settable state and parameters
    recording: Recording | None = None  # replayed recording

    @property
    def follows(self) -> bool:
        """Return whether the joint follows the torque; False for a replay."""
        return self.recording is None


class Backend(Protocol):
    """Pendulum with a torque input. Order of calls: `open`, `enable`, `exchange` ..., `disable`, `close`.

    Simulations and replays need only `enable` and `exchange`.

    Attributes:
        traits: properties of the backend.
    """

    traits: Traits

    def open(self) -> None:
        """Acquire the resources; the joint stays without power."""
        return

    def enable(self, start: Start) -> Sample:
        """Begin a run at zero torque; return the measurement at time 0."""

    def exchange(self, torque: float) -> Sample:
        """Apply a torque [N m] for one period; return the measurement at its end."""

    def disable(self) -> None:
        """End a run at zero torque."""
        return

    def close(self) -> None:
        """Release the resources; may be called at any time and repeatedly, and never raises."""
        return


@dataclass(frozen=True)
class Setup:
    """Arguments of the environment for its backend."""

    model: Model  # plant to simulate, with its effects
    rate: float  # samples per second [Hz]
    substeps: int  # integration steps per period
    sensor: Sensor  # encoder and torque measurement of a simulated plant
    recording: str | None = None  # file to replay
    config: str | None = None  # file of the rig, rig.toml

    @property
    def period(self) -> float:
        """Return the time between samples [s]."""
        return 1.0 / self.rate


Maker = Callable[[Setup], Backend]
