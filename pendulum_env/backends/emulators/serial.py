"""The microcontroller of the serial rig, emulated: what its firmware does, in a page."""

from pendulum_env.backends.emulators.emulator import Emulated, Wire
from pendulum_env.backends.emulators.motor import Motor
from pendulum_env.backends.hardware import frames
from pendulum_env.backends.hardware.encoder import subtract_counts
from pendulum_env.spaces import MAX_TORQUE


class Firmware:
    """Firmware that answers frames."""

    def __init__(self, motor: Motor) -> None:
        self.motor, self._splitter = motor, frames.Splitter()
        self._set, self._ready = 0, False  # torque [uN m]; whether there has been a SETUP

    def answer(self, data: bytes) -> bytes:
        """Return the answer to received bytes."""
        return b"".join(self._take(*frame) for frame in self._splitter.feed(data))

    def _take(self, kind: int, sequence: int, *values: int) -> bytes:
        motor = self.motor
        if kind == frames.TORQUE:
            torque = frames.MICRO * values[0]
            if abs(torque) <= MAX_TORQUE:  # else it is no torque of this motor, whatever the check says
                motor.command(torque)
                motor.feed()
                self._set = values[0]
            return b""
        if kind == frames.SETUP:
            motor.switch(False)
            self._set, self._ready = 0, True
            motor.watchdog = 1e-3 * values[0]
        elif kind == frames.POWER:
            motor.switch(bool(values[0]) and self._ready)
            self._set = 0
        elif kind != frames.READ:
            return b""
        counts = subtract_counts(motor.counts(), 0)
        flags = frames.POWERED * motor.powered + frames.EXPIRED * motor.expired
        micro = int(motor.moment / frames.MICRO) % 2**32
        torque = self._set if motor.powered else 0
        return frames.pack(frames.STATE, sequence, flags, 0, micro, counts, torque)


def make_serial(motor: Motor) -> Emulated:
    """Put a firmware around a motor, at the end of a serial cable."""
    wire = Wire(Firmware(motor).answer)
    return Emulated(motor, wire, "serial", {"port": wire.place})
