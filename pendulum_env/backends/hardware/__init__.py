"""DM1015B rig: interface of its adapters."""

from pendulum_env.backends.hardware.adapter import (
    OPENING_TIMEOUT,
    Adapter,
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
    "Adapter",
    "DriveError",
    "Reading",
    "Sent",
    "Settings",
    "driver_errors",
    "find_adapter",
    "list_adapters",
]
