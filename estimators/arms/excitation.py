"""Excitation of an arm: a reference that makes its base parameters show, within the limits of its joints.

Each joint follows a Fourier series whose periods fit into the excitation, so that it can be repeated. Among random
series, scaled into the limits, the one with the best conditioned regressor is kept.
Source: Swevers, Ganseman, Tukel, de Schutter and Van Brussel, IEEE Transactions on Robotics and Automation 13(5), 1997.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimators.regression.equations import IdentificationError
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body
from pendulum_env.excitation import USUAL_SPEED

PERIOD = 10.0  # [s]
POINTS = 120  # instants at which a series is judged
USUAL_RANGE, USUAL_STROKE = np.pi, 0.2  # [rad] and [m] to either side, where the file has no limits
USUAL_SLIDE = 0.5  # [m/s]
MARGIN = 0.9  # of the limits that is used
SHARES = (1.0, 0.7, 0.5, 0.35, 0.25)  # of the motion that is tried until the torque suffices


@dataclass(frozen=True, eq=False)
class Excited:
    """A reference motion of n joints.

    Attributes:
        body: the arm.
        middle: of the motion (n,) [rad].
        sines, cosines: of the harmonics (K, n) [rad].
        period: after which it repeats [s].
        condition: of the torque regressor in base parameters and friction, columns scaled to equal length.
    """

    body: Body
    middle: Array
    sines: Array
    cosines: Array
    period: float
    condition: float

    def __call__(self, time: Array) -> tuple[Array, Array, Array]:
        """Position [rad], velocity [rad/s] and acceleration [rad/s^2] of the joints (N, n) at N instants [s]."""
        order = np.arange(1, len(self.sines) + 1)
        w = 2 * np.pi / self.period * order
        s, c = np.sin(np.outer(time, w)), np.cos(np.outer(time, w))
        a, b = self.sines, self.cosines
        return (
            self.middle + s @ a + c @ b,
            (c * w) @ a - (s * w) @ b,
            -(s * w**2) @ a - (c * w**2) @ b,
        )

    def torque(self, time: Array) -> Array:
        """Torque that the body needs by its file, without friction (N, n) [N m]."""
        return np.asarray(self.body.torque(*self(time)) @ self.body.values)


def design_excitation(
    body: Body,
    period: float = PERIOD,
    *,
    harmonics: int = 5,
    max_angle: float | None = None,
    max_speed: float | None = None,
    max_torque: float | None = None,
    tries: int = 60,
    rng: np.random.Generator | None = None,
) -> Excited:
    """The best of `tries` random series within the joints' limits of position, speed and torque.

    Args:
        body: with the limits of its file; half a turn, or 0.2 m, to either side where it has none.
        period: of the motion [s].
        harmonics: of each joint.
        max_angle: bound of every angle to either side of zero [rad], if less than the file's.
        max_speed: bound of every angle's speed [rad/s], if less than the file's; 4 rad/s, or 0.5 m/s, without one.
        max_torque: bound of every torque [N m], if less than the file's.
        tries: series that are drawn.
        rng: that draws them.

    Raises:
        IdentificationError: if no series keeps within the torque limits, or a joint's limits leave no room.
    """
    rng = rng or np.random.default_rng(0)
    low, high = body.position_limits
    slides = np.array(body.slides)
    usual = np.where(slides, USUAL_STROKE, USUAL_RANGE)
    low, high = np.where(np.isfinite(low), low, -usual), np.where(np.isfinite(high), high, usual)
    if max_angle is not None:
        reach = np.where(slides, np.inf, max_angle)
        low, high = np.maximum(low, -reach), np.minimum(high, reach)
        for joint in np.array(body.joints)[low >= high]:
            raise IdentificationError(
                f"{body.name}: joint '{joint}' is never within {max_angle:g} rad of zero: allow a larger angle"
            )
    speed = np.where(slides, USUAL_SLIDE, USUAL_SPEED if max_speed is None else max_speed)
    speed = np.minimum(body.velocity_limits, speed)
    most = np.minimum(body.torque_limits, np.where(slides, np.inf, np.inf if max_torque is None else max_torque))
    time = np.linspace(0, period, POINTS, endpoint=False)
    best: Excited | None = None
    for _ in range(tries):
        drawn = rng.normal(size=(2, harmonics, len(body.joints))) / np.sqrt(np.arange(1, harmonics + 1))[:, None]
        middle = low + (high - low) * rng.uniform(0.4, 0.6, len(low))
        unit = Excited(body, np.zeros(len(low)), drawn[0], drawn[1], period, np.inf)
        q, v, _ = unit(time)
        room = np.minimum(high - middle, middle - low)
        scale = MARGIN * np.minimum(room / np.abs(q).max(axis=0), speed / np.abs(v).max(axis=0))
        for share in SHARES:
            tried = Excited(body, middle, drawn[0] * scale * share, drawn[1] * scale * share, period, np.inf)
            if np.all(np.abs(tried.torque(time)) <= MARGIN * most):
                condition = _condition(tried, time)
                if best is None or condition < best.condition:
                    best = replace(tried, condition=condition)
                break
    if best is None:
        raise IdentificationError(
            f"{body.name}: every motion of {tries} needs more torque than the joints have: allow less speed or "
            "angle, or more torque"
        )
    return best


def _condition(excited: Excited, time: Array) -> float:
    q, v, a = excited(time)
    links = excited.body.torque(q, v, a)  # (N, n, P)
    own = np.eye(v.shape[1])
    friction = np.concatenate([v[:, :, None] * own, np.sign(v)[:, :, None] * own], axis=2)
    phi = np.concatenate([links, friction], axis=2).reshape(-1, links.shape[2] + 2 * v.shape[1])
    return float(np.linalg.cond(phi / np.linalg.norm(phi, axis=0)))
