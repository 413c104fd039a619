"""Interface of adapters: a motor drive with a torque command and encoder counts.

Adapters neither judge nor wait for the next sample: the guard does the one, the rig the other, for all of them.
Installed packages offer further adapters by the entry points of `ENTRY_POINTS`: see docs/how-to/drive.md.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NamedTuple, Protocol

from pendulum_env.errors import UserError, format_error, shorten_error
from pendulum_env.lookup import find

ENTRY_POINTS = "pendulum_ident.drives"
HERE = "pendulum_env.backends.hardware"
BUILT_IN = {
    "serial": EntryPoint("serial", f"{HERE}.serial_drive:SerialDrive", ENTRY_POINTS),
    "nidaq": EntryPoint("nidaq", f"{HERE}.nidaq:NiDaq", ENTRY_POINTS),
}
OPENING = 2.0  # [s] to wait at least for an answer of a drive that opens, without power: it may set itself up


class DriveError(RuntimeError):
    """Drive that cannot be reached or does not obey; the message has the fault and the remedy."""


@contextmanager
def driver_errors(what: str, remedy: str) -> Iterator[None]:
    """Turn any error of a driver into a DriveError with the fault and the remedy.

    Raises:
        DriveError: if one does.
    """
    try:
        yield
    except DriveError:
        raise
    except Exception as error:
        raise DriveError(f"{what} ({shorten_error(error)}): {remedy}") from None


class Reading(NamedTuple):
    """Reading of a drive."""

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
        """Return counts and faults now, powered or not."""

    def disable(self) -> None:
        """Set zero torque, then cut the power."""

    def close(self) -> None:
        """Let go, at any time and as often as one likes; never raises."""


class Settings(Protocol):
    """Settings of an adapter: a frozen dataclass with the keys of its table in `rig.toml`."""

    @property
    def device(self) -> str:
        """Name of the device, which one process at a time may use."""


class Adapter(Protocol):
    """Class of a drive. Called with the `RigConfig`, whose `link` has the settings, it makes the drive."""

    settings: type[Settings]

    def __call__(self, config: Any, /) -> Drive:
        """Make the drive, not yet open."""


def list_adapters() -> dict[str, EntryPoint]:
    """List all known adapters by name, none of them loaded."""
    return {point.name: point for point in entry_points(group=ENTRY_POINTS)} | BUILT_IN


def find_adapter(name: str) -> Adapter:
    """Load the adapter of a name; the packages that it needs are imported now.

    Raises:
        UserError: if there is none, or what a package offers cannot be used.
        ModuleNotFoundError: if the extra `hardware` is not installed.
    """
    found = find("adapter", name, list_adapters())
    try:
        adapter: Adapter = found.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever another package does wrong must not end this one
        if name in BUILT_IN and isinstance(error, ModuleNotFoundError):
            raise ModuleNotFoundError(
                f"the {name} rig needs {error.name}: pip install 'pendulum-ident[hardware]'"
            ) from None
        why = shorten_error(format_error(error))
        raise UserError(
            f"the adapter '{name}' cannot be loaded from {found.value} ({why}): mend or reinstall its package"
        ) from None
    settings = getattr(adapter, "settings", None)
    if not (isinstance(settings, type) and is_dataclass(settings)):
        raise UserError(f"the adapter '{name}' ({found.value}) has no dataclass 'settings': see docs/how-to/drive.md")
    return adapter
