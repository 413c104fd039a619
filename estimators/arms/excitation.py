"""Excitation of an arm: a reference that makes its base parameters show, within the limits of its joints.

Each joint follows a Fourier series whose periods fit into the excitation, so that it can be repeated. Random series are
scaled into the limits; the one that teaches most, by the determinant of its information, is then changed by chance as
long as it teaches more: an evolution strategy with one parent and one child, whose steps grow with success.
Source: Swevers, Ganseman, Tukel, de Schutter and Van Brussel, IEEE Transactions on Robotics and Automation 13(5), 1997;
Beyer and Schwefel, Evolution strategies, Natural Computing 1(1), 2002.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.regression.equations import IdentificationError
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body
from pendulum_env.excitation import USUAL_SPEED

PERIOD = 10.0  # [s]


@dataclass(frozen=True)
class DesignSettings:
    """Numbers of the design and of its evolution strategy."""

    points: int = 120  # instants at which a series is judged
    angle: float = np.pi  # [rad] to either side, where the file has no limits
    stroke: float = 0.2  # [m] to either side, likewise
    slide: float = 0.5  # [m/s], largest speed of a joint that slides
    narrowest: float = 1e-3  # [rad] or [m] between limits, below which a motion is of no use
    margin: float = 0.9  # of the limits that is used
    shares: tuple[float, ...] = (1.0, 0.7, 0.5, 0.35, 0.25)  # of the motion that are tried until the torque suffices
    anew: float = 0.1  # share of the tries that are drawn anew
    step: float = 0.3  # of a change, the first
    grows: float = 1.5  # step after a change that was better,
    shrinks: float = 0.9  # and after one that was not: the two cancel at one success in five


DESIGN = DesignSettings()


@dataclass(frozen=True, eq=False)
class Excited:
    """A reference motion of n joints.

    Attributes:
        body: the arm.
        middle: of the motion (n,) [rad].
        sines, cosines: of the harmonics (K, n) [rad].
        period: after which it repeats [s].
    """

    body: Body
    middle: Array
    sines: Array
    cosines: Array
    period: float

    def __call__(self, time: Array) -> tuple[Array, Array, Array]:
        """Position [rad], velocity [rad/s] and acceleration [rad/s^2] of the joints (N, n) at N instants [s]."""
        w = 2 * np.pi / self.period * np.arange(1, len(self.sines) + 1)
        s, c = np.sin(np.outer(time, w)), np.cos(np.outer(time, w))
        a, b = self.sines, self.cosines
        return self.middle + s @ a + c @ b, (c * w) @ a - (s * w) @ b, -(s * w**2) @ a - (c * w**2) @ b

    def torque(self, time: Array) -> Array:
        """Torque that the body needs by its file, without friction (N, n) [N m]."""
        return np.asarray(self.body.torque(*self(time)) @ self.body.values)

    def rows(self, time: Array) -> Array:
        """Regressor of the torques in base parameters, viscous and dry friction (N, n, P)."""
        q, v, a = self(time)
        own = np.eye(v.shape[1])
        return np.concatenate([self.body.torque(q, v, a), v[:, :, None] * own, np.sign(v)[:, :, None] * own], axis=2)

    @property
    def condition(self) -> float:
        """Condition number of the torque regressor in base parameters and friction, columns scaled to equal length."""
        rows = self.rows(np.linspace(0, self.period, DESIGN.points, endpoint=False))
        phi = rows.reshape(-1, rows.shape[-1])
        return float(np.linalg.cond(phi / np.linalg.norm(phi, axis=0)))


def design_excitation(
    body: Body,
    period: float = PERIOD,
    *,
    harmonics: int = 5,
    max_angle: float | None = None,
    max_speed: float | None = None,
    max_torque: float | None = None,
    tries: int = 600,
    rng: np.random.Generator | None = None,
) -> Excited:
    """A series within the joints' limits of position, speed and torque that teaches much, found in `tries` steps.

    Args:
        body: with the limits of its file; half a turn, or 0.2 m, to either side where it has none.
        period: of the motion [s].
        harmonics: of each joint.
        max_angle: bound of every angle to either side of zero [rad], if less than the file's.
        max_speed: bound of every angle's speed [rad/s], if less than the file's; 4 rad/s, or 0.5 m/s, without one.
        max_torque: bound of every torque [N m], if less than the file's.
        tries: series that are judged, the first at random, the others near the best so far.
        rng: that draws them.

    Raises:
        IdentificationError: if no series keeps within the torque limits, or a joint's limits leave no room.
    """
    rng = rng or np.random.default_rng(0)
    low, high = _room(body, max_angle)
    slides = np.array(body.slides)
    speed = np.where(slides, DESIGN.slide, USUAL_SPEED if max_speed is None else max_speed)
    speed = np.minimum(body.velocity_limits, speed)
    most = np.minimum(body.torque_limits, np.where(slides, np.inf, np.inf if max_torque is None else max_torque))
    time = np.linspace(0, period, DESIGN.points, endpoint=False)
    alike = 1.0 / np.sqrt(np.arange(1, harmonics + 1))[:, None]  # size of the harmonics
    best: Excited | None = None
    parent, most_known, step = (np.zeros((2, harmonics, len(low))), np.full(len(low), 0.5)), -np.inf, DESIGN.step
    for k in range(tries):
        anew = best is None or k < DESIGN.anew * tries
        waves = step * rng.normal(size=parent[0].shape) * alike + parent[0]
        at = np.clip(step * rng.uniform(-0.1, 0.1, len(low)) + parent[1], 0.4, 0.6)  # of the way from low to high
        if anew:
            waves, at = rng.normal(size=waves.shape) * alike, rng.uniform(0.4, 0.6, len(low))
        middle = low + (high - low) * at
        q, v, _ = Excited(body, np.zeros(len(low)), waves[0], waves[1], period)(time)
        room = np.minimum(high - middle, middle - low)
        scale = DESIGN.margin * np.minimum(room / np.abs(q).max(axis=0), speed / np.abs(v).max(axis=0))
        known = -np.inf
        for share in DESIGN.shares:
            tried = Excited(body, middle, waves[0] * scale * share, waves[1] * scale * share, period)
            rows = tried.rows(time)
            if np.all(np.abs(rows[..., : len(body.values)] @ body.values) <= DESIGN.margin * most):
                phi = rows.reshape(-1, rows.shape[-1])
                known = float(np.linalg.slogdet(phi.T @ phi).logabsdet)
                break
        if known > most_known:
            best, parent, most_known = tried, (waves, at), known
        if not anew:
            step *= DESIGN.grows if known == most_known else DESIGN.shrinks
    if best is None:
        raise IdentificationError(
            f"{body.name}: every motion of {tries} needs more torque than the joints have: allow less speed or "
            "angle, or more torque"
        )
    return best


def _room(body: Body, max_angle: float | None) -> tuple[Array, Array]:
    """Lowest and highest position (n,) of each joint [rad or m].

    Raises:
        IdentificationError: if they leave a joint no room.
    """
    slides, joints = np.array(body.slides), np.array(body.joints)
    (low, high), usual = body.position_limits, np.where(slides, DESIGN.stroke, DESIGN.angle)
    low, high = np.where(np.isfinite(low), low, -usual), np.where(np.isfinite(high), high, usual)
    if max_angle is not None:
        reach = np.where(slides, np.inf, max_angle)
        low, high = np.maximum(low, -reach), np.minimum(high, reach)
        for joint in joints[low >= high]:
            raise IdentificationError(
                f"{body.name}: joint '{joint}' is never within {max_angle:g} rad of zero: allow a larger angle"
            )
    for joint in joints[high - low < DESIGN.narrowest]:
        raise IdentificationError(f"{body.name}: the limits of joint '{joint}' leave it no room to move: widen them")
    return low, high
