"""Interface of adapters, which send torque to an amplifier and read encoder counts.

Adapters do not check or pace: `Guard` limits the torque, and `Rig` waits for the next sample. Installed packages add
adapters by entry points of the group `ENTRY_POINTS`; see docs/how-to/drive.md.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NamedTuple, Protocol

from pendulum_env.errors import UserError, format_error, shorten_error
from pendulum_env.lookup import find

ENTRY_POINTS = "pendulum_ident.drives"
PACKAGE = "pendulum_env.backends.hardware"
BUILT_IN = {
    "serial": EntryPoint("serial", f"{PACKAGE}.serial_adapter:SerialAdapter", ENTRY_POINTS),
    "nidaq": EntryPoint("nidaq", f"{PACKAGE}.nidaq:NiDaq", ENTRY_POINTS),
}
OPENING_TIMEOUT = 2.0  # [s], least timeout of an answer while an adapter opens and the amplifier may initialise


class DriveError(RuntimeError):
    """Error of an adapter or its amplifier; the message has the fault and the remedy."""


@contextmanager
def driver_errors(fault: str, remedy: str) -> Iterator[None]:
    """Turn any error of a driver into a DriveError with fault and remedy.

    Raises:
        DriveError: after any exception in the context.
    """
    try:
        yield
    except DriveError:
        raise
    except Exception as error:
        raise DriveError(f"{fault} ({shorten_error(error)}): {remedy}") from None


class Reading(NamedTuple):
    """Reading of an adapter."""

    time: float  # time of the counts on this computer's monotonic clock [s]
    counts: int  # encoder counts, modulo 2^32
    fault: str | None = None  # text of the amplifier's fault


class Sent(NamedTuple):
    """Torque that was sent."""

    time: float  # start of its action on this computer's monotonic clock [s]
    torque: float  # after the rounding of the command [N m]


class Adapter(Protocol):
    """Connection to an amplifier in torque mode. Order of calls: `open, enable, (write, read) ..., disable, close`.

    All but `close` may raise DriveError.
    """

    noise: float  # standard deviation of the time at which counts are taken [s]

    def open(self) -> None:
        """Connect, without power, and start the watchdog of the device if it has one."""

    def enable(self) -> None:
        """Clear faults of the amplifier and switch the power on, at zero torque."""

    def write(self, torque: float) -> Sent:
        """Set the torque [N m] and restart the watchdog of the device."""

    def read(self) -> Reading:
        """Return current counts and faults, with or without power."""

    def disable(self) -> None:
        """Set zero torque, then cut the power."""

    def close(self) -> None:
        """Disconnect; may be called at any time and repeatedly, and never raises."""


class Settings(Protocol):
    """Settings of an adapter: a frozen dataclass with the keys of its table in `rig.toml`."""

    @property
    def device(self) -> str:
        """Return the name of the device, which one process at a time may use."""


class AdapterClass(Protocol):
    """Class of an adapter, called with the `RigConfig`; its `link` has the settings."""

    settings: type[Settings]

    def __call__(self, config: Any, /) -> Adapter:
        """Make the adapter, not connected."""


def list_adapters() -> dict[str, EntryPoint]:
    """Return the entry points of all known adapters by name, without loading them."""
    return {point.name: point for point in entry_points(group=ENTRY_POINTS)} | BUILT_IN


def find_adapter(name: str) -> AdapterClass:
    """Load the class of an adapter by its name.

    Raises:
        UserError: if the name is unknown, or the adapter cannot be loaded.
        ModuleNotFoundError: if the extra `hardware` is not installed.
    """
    point = find("adapter", name, list_adapters())
    try:
        adapter: AdapterClass = point.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # also SystemExit of another package
        if name in BUILT_IN and isinstance(error, ModuleNotFoundError):
            raise ModuleNotFoundError(
                f"the {name} rig needs {error.name}: pip install 'pendulum-ident[hardware]'"
            ) from None
        reason = shorten_error(format_error(error))
        raise UserError(
            f"the adapter '{name}' cannot be loaded from {point.value} ({reason}): mend or reinstall its package"
        ) from None
    settings = getattr(adapter, "settings", None)
    if not (isinstance(settings, type) and is_dataclass(settings)):
        raise UserError(f"the adapter '{name}' ({point.value}) has no dataclass 'settings': see docs/how-to/drive.md")
    return adapter
