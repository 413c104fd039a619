"""What a logged torque means: of the joint or of its motor, with the weight of the links or without.

By the file, the torque of a joint is that of its links' weight and of their inertia. How much of either is in what
was logged tells drivers that take gravity off, torques before the gear, and signs. Files seldom have the right masses,
so that only shares far from one mean anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.regression.equations import Equations
from estimators.regression.least_squares import solve
from estimators.schemes.balance import measure_arm, series
from pendulum_env.arms.body import Body
from pendulum_env.arms.recording import ArmRecording


@dataclass(frozen=True)
class MeaningSettings:
    """Numbers by which a logged torque is questioned; files seldom have the right masses, so they are wide."""

    fast: float = 0.05  # of a joint's largest speed, from which friction has its full size
    notable: float = 0.2  # least share of the file's torque that is weight, where anything is asked
    little: float = 0.2  # share of the weight below which it is not there
    errors: float = 4.0  # standard errors of a share that make it significant
    points: int = 2000  # samples that are used
    blocks: int = 20  # of neighbouring samples, whose errors are correlated


MEANING = MeaningSettings()


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
    def kind(self) -> str:
        """What is odd: "weightless" (inertia without weight), "geared" (all is smaller), "reversed", or nothing."""
        reach = MEANING.errors * self.weight_std
        if self.weight + reach < -MEANING.little:
            return "reversed"
        if not abs(self.weight) + reach < MEANING.little:
            return ""
        return "weightless" if self.inertia > MEANING.little else "geared" if self.weight > reach else ""


def shares(recordings: Sequence[ArmRecording], body: Body) -> list[Share]:
    """How much of the file's torques is in those that were logged, joint by joint.

    Args:
        recordings: whose torques are in N m.
        body: links with masses as the file has them.
    """
    parts = [
        series(m, "position", "velocity", "acceleration", "torque", "moving")
        for recording in recordings
        for m in measure_arm(recording)
    ]
    step = max(1, sum(len(part[0]) for part in parts) // MEANING.points)
    q, v, a, torque, moving = (np.concatenate([own[::step] for own in each]) for each in zip(*parts, strict=True))
    still = body.torque(q, 0 * v, 0 * a) @ body.values  # (N, n)
    moved = body.torque(q, v, a) @ body.values - still
    found = []
    for k, joint in enumerate(body.joints):
        speed = v[:, k]
        use = (moving[:, k] > 0) & (np.abs(speed) > MEANING.fast * np.abs(speed).max())
        phi = np.column_stack([still[:, k], moved[:, k], speed, np.sign(speed), np.ones(len(v))])[use]
        weight, std, inertia = np.nan, np.nan, np.nan
        if len(phi) > MEANING.blocks and np.std(phi[:, 0]) > MEANING.notable * np.std(phi[:, 0] + phi[:, 1]):
            blocks = np.arange(len(phi)) * MEANING.blocks // len(phi)
            fit = solve(Equations(phi, torque[use, k]), np.ones(len(phi)), blocks)
            weight, std, inertia = float(fit.theta[0]), float(fit.std[0]), float(fit.theta[1])
        found.append(Share(joint, weight, std, inertia))
    return found
