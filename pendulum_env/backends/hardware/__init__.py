"""DM1015B rig: interface of its drives and the adapters."""

from pendulum_env.backends.hardware.drive import (
    OPENING_TIMEOUT,
    Drive,
    DriveError,
    Reading,
    Sent,
    Settings,
    driver_errors,
    find_adapter,
    list_adapters,
)

__all__ = [
    "OPENING_TIMEOUT",
    "Drive",
    "DriveError",
    "Reading",
    "Sent",
    "Settings",
    "driver_errors",
    "find_adapter",
    "list_adapters",
]
