"""Torque channel: the acting torque from the logged torque."""

from dataclasses import dataclass

import numpy as np

from estimators.signals.differentiation import has_white_noise
from pendulum_env._typing import Array
from pendulum_env.filters import filter_lag, filter_shifted
from pendulum_env.physics import Column, NonlinearParameter, Samples, Term
from pendulum_env.physics.actuation import average_delayed, average_lagged
from pendulum_env.physics.term import Memory

REACH = 0.05  # [s], largest lag, and largest delay of a first search
LONGEST = 0.2  # [s], largest delay by which torque is logged late, if the first search ends at `REACH`

MAX_FEEDBACK = 0.8  # largest feedback of an inverse filter of a mixture of two samples; at 1 noise is unbounded
UNMIXED_SAMPLES = int(np.ceil(np.log(0.01) / np.log(MAX_FEEDBACK)))  # samples until its response falls to 1 %


@dataclass(frozen=True)
class Channel(Term):
    """Law of the torque channel, which converts the logged torque u into the acting torque; a term u - C u.

    Attributes:
        delay: time by which torque is logged late [s]; if negative, torque acts late by -delay.
        lag: time constant [s] of a low-pass filter in the log, sampled at the end of each period. If negative, -lag is
            the time constant of a filter of the acting torque.
        is_sampled: whether the log has samples of a continuous torque; else torque is held from each sample to the
            next.
    """

    delay: float = 0.0
    lag: float = 0.0
    is_sampled: bool = False

    id = "torque_channel"
    law = "u(t) - u(t + delay) or -lag u'"
    kind = "actuation"
    nonlinear_parameters = tuple(
        NonlinearParameter(name, "s", -REACH, most, nominal=0.0) for name, most in (("delay", LONGEST), ("lag", REACH))
    )

    @property
    def fixed(self) -> tuple[Column, ...]:
        """Return the column of the logged minus the acting torque."""
        return (Column(self.id, "1", force=lambda x: x.torque - x.memory[self.id][0]),)

    @property
    def is_late(self) -> bool:
        """Return whether torque is logged late or filtered, which no physical effect imitates."""
        return self.delay + self.lag > 0

    def remove_filter(self, torque: Array, period: float) -> Array:
        """Return the torque u (N,) before the filter of the log, at a sample time `period` [s].

        The filter is y[k] = a y[k-1] + (1 - a) u[k], a = exp(-period / lag). A lag of at most zero has no effect.
        """
        if self.lag <= 0:
            return torque
        return torque + np.diff(torque, prepend=torque[0]) / np.expm1(min(period / self.lag, 700.0))

    def has_filtered_noise(self, torque: Array, period: float) -> bool:
        """Return whether the log filtered its noise with the torque (N,): it is white without the filter."""
        if self.lag <= 0:
            return False
        reach = int(np.ceil(5 * self.lag / period)) + 1
        response = self.remove_filter(np.eye(1, 2 * reach + 1, reach)[0], period)
        return has_white_noise(self.remove_filter(torque, period), response)

    def hold_torque(self, torque: Array, period: float) -> Array:
        """Return the torque (N,) held from each sample to the next, before delay and filter of the log.

        A held torque u that is logged n + f samples late has the log (1 - f) u[k - n] + f u[k - n - 1]. This mixture is
        inverted forwards in time with the feedback f / (1 - f) for f <= 0.5, else backwards with its inverse. The
        feedback is at most `MAX_FEEDBACK`; the remaining delay is interpolated. The ends repeat. A sampled torque is
        interpolated instead, see `_hold_sampled_torque`. A negative lag is not applied.
        """
        torque = self.remove_filter(torque, period)
        if self.is_sampled:
            return filter_shifted(torque, *_hold_sampled_torque(self.delay / period))
        whole_samples, share = divmod(self.delay / period, 1.0)
        if share <= 0.5:
            acting = _unmix_series(torque, share)
        else:
            whole_samples, acting = whole_samples + 1, _unmix_series(torque[::-1], 1 - share)[::-1]
        return acting[np.clip(np.arange(len(torque)) + int(whole_samples), 0, len(torque) - 1)]

    def trace(self, x: Samples, command: Array, period: float) -> Memory:
        """Return the acting torque, see `average_torque`."""
        return (self.average_torque(command, period),)

    def average_torque(self, torque: Array, period: float) -> Array:
        """Average the acting torque under a triangle from one sample before to one after each sample (N,) [N m].

        A negative lag is applied without the delay.
        """
        if self.lag < 0:
            return average_lagged(torque, -self.lag / period)
        torque = self.remove_filter(torque, period)
        if not self.is_sampled:
            return filter_shifted(torque, *average_delayed(-self.delay / period))
        newest, weights = _hold_sampled_torque(self.delay / period)
        own, average = average_delayed(0.0)
        return filter_shifted(torque, newest + own, np.convolve(weights, average))


def _hold_sampled_torque(late: float) -> tuple[int, Array]:
    """Return the filter of a smooth torque, logged `late` samples late, to the held torque with the same effect.

    A cubic through four samples gives the torque `late` - 0.5 samples later. A filter of four samples adds the missing
    half sample and converts it into held torque, with an error of fourth order. The filter is that of
    `filter_shifted`: its newest sample and weights (7,).
    """
    whole_samples, share = divmod(late - 0.5, 1.0)
    nodes = np.arange(2, -2, -1)
    cubic = [np.prod([(share - b) / (a - b) for b in nodes if b != a]) for a in nodes]
    return int(whole_samples) + 4, np.convolve(cubic, np.array([-1.0, 7.0, 7.0, -1.0]) / 12)


def _unmix_series(mixed: Array, share: float) -> Array:
    """Recover a series u (N,) from its mixture (1 - share) u[k] + share u[k - 1], with a share of at most 0.5.

    The recursion's feedback is at most `MAX_FEEDBACK`; the remaining delay of a slow series is interpolated.
    """
    feedback = min(share / (1 - share), MAX_FEEDBACK)
    unmixed = filter_lag(mixed, -feedback, mixed[0])
    late = share - feedback / (1 + feedback)  # remaining delay of a slow series [samples]
    return (1 - late) * unmixed + late * np.append(unmixed[1:], unmixed[-1])
