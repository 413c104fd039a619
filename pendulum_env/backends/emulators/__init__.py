"""Drives that are not there: the project's own plant in real time, behind the protocols that the adapters speak."""

from pendulum_env.backends.emulators.emulator import EMULATORS, Emulation, emulate

__all__ = ["EMULATORS", "Emulation", "emulate"]
