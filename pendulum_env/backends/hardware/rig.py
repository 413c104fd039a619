"""Backend of the DM1015B rig: a guarded motor with a paced loop and a lock."""

import logging
import math
import time
import weakref

from pendulum_env.backends.hardware import DriveError, find_adapter
from pendulum_env.backends.hardware.config import RigConfig, load
from pendulum_env.backends.hardware.encoder import Ticks
from pendulum_env.backends.hardware.guard import Fault, Guard
from pendulum_env.backends.hardware.process import DeviceLock, Signals, request_realtime, restore_priority
from pendulum_env.backends.port import Sample, Setup, Start, Status, Timing, Traits


class Rig:
    """Backend of a motor with the pendulum.

    A step sends its torque, waits for the next tick and reads the encoder. Time, position and torque of a sample are
    those at the tick. After a fault, every sample has its text until the fault is cleared. The motor has power from the
    first step of a run to its end, so a program may wait before the first step. After the last step, the device's
    watchdog removes the power if the program does not.
    """

    rest_period = 0.01  # [s] between readings while the pendulum comes to rest
    reference_speed = 10.0  # [rad/s], speed that converts the uncertainty of time into that of the angle

    def __init__(self, config: RigConfig) -> None:
        self.config = config
        self.guard = Guard(find_adapter(config.adapter)(config), config)
        self._owner = DeviceLock(config.link.device)
        # without a reference to self, so that the finalizer also runs at garbage collection
        guard, owner = self.guard, self._owner
        self._signals = Signals(lambda name: guard.disable(f"disabled by {name}"))
        self._finalizer = weakref.finalize(self, _release_rig, guard, owner, self._signals)
        self._last_sample = Sample(0.0, 0.0, None, 0.0)
        self._is_first_torque = False  # whether the first torque of a run is pending
        counts = config.encoder.counts  # reduced if the noise of time exceeds a count
        noise = self.reference_speed * self.guard.motor.noise * math.sqrt(12.0)  # [rad], count of equal noise
        resolved_counts = min(counts, int(2 * math.pi / noise)) if noise else counts
        self.traits = Traits(config.rate, resolved_counts, config.max_torque)

    def open(self) -> None:
        """Lock the device and connect, without power.

        Raises:
            DriveError: if another process holds the lock, or the device cannot be reached.
        """
        self._owner.acquire()
        try:
            self._signals.install()
            with self._signals:
                if self.config.realtime and not request_realtime():
                    text = "no real-time priority: the system does not allow it to this user"
                    self.guard.log_message(text, logging.WARNING)
                self.guard.open()
        except BaseException:
            self.close()
            raise

    def enable(self, start: Start) -> Sample:
        """Wait until the pendulum rests; return the measurement at time 0. The first torque switches the power on.

        Raises:
            DriveError: if a fault is kept, the device cannot be reached, or the pendulum does not come to rest.
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
        self._is_first_torque = True
        self._last_sample = Sample(0.0, position, None, 0.0, timing=Timing(0.0, 0))
        return self._last_sample

    def _start_loop(self) -> None:
        """Switch the power on at zero torque, and start the ticks."""
        self._is_first_torque = False
        self.guard.enable()
        self.guard.write(0.0)
        self._ticks = Ticks(1.0 / self.config.rate, *self.guard.read())

    def exchange(self, torque: float) -> Sample:
        """Apply a torque [N m], wait for the next tick and measure; a fault is reported by the sample."""
        try:
            with self._signals:
                if self._is_first_torque:
                    self._start_loop()
                sent = self.guard.write(torque)
            ticks = self._ticks
            ticks.wait()
            with self._signals:
                reading_time, position = self.guard.read()
                timing = Timing(reading_time - ticks.tick_time, ticks.overruns)
                self.guard.check_lateness(*timing)
        except Fault as fault:
            return self._last_sample._replace(torque=0.0, status=Status.FAULT, fault=str(fault))
        except BaseException:  # an interrupt, or an error of an adapter
            with self._signals:
                self.guard.disable("disabled by an exception")
            raise
        ticks.add_command(*sent)
        ticks.add_measurement(reading_time, position)
        self._last_sample = Sample(ticks.time, ticks.position, None, ticks.torque(), timing=timing)
        return self._last_sample

    def disable(self) -> None:
        """End a run: remove torque and power; never raises."""
        self._is_first_torque = False
        with self._signals:
            self.guard.disable()

    def close(self) -> None:
        """Disconnect and release the lock; may be called at any time and repeatedly, and never raises."""
        _release_rig(self.guard, self._owner, self._signals)

    def _wait_for_rest(self) -> float:
        """Wait without power until the pendulum has been at rest for `rest.seconds`; return its position [rad]."""
        rest, anchor, start = self.config.rest, math.inf, 0.0
        deadline = time.monotonic() + rest.timeout
        while time.monotonic() < deadline:
            with self._signals:
                reading_time, position = self.guard.read()
            if abs(position - anchor) > rest.velocity * rest.seconds:
                anchor, start = position, reading_time
            if reading_time - start >= rest.seconds:
                return anchor
            time.sleep(self.rest_period)
        raise DriveError(
            f"the pendulum does not come to rest within {rest.timeout:g} s (rest.timeout): hold it, and look for what "
            "moves it"
        )


def _release_rig(guard: Guard, owner: DeviceLock, signals: Signals) -> None:
    try:
        with signals:
            guard.close()
            owner.release()
            if guard.config.realtime:
                restore_priority()
    finally:  # a delayed signal may have raised
        signals.restore()


def make_rig(setup: Setup) -> Rig:
    """Make the rig of a setup.

    Raises:
        ValueError: if the configuration is missing or invalid.
        ModuleNotFoundError: if the extra `hardware` is not installed.
    """
    if setup.config is None:
        raise ValueError("backend 'dm1015b' needs a configuration: pass config='rig.toml', see docs/hardware.md")
    return Rig(load(setup.config))
