"""Emulated microcontroller of the serial rig."""

from pendulum_env.backends.emulators.emulator import EmulatedRig, Wire
from pendulum_env.backends.emulators.motor import Motor
from pendulum_env.backends.hardware import frames
from pendulum_env.backends.hardware.encoder import subtract_counts
from pendulum_env.spaces import MAX_TORQUE


class Firmware:
    """Firmware of the microcontroller."""

    def __init__(self, motor: Motor) -> None:
        self.motor, self._splitter = motor, frames.Splitter()
        self._set, self._ready = 0, False  # torque [uN m]; whether a SETUP was received

    def answer(self, data: bytes) -> bytes:
        """Return the answer to received bytes."""
        return b"".join(self._answer_frame(*frame) for frame in self._splitter.feed(data))

    def _answer_frame(self, kind: int, sequence: int, *values: int) -> bytes:
        motor = self.motor
        if kind == frames.TORQUE:
            torque = frames.MICRO * values[0]
            if abs(torque) <= MAX_TORQUE:  # else an invalid frame
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


def make_serial(motor: Motor) -> EmulatedRig:
    """Connect a motor by the firmware and a serial cable."""
    wire = Wire(Firmware(motor).answer)
    return EmulatedRig(motor, wire, "serial", {"port": wire.path})
