"""A rig that is not there: the project's own plant in real time, behind the serial protocol."""

from pendulum_env.backends.emulators.emulator import emulate
from pendulum_env.backends.emulators.serial import make_serial

__all__ = ["emulate", "make_serial"]
