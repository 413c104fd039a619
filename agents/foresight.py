"""What torques would teach of plants taken for known: the model of planners and of signals found in advance."""

from __future__ import annotations

import numpy as np

from agents.knowledge import NOMINAL, SLOW
from agents.observer import TICK
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import BASE
from pendulum_env.physics.simulation import Trajectory, simulate

STEP = 5e-3  # [s], of the simulation; of second order, so an action changes little with a finer one


def foresee(torque: Array, theta: Array, position: Array, velocity: Array) -> tuple[Array, Mask]:
    """Rows (T, B, C, P) in nominal units that torques (T, B, C) held for a tick would give, and which are fast enough.

    Args:
        torque: of C candidates for each of B plants [N m].
        theta: parameters of the plants (B, P).
        position: where they start (B,) [rad].
        velocity: and how fast they are (B,) [rad/s].
    """
    shape = torque.shape
    each = [np.repeat(values, shape[-1], axis=-1) for values in (theta.T, position, velocity)]
    way = simulate(BASE, each[0], TICK, torque.reshape(len(torque), -1), each[1], each[2], longest_step=STEP)
    speed = np.abs(way.velocity)
    usable = (speed[1:] >= SLOW) & (speed[:-1] >= SLOW) & (way.velocity[1:] * way.velocity[:-1] > 0)
    return (rows(way, TICK) * NOMINAL).reshape(*shape, -1), usable.reshape(shape)


def rows(way: Trajectory, period: float) -> Array:
    """Torque per unit of inertia, gravity, viscous and dry friction over each period [s] of a motion (T, N, 4)."""
    q, v = way.position, way.velocity
    parts = [np.diff(v, axis=0) / period, np.sin(0.5 * (q[1:] + q[:-1])), np.diff(q, axis=0) / period, np.sign(v[1:])]
    return np.stack(parts, axis=-1)
