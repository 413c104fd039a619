"""The microcontroller of the serial rig, emulated: what its firmware does, in a page."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pendulum_env.backends.emulators.motor import Motor
from pendulum_env.backends.emulators.wire import Wire
from pendulum_env.backends.hardware import frames
from pendulum_env.backends.hardware.encoder import difference
from pendulum_env.interface import MAX_TORQUE

OVER_TEMPERATURE = 0x02


class SerialEmulator:
    """Answers frames."""

    def __init__(self, motor: Motor) -> None:
        """Take the motor."""
        self.motor, self._wire, self._splitter, self._faults = motor, Wire(), frames.Splitter(), 0
        self._set, self._ready = 0, False  # torque [uN m]; whether there has been a SETUP

    @property
    def place(self) -> str:
        """Path of the other end."""
        return self._wire.path

    def settings(self) -> dict[str, Any]:
        """Keys of its table in rig.toml."""
        return {"port": self.place}

    def sources(self) -> dict[int, Callable[[], None]]:
        """The pseudo-terminal."""
        return {self._wire.descriptor: self._come} if self._wire.descriptor >= 0 else {}

    def _come(self) -> None:
        for kind, sequence, *values in self._splitter.feed(self._wire.read()):
            self._take(kind, sequence, values)

    def _take(self, kind: int, sequence: int, values: list[int]) -> None:
        motor = self.motor
        if kind == frames.TORQUE:
            torque = frames.MICRO * values[0]
            if abs(torque) <= MAX_TORQUE:  # else it is no torque of this motor, whatever the check says
                motor.command(torque)
                motor.feed()
                self._set = values[0]
            return
        if kind == frames.SETUP:
            motor.switch(False)
            self._set, self._ready = 0, True
            motor.watchdog = 1e-3 * values[0]
        elif kind == frames.POWER:
            motor.switch(bool(values[0]) and self._ready and not self._faults)
            self._set = 0
        elif kind != frames.READ:
            return
        flags = frames.POWERED * motor.powered + frames.EXPIRED * motor.expired
        counts = difference(motor.counts(), 0)
        micro = int(motor.moment / frames.MICRO) % 2**32
        torque = self._set if motor.powered else 0
        self._wire.write(frames.pack(frames.STATE, sequence, flags, self._faults, micro, counts, torque))

    def fault(self) -> None:
        """Over-temperature, until the process ends."""
        self._faults |= OVER_TEMPERATURE
        self.motor.switch(False)

    def unplug(self) -> None:
        """No cable."""
        self._wire.pull()

    def corrupt(self, probability: float) -> None:
        """A cable beside a strong motor."""
        self._wire.corrupt(probability)

    def close(self) -> None:
        """Let go."""
        self._wire.pull()


def make(motor: Motor) -> SerialEmulator:
    """Emulator around a motor."""
    return SerialEmulator(motor)
