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
POINTS = 2000  # samples that are looked at
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
    step = max(1, sum(len(m[0]) for m in parts) // POINTS)
    moves = [tuple(series[::step] for series in motion(m)) for m in parts]
    still = np.concatenate([body.torque(q, 0 * v, 0 * a) @ body.values for q, v, a in moves])  # (N, n)
    moved = np.concatenate([body.torque(q, v, a) @ body.values for q, v, a in moves]) - still
    speed = np.concatenate([v for _, v, _ in moves])
    torque, moving = (
        np.concatenate([np.column_stack([getattr(m[k], what)[::step] for k in range(len(m))]) for m in parts])
        for what in ("torque", "moving")
    )
    for k, joint in enumerate(body.joints):
        v = speed[:, k]
        use = moving[:, k] & (np.abs(v) > FAST * np.abs(v).max())
        phi = np.column_stack([still[:, k], moved[:, k], v, np.sign(v), np.ones(len(v))])[use]
        notable = use.sum() > BLOCKS and np.std(phi[:, 0]) > NOTABLE * np.std(phi[:, 0] + phi[:, 1])
        value, std = _weighed(phi, torque[use, k]) if notable else (np.full(5, np.nan), np.full(5, np.nan))
        found.append(Share(joint, float(value[0]), float(std[0]), float(value[1])))
    return found


def _weighed(phi: Array, y: Array) -> tuple[Array, Array]:
    """Least squares with standard errors by blocks of neighbours."""
    inverse = np.linalg.pinv(phi.T @ phi)
    value = inverse @ phi.T @ y
    block = (np.arange(len(y)) * BLOCKS) // len(y)
    scores = np.array([np.bincount(block, column * (y - phi @ value)) for column in phi.T])  # (columns, blocks)
    return value, np.sqrt(np.diag(inverse @ (scores @ scores.T) @ inverse))
