"""Emulated motor: a simulated plant in real time, with power, encoder, watchdog and log."""

import math
import os
import time
from pathlib import Path

from pendulum_env.backends.rigid_body import make_body
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.errors import UserError
from pendulum_env.physics import Model
from pendulum_env.physics.simulation import LONGEST_STEP, TorqueBalance, make_start_samples

HAND_BANDWIDTH, HAND_SPEED = 60.0, 2.0  # [rad/s], bandwidth and speed of the hand that holds the pendulum


class Motor:
    """Motor with the pendulum; every method first advances the plant to the current time.

    The watchdog acts at its time, as in hardware, even if the process was not running then. The log has a line `TIME
    EVENT VALUE` per event, with monotonic time [s]: `command` with its torque, `torque` when the acting torque changes
    from or to zero, `power` 1 or 0, and `expired` when the watchdog runs out.
    """

    def __init__(self, model: Model, *, first_count: int = 0, log: str | Path | None = None) -> None:
        """Set the plant, the first reading of the encoder and the path of the log.

        Raises:
            UserError: if the plant has a dead time, which is not supported.
        """
        if any(term.delay for term in model.terms):
            raise UserError("an emulated motor has no dead_time: hide another effect")
        balance = TorqueBalance(model.terms, model.theta)
        self._body = make_body(balance, LONGEST_STEP)
        self._body.place(make_start_samples(balance, 0.0, 0.0))
        self._per_radian, self._first_count = COUNTS / (2 * math.pi), first_count
        self.moment = time.monotonic()  # current time of the plant [s]
        self._angle = 0.0
        self.torque = 0.0  # torque of the motor [N m]
        self._deadline = math.inf
        self.powered, self.expired = False, False
        self._hand: tuple[float, float] | None = None  # current and final angle of the hand [rad]
        self._inertia, self._speed = model.estimates["inertia"].value, 0.0  # [kg m^2], [rad/s]
        self.watchdog = math.inf  # [s]
        self._log = -1 if log is None else os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)

    def advance(self) -> None:
        """Advance the plant to the current time."""
        now = time.monotonic()
        if self._deadline <= now:
            self._move(self._deadline)
            self.expired = True
            self._log_event(self.moment, "expired", self.watchdog)
            self._cut_power(self.moment)
        self._move(now)

    def switch(self, is_on: bool) -> None:
        """Switch the power on or off, at zero torque."""
        self.advance()
        if not is_on:
            self._cut_power(self.moment)
            return
        self.expired = False
        self._set_torque(self.moment, 0.0)
        if not self.powered:
            self.powered = True
            self._log_event(self.moment, "power", 1.0)
        self.feed()

    def feed(self) -> None:
        """Restart the watchdog."""
        self.advance()
        if self.powered:
            self._deadline = self.moment + self.watchdog

    def command(self, torque: float) -> None:
        """Set the torque [N m], if the power is on."""
        self.advance()
        self._log_event(self.moment, "command", torque)
        if self.powered:
            self._set_torque(self.moment, torque)

    def hold(self, angle: float | None) -> None:
        """Turn the pendulum by hand to an angle [rad] and hold it, or release it for None."""
        self.advance()
        self._hand = None if angle is None else (self._angle, angle)

    def counts(self) -> int:
        """Return the encoder counts, unwrapped."""
        self.advance()
        return self._first_count + round(self._angle * self._per_radian)

    def _move(self, until: float) -> None:
        while (remaining := until - self.moment) > 1e-9:
            step = min(remaining, LONGEST_STEP)
            self._angle, self._speed = self._body.step(self.torque + self._compute_hand_torque(step), step)
            self.moment += step
        self.moment = max(self.moment, until)

    def _compute_hand_torque(self, step: float) -> float:
        """Return the torque of the hand that holds the pendulum [N m]."""
        if self._hand is None:
            return 0.0
        angle, target = self._hand
        angle += min(max(target - angle, -HAND_SPEED * step), HAND_SPEED * step)
        self._hand = angle, target
        return self._inertia * (HAND_BANDWIDTH**2 * (angle - self._angle) - 2 * HAND_BANDWIDTH * self._speed)

    def _set_torque(self, time: float, torque: float) -> None:
        if (torque == 0) != (self.torque == 0):
            self._log_event(time, "torque", torque)
        self.torque = torque

    def _cut_power(self, time: float) -> None:
        self._deadline = math.inf
        self._set_torque(time, 0.0)
        if self.powered:
            self.powered = False
            self._log_event(time, "power", 0.0)

    def _log_event(self, time: float, event: str, value: float) -> None:
        if self._log >= 0:
            os.write(self._log, f"{time:.6f} {event} {value:.6g}\n".encode())
