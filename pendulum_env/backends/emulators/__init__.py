"""Emulated rig: a simulated plant in real time with the serial protocol."""

from pendulum_env.backends.emulators.emulator import emulate
from pendulum_env.backends.emulators.serial import make_serial

__all__ = ["emulate", "make_serial"]
