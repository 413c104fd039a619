"""From the name of an adapter to its drive; the packages it needs are imported when it is."""

from __future__ import annotations

import importlib
import importlib.util

from pendulum_env.backends.hardware.config import RigConfig
from pendulum_env.backends.hardware.drive import Drive

ADAPTERS = {  # module and class of each, and the packages that the extra `hardware` brings for it
    "serial": ("serial_drive", "SerialDrive", ("serial",)),
    "canopen402": ("canopen402", "Canopen402", ("can", "serial")),
    "nidaq": ("nidaq", "NiDaq", ("nidaqmx", "grpc")),
}


def need(adapter: str) -> None:
    """Refuse an adapter, or the emulator of its drive, whose packages are not installed.

    Raises:
        ModuleNotFoundError: with the command that installs them.
    """
    for package in ADAPTERS[adapter][2]:
        if importlib.util.find_spec(package) is None:
            raise ModuleNotFoundError(f"the {adapter} rig needs {package}: pip install 'pendulum-ident[hardware]'")


def make_drive(config: RigConfig) -> Drive:
    """Drive of a configuration, not yet open.

    Raises:
        ModuleNotFoundError: if the extra `hardware` is not installed.
    """
    need(config.adapter)
    module, kind, _ = ADAPTERS[config.adapter]
    drive: Drive = getattr(importlib.import_module(f"pendulum_env.backends.hardware.{module}"), kind)(config)
    return drive
