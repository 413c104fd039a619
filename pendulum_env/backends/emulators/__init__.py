"""Drives that are not there: the project's own plant in real time, behind the protocols that the adapters speak."""

from pendulum_env.backends.emulators.emulator import MISHAPS, emulate

__all__ = ["MISHAPS", "emulate"]
