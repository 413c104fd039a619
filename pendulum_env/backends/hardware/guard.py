"""Guard between torque command and drive.

The guard does not replace an emergency stop, which cuts the power.
"""

import logging
import math
import time
from datetime import datetime

from pendulum_env.backends.hardware import Drive, DriveError, Sent
from pendulum_env.backends.hardware.config import RigConfig
from pendulum_env.backends.hardware.encoder import Encoder
from pendulum_env.backends.hardware.plausibility import PlausibilityCheck

log = logging.getLogger("pendulum_env.rig")
log.addHandler(logging.NullHandler())  # silent without a handler of the user


class Fault(Exception):
    """Fault after which the guard has removed the torque and refuses commands until `Guard.clear`."""


class Guard:
    """Drive with limits; after a fault, torque and power stay off until `clear` is called.

    `fault` is the text of the fault with its remedy, or None.
    """

    rise = 1.0  # [rad/s], largest gain of speed against stall_torque or a brake

    def __init__(self, motor: Drive, config: RigConfig) -> None:
        """Set the motor's drive and the configuration."""
        self.motor, self.config, self.limits = motor, config, config.limits
        self.encoder = Encoder(config.encoder, config.limits.hard_velocity)
        self.fault: str | None = None
        self.powered = False
        self._open = False
        self.torque = 0.0  # [N m], last sent
        self._motion = PlausibilityCheck(config.plant, self.encoder.step, motor.noise)
        self._reset_checks()

    def _reset_checks(self) -> None:
        """Reset the state of the checks."""
        self.encoder.reset_velocity()
        self._motion.reset()
        self._written: float | None = None  # time of the last command [s]
        self._waited = 0.0  # [s], time spent in calls of the drive since the last command
        self._still: float | None = None  # start of a standstill under stall_torque [s]
        # torque [N m] and velocity [rad/s] at the start of motion against the torque
        self._against: tuple[float, float] | None = None

    def open(self) -> None:
        """Connect, and read the position of the arm.

        Raises:
            DriveError: if the drive cannot be reached; the guard is then closed.
        """
        try:
            self._open = True
            self.encoder = Encoder(self.config.encoder, self.limits.hard_velocity)  # zero: see `EncoderSettings`
            self._reset_checks()
            self.motor.open()
            reading = self.motor.read()
            self.encoder.add_reading(reading.time, reading.counts)
        except BaseException as error:
            self.note(f"cannot open: {error}")
            self.close()
            raise
        self.note("opened")

    def clear(self) -> None:
        """Reconnect the drive and clear the fault, after its cause is removed.

        Zero stays at its count. After the counter's supply was off, close and open the rig instead.

        Raises:
            DriveError: if the drive cannot be reached.
        """
        if self.fault is not None:
            self.motor.close()
            self.motor.open()
            self.fault = None
            self.note("fault cleared")

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
        self.note("enabled")

    def write(self, torque: float) -> Sent:
        """Limit and send a torque [N m]; return the torque that acts.

        Raises:
            Fault: if a fault is kept or occurs.
        """
        self._raise_kept_fault()
        if not self.powered:
            raise Fault("the drive has no power: reset the environment before stepping it")
        if not math.isfinite(torque):
            raise self.trip(f"a torque of {torque} was asked for: mend what computes it", braking=True)
        now = time.monotonic()
        passed = 0.0 if self._written is None else now - self._written
        if passed > self.limits.gap:
            allowed = f"{1e3 * self.limits.gap:.0f} ms"
            raise self._trip_late(f"no command came for {1e3 * passed:.0f} ms", "gap", allowed)
        torque = self._limit_torque(torque, passed or 1.0 / self.config.rate)
        sign = self.config.torque_sign
        try:
            sent = self.motor.write(sign * torque)
        except DriveError as error:
            raise self.trip(str(error)) from error
        self._written, self._waited, self.torque = now, time.monotonic() - now, sign * sent.torque
        self._motion.add_command(self.torque)
        return Sent(sent.time, self.torque)

    def read(self) -> tuple[float, float]:
        """Return time [s] and position [rad] of a credible reading.

        Raises:
            Fault: if a fault is kept, the drive reports one or does not answer, or the motion is too fast or
                implausible.
        """
        self._raise_kept_fault()
        asked = time.monotonic()
        try:
            reading = self.motor.read()
            took = time.monotonic() - asked
            self._waited += took
            if self.powered and reading.fault is not None:
                hung = f", after {1e3 * took:.0f} ms in which it did not answer" if took > self.limits.gap else ""
                raise DriveError(f"the drive reports{hung}: {reading.fault}")
            moved = self.encoder.add_reading(reading.time, reading.counts)
        except DriveError as error:
            raise self.trip(str(error)) from error
        if self.powered:
            if moved is not None:
                self._check_obedience(reading.time, moved)
            if found := self._motion.check_measurement(reading.time, self.encoder.position, took):
                raise self.trip(
                    f"the arm cannot have moved so under {self.torque:.3g} N m, {found}: check encoder, drive and "
                    f"their cables, whether the arm was pushed, and [plant] of {self.config.path.name}"
                )
        return reading.time, self.encoder.position

    def _raise_kept_fault(self) -> None:
        """Raise the fault that is kept, if any."""
        if self.fault is not None:
            raise Fault(self.fault)

    def check_lateness(self, behind: float, overruns: int) -> None:
        """Check the delay of the loop behind its ticks [s] and the number of missed ticks.

        Raises:
            Fault: if a limit is exceeded.
        """
        if behind > self.limits.behind:
            allowed = f"{1e3 * self.limits.behind:.0f} ms"
            raise self._trip_late(f"the loop is {1e3 * behind:.0f} ms behind", "behind", allowed)
        if overruns > self.limits.overruns:
            raise self._trip_late(f"{overruns} ticks were missed", "overruns", str(self.limits.overruns))

    def _trip_late(self, what: str, limit: str, allowed: str) -> Fault:
        return self.trip(
            f"{what}, {allowed} are allowed (limits.{limit}); the drive took {1e3 * self._waited:.0f} ms to answer. "
            "The program was held up or is too slow for its rate: lower the rate, free the machine of other work, ask "
            "for real-time priority (realtime = true), and check the cable if it was the drive",
            braking=True,
        )

    def disable(self, why: str = "disabled", level: int = logging.INFO, *, brake: bool = False) -> None:
        """Set zero torque and cut the power, after braking if `brake`; never raises."""
        if not self.powered:
            return
        failures = _brake_arm(self.motor, self.encoder, self.config, self.rise) if brake else []
        self.powered, self.torque = False, 0.0
        for switch_off in (lambda: self.motor.write(0.0), self.motor.disable):  # both, even if the first fails
            try:
                switch_off()
            except Exception as error:
                failures.append(error)
        for failure in failures:  # logged after the torque is removed
            self.note(f"could not be told to brake or to let go, its watchdog will: {failure}")
        self.note(why, level)

    def close(self) -> None:
        """Disable and disconnect; may be called repeatedly, and never raises."""
        self.disable()
        try:
            self.motor.close()
        except Exception as error:
            self.note(f"closing failed: {error}")
        if self._open:
            self._open = False
            self.note("closed")

    def trip(self, what: str, *, braking: bool = False) -> Fault:
        """Remove the torque, keep the fault and return it.

        Args:
            what: text of the fault, with its remedy.
            braking: whether drive and encoder still work, as braking requires.
        """
        self.fault = what
        if self.powered:
            # with unchecked signs, braking may accelerate
            brake = braking and self.config.fault.action == "brake" and self.config.checked
            self.disable(f"fault: {what}", logging.WARNING, brake=brake)
        else:
            self.note(f"fault: {what}", logging.WARNING)
        return Fault(what)

    def note(self, what: str, level: int = logging.INFO) -> None:
        """Log a text, also to the rig's file."""
        log.log(level, what)
        if self.config.log is not None:
            path = self.config.path.parent / self.config.log
            try:
                with open(path, "a", encoding="utf-8") as file:
                    file.write(f"{datetime.now().astimezone().isoformat(timespec='milliseconds')} {what}\n")
            except (OSError, ValueError) as error:  # ValueError: text that UTF-8 cannot encode
                log.warning("%s: %s", path, error)  # a full disk must not stop `disable`

    def _limit_torque(self, torque: float, passed: float) -> float:
        """Limit a torque by its bound, its slew rate over `passed` [s], and the soft velocity limit."""
        limits, most, change = self.limits, self.config.max_torque, self.limits.slew * passed
        torque = min(max(torque, -most), most)
        torque = min(max(torque, self.torque - change), self.torque + change)
        velocity = self.encoder.velocity
        if torque * velocity > 0 and abs(velocity) > limits.soft_velocity:
            room = max(limits.hard_velocity - limits.soft_velocity, 1e-9)
            torque *= max(0.0, (limits.hard_velocity - abs(velocity)) / room)
        return torque

    def _check_obedience(self, now: float, moved: float) -> None:
        """Check that the arm is not too fast, and follows a torque above gravity and friction."""
        limits, velocity, strong = self.limits, self.encoder.velocity, abs(self.torque) >= self.limits.stall_torque
        if abs(velocity) > limits.hard_velocity:
            raise self.trip(
                f"the arm turns at {velocity:.3g} rad/s, {limits.hard_velocity:g} are allowed "
                "(limits.hard_velocity): lower the torque, and look for what drives it",
                braking=True,
            )
        if not strong or abs(moved) > abs(self.encoder.step):
            self._still = None
        elif self._still is None:
            self._still = now
        elif now - self._still > limits.stall_time:
            raise self.trip(
                f"the counts stand still under {self.torque:.3g} N m for {limits.stall_time:g} s: check the encoder's "
                "cable, the motor's, and whether the arm is blocked"
            )
        against = strong and self.torque * velocity < 0
        if not against or (self._against is not None and self._against[0] * self.torque < 0):
            self._against = None
        elif self._against is None or abs(velocity) < abs(self._against[1]):
            self._against = (self.torque, velocity)
        elif abs(velocity) > abs(self._against[1]) + self.rise:
            raise self.trip(
                f"the arm speeds up against {self.torque:.3g} N m: the sign of the torque or of the encoder is wrong, "
                "run `pendulum-ident hardware check`"
            )


def _brake_arm(drive: Drive, encoder: Encoder, config: RigConfig, rise: float, step: float = 1e-3) -> list[Exception]:
    """Brake the arm by a command every `step` [s], until it is slow, gains `rise` [rad/s], or the time is over.

    Return the errors.
    """
    until = time.monotonic() + config.fault.seconds
    slowest = abs(encoder.velocity)
    try:
        while time.monotonic() < until and config.rest.velocity < abs(encoder.velocity) <= slowest + rise:
            torque = min(max(-config.fault.gain * encoder.velocity, -config.max_torque), config.max_torque)
            drive.write(config.torque_sign * torque)
            time.sleep(step)
            reading = drive.read()
            if reading.fault is not None:
                break
            encoder.add_reading(reading.time, reading.counts)
            slowest = min(slowest, abs(encoder.velocity))
    except Exception as error:
        return [error]
    return []
