"""What torques would teach of plants taken for known: the model of planners and of signals found in advance."""

from __future__ import annotations

import numpy as np

from agents.knowledge import NOMINAL, SLOW
from agents.observer import TICK
from agents.structure import Structure
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import BASE, Samples
from pendulum_env.physics.simulation import simulate

STEP = 5e-3  # [s], of the simulation; of second order, so an action changes little with a finer one


def foresee(
    torque: Array, theta: Array, position: Array, velocity: Array, structure: Structure | None = None
) -> tuple[Array, Mask]:
    """Rows (T, B, C, P) in nominal units that torques (T, B, C) held for a tick would give, and which are fast enough.

    Args:
        torque: of C candidates for each of B plants [N m].
        theta: parameters of the plants (B, P).
        position: where they start (B,) [rad].
        velocity: and how fast they are (B,) [rad/s].
        structure: whose effects' rows follow those of the base model.
    """
    ticks, batch, candidates = torque.shape
    each = [np.repeat(values, candidates, axis=-1) for values in (theta.T, position, velocity)]
    way = simulate(BASE, each[0], TICK, torque.reshape(ticks, -1), each[1], each[2], longest_step=STEP)
    q, v = way.position, way.velocity
    rows = np.stack(
        [np.diff(v, axis=0) / TICK, np.sin(0.5 * (q[1:] + q[:-1])), np.diff(q, axis=0) / TICK, np.sign(v[1:])],
        axis=-1,
    )
    usable = (np.abs(v[1:]) >= SLOW) & (np.abs(v[:-1]) >= SLOW) & (v[1:] * v[:-1] > 0)
    shape, rows = (ticks, batch, candidates), rows * NOMINAL
    if structure is not None:
        middle, speed, held = 0.5 * (q[1:] + q[:-1]), np.diff(q, axis=0) / TICK, torque.reshape(ticks, -1)
        more = structure.rows(Samples(np.zeros((1, 1, 1)), middle[None], speed[None], held[None]))
        rows = np.concatenate([rows, more], axis=-1)
        going = np.sign(v[1:]) * usable
        ends = np.concatenate([going[:1], going, going[-1:]])
        usable = usable & (ends[:-2] == going) & (ends[2:] == going)  # nothing counts within a tick of a reversal
    return rows.reshape(*shape, -1), usable.reshape(shape)
