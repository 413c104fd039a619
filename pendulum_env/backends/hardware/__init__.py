"""The DM1015B rig: adapters that reach its drive, and around each the same guard, pacing and care."""

from pendulum_env.backends.hardware.drive import (
    OPENING,
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
    "OPENING",
    "Drive",
    "DriveError",
    "Reading",
    "Sent",
    "Settings",
    "driver_errors",
    "find_adapter",
    "list_adapters",
]
