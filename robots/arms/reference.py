"""Reference motions of an arm from knot to knot, within the limits of its joints.

Speeds are linear in time between knots. The reference is the moving average of this motion over one period of knots.
The average keeps the limits of angle and speed, and its acceleration is continuous.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pendulum_env._typing import Array
from robots.arms.body import Body
from robots.arms.limits import Limits

KNOT_PERIOD = 0.1  # [s] between knots
TICK = 0.02  # [s] between rows
SPEED_SHARES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.1)  # of a change of speed, tried in this order for enough torque
TORQUE_SHARE = 0.9  # used share of the torque limit


def average_motion(q: Array, before: Array, now: Array, after: Array, s: Array) -> tuple[Array, Array, Array]:
    """Compute position, velocity and acceleration of the reference; all arguments broadcast.

    Args:
        q: position at the last but one knot [rad or m].
        before: speed at that knot.
        now: speed at the last knot.
        after: speed at the next knot.
        s: time since the last knot [s].
    """
    h, last = KNOT_PERIOD, q + 0.5 * KNOT_PERIOD * (before + now)
    rise, next_rise = (now - before) / h, (after - now) / h
    position = q * (h - s) + before * (h**2 - s**2) / 2 + rise * (h**3 - s**3) / 6
    position = position + last * s + now * s**2 / 2 + next_rise * s**3 / 6
    velocity = before * (h - s) + rise * (h**2 - s**2) / 2 + now * s + next_rise * s**2 / 2
    return position / h, velocity / h, (rise * (h - s) + next_rise * s) / h


def limit_speeds(body: Body, limits: Limits, q: Array, v: Array, share: Array) -> Array:
    """Limit requested speeds at the next knot (N, n) by acceleration, angle and torque.

    A joint can always stop before the end of its range with half its acceleration. This has priority over the limit of
    the torque, which is computed from the file without friction. Positions q and speeds v (N, n) are those at the last
    knot. `share` (N, n) is the requested share of the largest speed, in [-1, 1].
    """
    h, max_change = KNOT_PERIOD, limits.acceleration * KNOT_PERIOD
    deceleration = np.minimum(0.5 * limits.acceleration, (limits.high - limits.low) / h**2)
    # up and down, the largest w with w^2 / (2 deceleration) + h w / 2 within the room; without room, it slows down
    up, down = (
        np.where(
            room >= 0,
            np.sqrt((0.5 * deceleration * h) ** 2 + 2 * deceleration * np.maximum(room, 0.0)) - 0.5 * deceleration * h,
            speed - deceleration * h,
        )
        for room, speed in ((limits.high - q - 0.5 * h * v, v), (q + 0.5 * h * v - limits.low, -v))
    )
    high, low = (sign * np.clip(speed, -limits.speed, limits.speed) for sign, speed in ((1, up), (-1, down)))
    change = np.clip(np.clip(share * limits.speed, low, high) - v, -max_change, max_change)
    accepted, excess = np.zeros_like(change), np.full(len(q), np.inf)
    changes = change, np.clip(-v, -max_change, max_change)  # if no share of the first suffices, it slows down
    for requested, factor in itertools.product(changes, SPEED_SHARES):
        a = factor * requested / h
        ends = (q, v), (q + h * v + 0.5 * h**2 * a, v + h * a)
        needed = np.max([np.abs(body.torque(*end, a) @ body.values) for end in ends], axis=0)
        ratio = (needed / np.maximum(TORQUE_SHARE * limits.torque, 1e-300)).max(axis=1)
        is_better = (excess > 1) & (ratio < excess)
        accepted[is_better], excess[is_better] = factor * requested[is_better], ratio[is_better]
        if (excess <= 1).all():
            break
    return np.clip(v + accepted, np.maximum(low, v - max_change), np.minimum(high, v + max_change))


def make_torque_rows(body: Body, q: Array, v: Array, a: Array) -> Array:
    """Compute the torque regressor of base parameters, viscous and dry friction (N, n, P) of a motion (N, n)."""
    eye = np.eye(v.shape[1])
    return np.concatenate([body.torque(q, v, a), v[:, :, None] * eye, np.sign(v)[:, :, None] * eye], axis=2)


def compute_condition_number(rows: Array) -> float:
    """Compute the condition number of a regressor (N, n, P) with scaled columns; infinite if a column is zero."""
    phi = rows.reshape(-1, rows.shape[-1])
    length = np.linalg.norm(phi, axis=0)
    return float(np.linalg.cond(phi / length)) if length.all() else np.inf


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference motion of n joints, from rest to rest.

    Attributes:
        body: the arm.
        start: initial positions (n,) [rad or m].
        speeds: speeds at the knots (K + 1, n) [rad/s or m/s]; zero at the first, and if torque suffices at the last.
    """

    body: Body
    start: Array
    speeds: Array

    def __str__(self) -> str:
        return f"a motion of {self.seconds:g} s from rest to rest"

    @property
    def condition(self) -> float:
        """Return the condition number of the torque regressor of base parameters and friction with scaled columns."""
        return compute_condition_number(make_torque_rows(self.body, *self(np.arange(TICK / 2, self.seconds, TICK))))

    @property
    def seconds(self) -> float:
        """Return the duration from rest to rest [s]."""
        return KNOT_PERIOD * len(self.speeds)

    def __call__(self, time: Array) -> tuple[Array, Array, Array]:
        """Compute position, velocity and acceleration of the joints (N, n) at N instants [s]; at rest outside."""
        (q, v), time = self._knots, np.clip(time, 0.0, self.seconds)
        k = np.clip(np.floor(time / KNOT_PERIOD + 1e-9).astype(int), 0, len(v) - 3)
        s = np.minimum(time - KNOT_PERIOD * k, KNOT_PERIOD)[:, None]
        return average_motion(q[k], v[k], v[k + 1], v[k + 2], s)

    @cached_property
    def _knots(self) -> tuple[Array, Array]:
        """Return positions and speeds at the knots, with one knot before the start and two after the end."""
        v = np.pad(self.speeds, ((1, 2), (0, 0)))
        return self.start + KNOT_PERIOD * np.pad(np.cumsum(0.5 * (v[1:] + v[:-1]), axis=0), ((1, 0), (0, 0))), v
