"""What an adapter offers: a motor drive that takes a torque and tells the encoder's counts, and nothing else.

Adapters neither judge nor wait for the next sample: the guard does the one, the rig the other, for all of them.
"""

import importlib
import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple, Protocol

from pendulum_env.backends.hardware.config import LINKS, RigConfig
from pendulum_env.mistake import one_line

STILL_ON = "the drive says that it has power still: use the emergency stop"
OPENING = 2.0  # [s] to wait for an answer at least while the drive is opened, without power: it may set itself up


class DriveError(RuntimeError):
    """The drive cannot be reached or does not obey; the message says what happened and what to do about it."""


@contextmanager
def driver_errors(what: str, remedy: str) -> Iterator[None]:
    """Whatever a driver raises becomes a DriveError: what happened, and what to do; drivers raise what they like.

    Raises:
        DriveError: if one does.
    """
    try:
        yield
    except DriveError:
        raise
    except Exception as error:
        raise DriveError(f"{what} ({one_line(error)}): {remedy}") from None


class Reading(NamedTuple):
    """What a drive tells."""

    time: float  # when the counts were taken, on this computer's monotonic clock [s]
    counts: int  # of the encoder, modulo 2^32
    fault: str | None = None  # what the drive says is wrong, in words


class Sent(NamedTuple):
    """A torque that was sent."""

    time: float  # from which it acts, on this computer's monotonic clock [s]
    torque: float  # as the drive resolves it [N m]


class Drive(Protocol):
    """A drive in torque mode: `open, enable, (write, read) ..., disable, close`. All but `close` raise DriveError."""

    noise: float  # standard deviation of the time at which counts are taken [s]

    def open(self) -> None:
        """Connect; the motor stays without power. Start the drive's own watchdog as soon as there is one to start."""

    def enable(self) -> None:
        """Clear what faults can be cleared and give the motor power, at zero torque."""

    def write(self, torque: float) -> Sent:
        """Set the torque [N m] and feed the drive's watchdog."""

    def read(self) -> Reading:
        """Counts and faults now, powered or not."""

    def disable(self) -> None:
        """Zero torque, then no power."""

    def close(self) -> None:
        """Let go, at any time and as often as one likes; never raises."""


def need(adapter: str) -> None:
    """Refuse an adapter, or the emulator of its drive, whose packages are not installed.

    Raises:
        ModuleNotFoundError: with the command that installs them.
    """
    for package in LINKS[adapter].packages:
        if importlib.util.find_spec(package) is None:
            raise ModuleNotFoundError(f"the {adapter} rig needs {package}: pip install 'pendulum-ident[hardware]'")


def make_drive(config: RigConfig) -> Drive:
    """Drive of a configuration, not yet open; the packages that it needs are imported now.

    Raises:
        ModuleNotFoundError: if the extra `hardware` is not installed.
    """
    need(config.adapter)
    module, kind = config.link.drive
    drive: Drive = getattr(importlib.import_module(f"pendulum_env.backends.hardware.{module}"), kind)(config)
    return drive
