"""What a logged torque means: of the joint or of its motor, with the weight of the links or without.

By the file, the torque of a joint is that of its links' weight and of their inertia. How much of either is in what
was logged tells drivers that take gravity off, torques before the gear, and signs. Files seldom have the right masses,
so that only shares far from one mean anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.arms.balance import measure_arm, motion
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body
from pendulum_env.arms.recording import ArmRecording

FAST = 0.05  # of a joint's largest speed, from which friction has its full size
NOTABLE = 0.2  # share of the file's torque that weight is at least, for anything to be said
LITTLE, SURE = 0.2, 4.0  # share of the weight below which it is not there, and standard errors that make it sure
BLOCKS = 20  # of neighbouring samples, which err alike


@dataclass(frozen=True)
class Share:
    """How much of the file's torques is in that of a joint.

    Attributes:
        joint: its name.
        weight: share of the links' weight; not a number where that is no notable part.
        weight_std: its standard error.
        inertia: share of the rest.
    """

    joint: str
    weight: float
    weight_std: float
    inertia: float

    @property
    def is_weightless(self) -> bool:
        """Whether links have inertia and no weight, as where the driver takes gravity off."""
        return self._is_little and self.inertia > LITTLE

    @property
    def is_geared(self) -> bool:
        """Whether all is as much smaller, as before a gear."""
        return self._is_little and not self.is_weightless and self.weight > SURE * self.weight_std

    @property
    def is_reversed(self) -> bool:
        """Whether the weight has the other sign."""
        return self.weight + SURE * self.weight_std < -LITTLE

    @property
    def _is_little(self) -> bool:
        return abs(self.weight) + SURE * self.weight_std < LITTLE


def shares(recordings: Sequence[ArmRecording], body: Body) -> list[Share]:
    """How much of the file's torques is in those that were logged, joint by joint.

    Args:
        recordings: whose torques are in N m.
        body: links with masses as the file has them.
    """
    found = []
    parts = [m for recording in recordings for m in measure_arm(recording)]
    moves = [motion(m) for m in parts]
    torques = [[(body.torque(q, v * moving, a * moving) @ body.values) for moving in (0.0, 1.0)] for q, v, a in moves]
    for k, joint in enumerate(body.joints):
        rows = [
            (np.column_stack([still[:, k], (moved - still)[:, k], v[:, k], np.sign(v[:, k]), np.ones(len(v))]), m[k])
            for m, (_, v, _), (still, moved) in zip(parts, moves, torques, strict=True)
        ]
        fast = FAST * max(float(np.abs(m.velocity).max()) for _, m in rows)
        use = [m.moving & (np.abs(m.velocity) > fast) for _, m in rows]
        phi = np.concatenate([columns[own] for (columns, _), own in zip(rows, use, strict=True)])
        y = np.concatenate([m.torque[own] for (_, m), own in zip(rows, use, strict=True)])
        notable = len(y) > BLOCKS and np.std(phi[:, 0]) > NOTABLE * np.std(phi[:, 0] + phi[:, 1])
        value, std = _weighed(phi, y) if notable else (np.full(5, np.nan), np.full(5, np.nan))
        found.append(Share(joint, float(value[0]), float(std[0]), float(value[1])))
    return found


def _weighed(phi: Array, y: Array) -> tuple[Array, Array]:
    """Least squares with standard errors by blocks of neighbours."""
    inverse = np.linalg.pinv(phi.T @ phi)
    value = inverse @ phi.T @ y
    block = (np.arange(len(y)) * BLOCKS) // len(y)
    scores = np.array([np.bincount(block, column * (y - phi @ value)) for column in phi.T])  # (columns, blocks)
    return value, np.sqrt(np.diag(inverse @ (scores @ scores.T) @ inverse))
