"""Torque channel: the acting torque from the logged torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.filters import filter_lag
from pendulum_env.physics import Samples
from pendulum_env.physics.actuation import ActuatorLag, DeadTime

ECHO = 0.8  # of a half-sample mixture that is undone: all of it would raise noise without bounds


@dataclass(frozen=True)
class Channel:
    """Law of the torque channel, which converts the logged torque into the acting torque.

    Attributes:
        delay: [s] by which torque is logged late, as against one that is held from its sample to the next; below zero,
            by which it acts late.
        lag: time constant [s] of a filter that the logged torque has passed, its output at the end of each period
            being logged; below zero, of one that the acting torque passes.
        is_sampled: whether torque was sampled from one that went on changing until the next sample, as the position
            was, which is a delay of half a sample; else it was held until then.
    """

    delay: float = 0.0
    lag: float = 0.0
    is_sampled: bool = False

    @property
    def is_late(self) -> bool:
        """Return whether torque is logged late or filtered, which no physical effect imitates."""
        return self.delay + self.lag > 0

    def remove_filter(self, torque: Array, period: float) -> Array:
        """Return torque (N,) before the filter of the log, y[k] = a y[k-1] + (1 - a) u[k], a = exp(-period / lag)."""
        if self.lag <= 0:
            return torque
        return torque + np.diff(torque, prepend=torque[0]) / np.expm1(period / self.lag)

    def hold_torque(self, torque: Array, period: float) -> Array:
        """Return the acting torque (N,) from each sample to the next, without delay and filter of the log.

        A log that is late by n + f samples saw (1 - f) u[k - n] + f u[k - n - 1] of a torque that was held; averaging
        once more would blunt every step, so that this is undone, forwards or backwards in time, whichever is stable.
        """
        torque = self.remove_filter(torque, period)
        if self.is_sampled:
            return _hold_sampled_torque(torque, self.delay / period)
        whole, share = divmod(self.delay / period, 1.0)
        if share <= 0.5:
            acting = _unmix_series(torque, share)
        else:
            whole, acting = whole + 1, _unmix_series(torque[::-1], 1 - share)[::-1]
        return acting[np.clip(np.arange(len(torque)) + int(whole), 0, len(torque) - 1)]

    def average_torque(self, x: Samples, torque: Array, period: float) -> Array:
        """Average the acting torque under a triangle over both sides of each sample (N,), as windows use it."""
        if self.lag < 0:
            return ActuatorLag(-self.lag).trace(x, torque, period)[0]
        torque, delay = self.remove_filter(torque, period), self.delay
        if self.is_sampled:
            torque, delay = _hold_sampled_torque(torque, delay / period), 0.0
        return DeadTime(-delay).trace(x, torque, period)[0]


def _hold_sampled_torque(torque: Array, late: float) -> Array:
    """Compute the held torque (N,) with the effect of a smooth torque, sampled and logged late by some samples.

    That is the cubic through four samples, and of this the averages between samples less what holding them blunts:
    right to the fourth order.
    """
    whole, share = divmod(late - 0.5, 1.0)
    nodes = np.arange(-1, 3)
    cubic = [np.prod([(share - b) / (a - b) for b in nodes if b != a]) for a in nodes]
    weights = np.convolve(cubic, np.array([-1.0, 7.0, 7.0, -1.0]) / 12)  # of samples k + whole - 2 to k + whole + 4
    place = np.arange(len(torque))[:, None] + int(whole) + np.arange(-2, 5)
    return np.asarray(torque[np.clip(place, 0, len(torque) - 1)] @ weights)


def _unmix_series(mixed: Array, share: float) -> Array:
    """Recover a series u (N,) from its mixture (1 - share) u[k] + share u[k - 1], with a share of at most 0.5."""
    echo = min(share / (1 - share), ECHO)
    clear = filter_lag(mixed, -echo, mixed[0])
    rest = share - echo / (1 + echo)  # of a sample, by which slow torque would still be late
    return (1 - rest) * clear + rest * np.append(clear[1:], clear[-1])
