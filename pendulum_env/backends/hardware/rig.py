"""The DM1015B rig as a backend: a drive behind a guard, paced, owned by one process, and let go of whatever happens."""

import logging
import math
import time
import weakref

from pendulum_env.backends.hardware import DriveError, find_adapter
from pendulum_env.backends.hardware.config import RigConfig, load
from pendulum_env.backends.hardware.encoder import Ticks
from pendulum_env.backends.hardware.guard import Fault, Guard
from pendulum_env.backends.hardware.process import Ownership, Signals, request_realtime, restore_priority
from pendulum_env.backends.port import Sample, Setup, Start, Status, Timing, Traits


class Rig:
    """Motor with the arm, over one of the adapters.

    A step sends its torque at once, waits for the next tick and reads the encoder there. Time is that of the ticks, and
    position and torque are referred to them. After a fault every sample tells it, until the backend is cleared. The
    motor has power from the first step of a run to its end, so a program may wait before the first step. After
    the last step the drive's watchdog removes the power if the program does not.
    """

    resting = 0.01  # [s] between looks at an arm that comes to rest
    speed = 10.0  # [rad/s], at which an uncertain time makes the angle uncertain

    def __init__(self, config: RigConfig) -> None:
        self.config = config
        self.guard = Guard(find_adapter(config.adapter)(config), config)
        self._owner = Ownership(config.link.device)
        # without a reference to self: it also runs when the rig is forgotten, and when Python ends
        guard, owner = self.guard, self._owner
        self._signals = Signals(lambda name: guard.disable(f"disabled by {name}"))
        self._finalizer = weakref.finalize(self, _release_rig, guard, owner, self._signals)
        self._last = Sample(0.0, 0.0, None, 0.0)
        self._waiting = False  # for the first torque of a run
        counts = config.encoder.counts  # as far as their steps can be told from the uncertainty of time
        blur = self.speed * self.guard.motor.noise * math.sqrt(12.0)  # [rad], step of an encoder that is as uncertain
        resolved = min(counts, int(2 * math.pi / blur)) if blur else counts
        self.traits = Traits(config.rate, resolved, config.max_torque)

    def open(self) -> None:
        """Acquire the rig and connect; the motor has no power.

        Raises:
            DriveError: if another process owns it or the drive cannot be reached.
        """
        self._owner.acquire()
        try:
            self._signals.install()
            with self._signals:
                if self.config.realtime and not request_realtime():
                    self.guard.note("no real-time priority: the system does not allow it to this user", logging.WARNING)
                self.guard.open()
        except BaseException:
            self.close()
            raise

    def enable(self, start: Start) -> Sample:
        """Wait until the arm rests: the first measurement, at time 0; power comes with the first torque.

        Raises:
            DriveError: if a fault is kept, the drive cannot be reached, or the arm does not come to rest.
        """
        self.disable()
        if start.clear_fault:
            with self._signals:
                self.guard.clear()
        try:
            position = self._wait_for_rest()
        except Fault as fault:
            raise DriveError(
                f"{fault}. The rig stays off until it is told that this is mended: "
                "env.reset(options={'clear_fault': True})"
            ) from None
        self._waiting = True
        self._last = Sample(0.0, position, None, 0.0, timing=Timing(0.0, 0))
        return self._last

    def _begin(self) -> None:
        """Give power, at zero torque; time begins."""
        self._waiting = False
        self.guard.enable()
        self.guard.write(0.0)
        self._ticks = Ticks(1.0 / self.config.rate, *self.guard.read())

    def exchange(self, torque: float) -> Sample:
        """Apply a torque [N m], wait for the next tick, measure. The sample reports a fault, none is raised."""
        try:
            with self._signals:
                if self._waiting:
                    self._begin()
                sent = self.guard.write(torque)
            ticks = self._ticks
            ticks.wait()
            with self._signals:
                now, position = self.guard.read()
                timing = Timing(now - ticks.now, ticks.overruns)
                self.guard.check_lateness(*timing)
        except Fault as fault:
            return self._last._replace(torque=0.0, status=Status.FAULT, fault=str(fault))
        except BaseException:  # an interrupt, or a mistake in an adapter
            with self._signals:
                self.guard.disable("disabled by an exception")
            raise
        ticks.add_command(*sent)
        ticks.add_measurement(now, position)
        self._last = Sample(ticks.time, ticks.position, None, ticks.torque(), timing=timing)
        return self._last

    def disable(self) -> None:
        """End a run: no torque, no power; never raises."""
        self._waiting = False
        with self._signals:
            self.guard.disable()

    def close(self) -> None:
        """Let go of everything; may be called at any time, and twice; never raises."""
        _release_rig(self.guard, self._owner, self._signals)

    def _wait_for_rest(self) -> float:
        """Wait, without power, until the arm has been at rest for a while; returns where [rad]."""
        rest, anchor, since = self.config.rest, math.inf, 0.0
        until = time.monotonic() + rest.timeout
        while time.monotonic() < until:
            with self._signals:
                now, position = self.guard.read()
            if abs(position - anchor) > rest.velocity * rest.seconds:
                anchor, since = position, now
            if now - since >= rest.seconds:
                return anchor
            time.sleep(self.resting)
        raise DriveError(
            f"the arm does not come to rest within {rest.timeout:g} s (rest.timeout): hold it, look for what moves it"
        )


def _release_rig(guard: Guard, owner: Ownership, signals: Signals) -> None:
    try:
        with signals:
            guard.close()
            owner.release()
            if guard.config.realtime:
                restore_priority()
    finally:  # a signal that came meanwhile has its turn when all is let go, and may raise
        signals.restore()


def make_rig(setup: Setup) -> Rig:
    """Make the rig of an environment's setup.

    Raises:
        ValueError: if no configuration is named, or it cannot be used.
        ModuleNotFoundError: if the extra `hardware` is not installed.
    """
    if setup.config is None:
        raise ValueError("backend 'dm1015b' needs a configuration: pass config='rig.toml', see docs/hardware.md")
    return Rig(load(setup.config))
