"""Guard between torque command and adapter.

The guard does not replace an emergency stop, which cuts the power.
"""

import logging
import math
import time
from datetime import datetime

from pendulum_env.backends.hardware import Adapter, DriveError, Sent
from pendulum_env.backends.hardware.config import RigConfig
from pendulum_env.backends.hardware.encoder import Encoder
from pendulum_env.backends.hardware.plausibility import PlausibilityCheck

log = logging.getLogger("pendulum_env.rig")
log.addHandler(logging.NullHandler())  # silent without a handler of the user
BRAKE_PERIOD = 1e-3  # [s] between commands of a brake


class Fault(Exception):
    """Fault after which the guard has removed the torque and refuses commands until `Guard.clear`."""


class Guard:
    """Adapter with limits; after a fault, torque and power stay off until `clear` is called.

    `fault` is the text of the fault with its remedy, or None.
    """

    max_rise = 1.0  # [rad/s], largest gain of speed against stall_torque or a brake

    def __init__(self, motor: Adapter, config: RigConfig) -> None:
        """Set the adapter of the motor and the configuration."""
        self.motor, self.config, self.limits = motor, config, config.limits
        self.encoder = Encoder(config.encoder, config.limits.hard_velocity)
        self.fault: str | None = None
        self.powered = False
        self._is_open = False
        self.torque = 0.0  # [N m], last sent
        self._plausibility = PlausibilityCheck(config.plant, self.encoder.step, motor.noise)
        self._reset_checks()

    def _reset_checks(self) -> None:
        """Reset the state of the checks."""
        self.encoder.reset_velocity()
        self._plausibility.reset()
        self._command_time: float | None = None  # time of the last command [s]
        self._adapter_time = 0.0  # [s], time spent in calls of the adapter since the last command
        self._standstill_start: float | None = None  # start of a standstill under stall_torque [s]
        # torque [N m] and velocity [rad/s] at the start of motion against the torque
        self._reverse_motion: tuple[float, float] | None = None

    def open(self) -> None:
        """Connect, and read the position of the pendulum.

        Raises:
            DriveError: if the device cannot be reached; the guard is then closed.
        """
        try:
            self._is_open = True
            self.encoder = Encoder(self.config.encoder, self.limits.hard_velocity)  # zero: see `EncoderSettings`
            self._reset_checks()
            self.motor.open()
            reading = self.motor.read()
            self.encoder.add_reading(reading.time, reading.counts)
        except BaseException as error:
            self.log_message(f"cannot open: {error}")
            self.close()
            raise
        self.log_message("opened")

    def clear(self) -> None:
        """Reconnect the device and clear the fault, after its cause is removed.

        Zero stays at its count. After the counter's supply was off, close and open the rig instead.

        Raises:
            DriveError: if the device cannot be reached.
        """
        if self.fault is not None:
            self.motor.close()
            self.motor.open()
            self.fault = None
            self.log_message("fault cleared")

    def enable(self) -> None:
        """Switch the power on, at zero torque; raises Fault if a fault is kept or occurs."""
        self._raise_kept_fault()
        self._reset_checks()
        self.torque = 0.0
        try:
            self.powered = True  # set first: the next call may be interrupted
            self.motor.enable()
        except DriveError as error:
            raise self.trip(str(error)) from error
        self.log_message("enabled")

    def write(self, torque: float) -> Sent:
        """Limit and send a torque [N m]; return the torque that acts.

        Raises:
            Fault: if a fault is kept or occurs.
        """
        self._raise_kept_fault()
        if not self.powered:
            raise Fault("the drive has no power: reset the environment before stepping it")
        if not math.isfinite(torque):
            raise self.trip(f"a torque of {torque} was asked for: mend what computes it", can_brake=True)
        start = time.monotonic()
        elapsed = 0.0 if self._command_time is None else start - self._command_time
        if elapsed > self.limits.gap:
            allowed = f"{1e3 * self.limits.gap:.0f} ms"
            raise self._trip_late(f"no command came for {1e3 * elapsed:.0f} ms", "gap", allowed)
        torque = self._limit_torque(torque, elapsed or 1.0 / self.config.rate)
        sign = self.config.torque_sign
        try:
            sent = self.motor.write(sign * torque)
        except DriveError as error:
            raise self.trip(str(error)) from error
        self._command_time, self._adapter_time, self.torque = start, time.monotonic() - start, sign * sent.torque
        self._plausibility.add_command(self.torque)
        return Sent(sent.time, self.torque)

    def read(self) -> tuple[float, float]:
        """Return time [s] and position [rad] of a credible reading.

        Raises:
            Fault: if a fault is kept, the device reports one or does not answer, or the motion is too fast or
                implausible.
        """
        self._raise_kept_fault()
        start = time.monotonic()
        try:
            reading = self.motor.read()
            duration = time.monotonic() - start
            self._adapter_time += duration
            if self.powered and reading.fault is not None:
                is_late = duration > self.limits.gap
                delay = f", after {1e3 * duration:.0f} ms in which it did not answer" if is_late else ""
                raise DriveError(f"the drive reports{delay}: {reading.fault}")
            angle = self.encoder.add_reading(reading.time, reading.counts)
        except DriveError as error:
            raise self.trip(str(error)) from error
        if self.powered:
            if angle is not None:
                self._check_response(reading.time, angle)
            if impossibility := self._plausibility.check_measurement(reading.time, self.encoder.position, duration):
                raise self.trip(
                    f"the pendulum cannot have moved so under {self.torque:.3g} N m, {impossibility}: check encoder, "
                    f"drive and their cables, whether the pendulum was pushed, and [plant] of {self.config.path.name}"
                )
        return reading.time, self.encoder.position

    def _raise_kept_fault(self) -> None:
        """Raise the fault that is kept, if any."""
        if self.fault is not None:
            raise Fault(self.fault)

    def check_lateness(self, lateness: float, overruns: int) -> None:
        """Check the delay of the loop behind its ticks [s] and the number of missed ticks.

        Raises:
            Fault: if a limit is exceeded.
        """
        if lateness > self.limits.behind:
            allowed = f"{1e3 * self.limits.behind:.0f} ms"
            raise self._trip_late(f"the loop is {1e3 * lateness:.0f} ms behind", "behind", allowed)
        if overruns > self.limits.overruns:
            raise self._trip_late(f"{overruns} ticks were missed", "overruns", str(self.limits.overruns))

    def _trip_late(self, message: str, limit: str, allowed: str) -> Fault:
        return self.trip(
            f"{message}, {allowed} are allowed (limits.{limit}); the drive took "
            f"{1e3 * self._adapter_time:.0f} ms to answer. The program was held up or is too slow for its rate: lower "
            "the rate, free the machine of other work, ask for real-time priority (realtime = true), and check the "
            "cable if it was the drive",
            can_brake=True,
        )

    def disable(self, reason: str = "disabled", level: int = logging.INFO, *, is_braked: bool = False) -> None:
        """Set zero torque and cut the power, after braking if `is_braked`; never raises."""
        if not self.powered:
            return
        failures = _brake_pendulum(self.motor, self.encoder, self.config, self.max_rise) if is_braked else []
        self.powered, self.torque = False, 0.0
        for switch_off in (lambda: self.motor.write(0.0), self.motor.disable):  # both, even if the first fails
            try:
                switch_off()
            except Exception as error:
                failures.append(error)
        for failure in failures:  # logged after the torque is removed
            self.log_message(f"could not be told to brake or to let go, its watchdog will: {failure}")
        self.log_message(reason, level)

    def close(self) -> None:
        """Disable and disconnect; may be called repeatedly, and never raises."""
        self.disable()
        try:
            self.motor.close()
        except Exception as error:
            self.log_message(f"closing failed: {error}")
        if self._is_open:
            self._is_open = False
            self.log_message("closed")

    def trip(self, message: str, *, can_brake: bool = False) -> Fault:
        """Remove the torque, keep the fault and return it.

        Args:
            message: text of the fault, with its remedy.
            can_brake: whether amplifier and encoder still work, as braking requires.
        """
        self.fault = message
        if self.powered:
            # with unchecked signs, braking may accelerate
            brake = can_brake and self.config.fault.action == "brake" and self.config.checked
            self.disable(f"fault: {message}", logging.WARNING, is_braked=brake)
        else:
            self.log_message(f"fault: {message}", logging.WARNING)
        return Fault(message)

    def log_message(self, message: str, level: int = logging.INFO) -> None:
        """Log a text, also to the rig's file."""
        log.log(level, message)
        if self.config.log is not None:
            path = self.config.path.parent / self.config.log
            try:
                with open(path, "a", encoding="utf-8") as file:
                    file.write(f"{datetime.now().astimezone().isoformat(timespec='milliseconds')} {message}\n")
            except (OSError, ValueError) as error:  # ValueError: text that UTF-8 cannot encode
                log.warning("%s: %s", path, error)  # a full disk must not stop `disable`

    def _limit_torque(self, torque: float, elapsed: float) -> float:
        """Limit a torque by its bound, its slew rate over `elapsed` [s], and the soft velocity limit."""
        limits, largest, change = self.limits, self.config.max_torque, self.limits.slew * elapsed
        torque = min(max(torque, -largest), largest)
        torque = min(max(torque, self.torque - change), self.torque + change)
        velocity = self.encoder.velocity
        if torque * velocity > 0 and abs(velocity) > limits.soft_velocity:
            fade_range = max(limits.hard_velocity - limits.soft_velocity, 1e-9)
            torque *= max(0.0, (limits.hard_velocity - abs(velocity)) / fade_range)
        return torque

    def _check_response(self, time: float, angle: float) -> None:
        """Check that the pendulum is not too fast, and follows a torque above gravity and friction."""
        limits, velocity, is_strong = self.limits, self.encoder.velocity, abs(self.torque) >= self.limits.stall_torque
        if abs(velocity) > limits.hard_velocity:
            raise self.trip(
                f"the pendulum turns at {velocity:.3g} rad/s, {limits.hard_velocity:g} are allowed "
                "(limits.hard_velocity): lower the torque, and look for what drives it",
                can_brake=True,
            )
        if not is_strong or abs(angle) > abs(self.encoder.step):
            self._standstill_start = None
        elif self._standstill_start is None:
            self._standstill_start = time
        elif time - self._standstill_start > limits.stall_time:
            raise self.trip(
                f"the counts stand still under {self.torque:.3g} N m for {limits.stall_time:g} s: check the encoder's "
                "cable, the motor's, and whether the pendulum is blocked"
            )
        is_reverse = is_strong and self.torque * velocity < 0
        if not is_reverse or (self._reverse_motion is not None and self._reverse_motion[0] * self.torque < 0):
            self._reverse_motion = None
        elif self._reverse_motion is None or abs(velocity) < abs(self._reverse_motion[1]):
            self._reverse_motion = (self.torque, velocity)
        elif abs(velocity) > abs(self._reverse_motion[1]) + self.max_rise:
            raise self.trip(
                f"the pendulum speeds up against {self.torque:.3g} N m: the sign of the torque or of the encoder is "
                "wrong, run `pendulum-ident hardware check`"
            )


def _brake_pendulum(motor: Adapter, encoder: Encoder, config: RigConfig, max_rise: float) -> list[Exception]:
    """Brake the pendulum until it is slow, gains `max_rise` [rad/s], or the time is over.

    Return the errors.
    """
    deadline = time.monotonic() + config.fault.seconds
    slowest = abs(encoder.velocity)
    try:
        while time.monotonic() < deadline and config.rest.velocity < abs(encoder.velocity) <= slowest + max_rise:
            torque = min(max(-config.fault.gain * encoder.velocity, -config.max_torque), config.max_torque)
            motor.write(config.torque_sign * torque)
            time.sleep(BRAKE_PERIOD)
            reading = motor.read()
            if reading.fault is not None:
                break
            encoder.add_reading(reading.time, reading.counts)
            slowest = min(slowest, abs(encoder.velocity))
    except Exception as error:
        return [error]
    return []
