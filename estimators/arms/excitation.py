"""Excitation of an arm knot by knot: which speeds its joints have next, within their limits, to learn most of it.

Under a robot's own controller the motion, and so what it teaches, does not depend on the parameters that are to be
learnt: it is chosen in advance, by A-optimality of relative errors (Fedorov, Theory of Optimal Experiments, 1972) and a
beam search (Lowerre, The Harpy Speech Recognition System, 1976).
"""

from __future__ import annotations

from typing import Self

import numpy as np

from estimators.arms.limits import Limits, limits_of
from estimators.arms.reference import HOLD, TICK, Reference, averaged, reachable, torque_rows
from estimators.regression.equations import IdentificationError
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.arms.body import Body
from pendulum_env.arms.plane import friction_of
from pendulum_env.plant import PAPER

SLOW = 0.05  # [rad/s or m/s]; slower than this nothing is learnt: estimators keep clear of stick,
GUARD = 0.03  # [s] before and after a reversal, their filters' reach included
PRIOR = 0.1  # of the information: (noise / spread)^2 with 0.1 N m of noise on a tick and arms within some 30 %
CRAWL = 0.15  # [rad/s or m/s], where dry friction is told from viscous best: slow, and clear of stick all the same
BREADTH = 3200  # numbers in the information matrices of the motions that are carried on: 32 for two links, 1 for six
SHARES = (1.0, 0.7, 0.5, 0.35, 0.25)  # of the acceleration that are tried until the torque suffices
TOO_WEAK = "moving needs more torque than the joints have: allow less speed or angle, or more torque"


def clear(v: Array, a: Array) -> Mask:
    """Where velocity [rad/s or m/s] is clear of stick and, at this acceleration, of reversals; the shapes of both."""
    return np.abs(v) >= SLOW + GUARD * np.abs(a)


def sizes(body: Body) -> Array:
    """What counts as the size of base parameters, viscous and dry friction (P,), by the file.

    A first moment counts as large as that of its link along all axes, an element of its inertia as large as all, and
    where a link has none, as the smallest that another has: nothing is zero for certain.
    """
    groups = []  # kind, and whose it is
    for quantity, _, joint in (name.partition("@") for name in body.names):
        alone = quantity in ("m", "rotor")
        groups.append(({"m": "mass", "rotor": "I"}[quantity] if alone else quantity[0], f"{quantity * alone}@{joint}"))
    norms = {own: float(np.linalg.norm(body.values[[other == own for other in groups]])) for own in groups}
    known = sorted((norm, kind) for (kind, _), norm in norms.items() if norm > 0)
    least = {kind: next((norm for norm, other in known if other == kind), 1.0) for kind, _ in groups}
    links = [norms[own] or least[own[0]] for own in groups]
    friction = np.array(friction_of(body)).T
    for own, usual in zip(friction, (PAPER["viscous"], PAPER["coulomb"]), strict=True):
        own[own == 0] = min(own[own > 0], default=usual)
    return np.concatenate([links, *friction])


def telling(body: Body, own: Array, q: Array, v: Array, a: Array) -> Array:
    """Rows (N, n, P) of a motion in parameters as shares of their sizes `own` (P,), zero where it is not clear."""
    return torque_rows(body, q, v, a) * own * clear(v, a)[..., None]


class Moving:
    """B motions of an arm at a knot, and what they have taught.

    Attributes:
        limits: of the joints, (B, n) each.
        speed: at the last knot (B, n) [rad/s or m/s].
        information: of parameters as shares of their sizes, in units of the noise of a tick's mean torque (B, P, P).
        variances: squared standard errors of the parameters, in the same units (B, P).
    """

    def __init__(self, body: Body, limits: Limits, batch: int) -> None:
        """Begin at rest, with all joints as near to zero as they may be; limits are (n,) or (B, n)."""
        self._body, self._sizes = body, sizes(body)
        self.limits = Limits(*(np.broadcast_to(values, (batch, values.shape[-1])) for values in limits))
        self._place = np.clip(0.0, self.limits.low, self.limits.high)  # at the knot before the last
        self._before, self.speed = np.zeros((2, *self._place.shape))
        self.information = np.tile(PRIOR * np.eye(len(self._sizes)), (batch, 1, 1))
        self.variances = np.full((batch, len(self._sizes)), 1 / PRIOR)

    def chosen(self, which: Index) -> Self:
        """Copies of those motions of the batch; one may be chosen several times."""
        other = object.__new__(type(self))
        other._body, other._sizes = self._body, self._sizes
        other.limits = Limits(*(values[which] for values in self.limits))
        for name in ("_place", "_before", "speed", "information", "variances"):
            setattr(other, name, getattr(self, name)[which])
        return other

    @property
    def position(self) -> Array:
        """At the last knot (B, n) [rad or m]."""
        return self._place + 0.5 * HOLD * (self._before + self.speed)

    def go(self, share: Array) -> None:
        """Go on to the next knot, with shares (B, n) of the largest speeds there as far as limits allow."""
        position = self.position
        after = reachable(self._body, self.limits, position, self.speed, share)
        s = np.arange(TICK / 2, HOLD, TICK)[:, None]
        knots = (x[:, None] for x in (self._place, self._before, self.speed, after))
        way = averaged(*knots, s)  # type: ignore[call-arg]  # (B, ticks, n) each
        q, v, a = (x.reshape(-1, x.shape[-1]) for x in way)
        rows = telling(self._body, self._sizes, q, v, a).reshape(len(position), -1, len(self._sizes))
        self.information = self.information + np.swapaxes(rows, 1, 2) @ rows
        self.variances = np.asarray(np.linalg.inv(self.information).diagonal(axis1=1, axis2=2))
        self._place, self._before, self.speed = position, self.speed, after

    @property
    def worth(self) -> Array:
        """How small the standard errors are (B,) [nat]: minus the logarithm of their root mean square."""
        return -0.5 * np.log(self.variances.mean(axis=1))


def design_excitation(
    body: Body,
    seconds: float = 10.0,
    *,
    max_angle: float | None = None,
    max_speed: float | None = None,
    max_torque: float | None = None,
    max_acceleration: float | None = None,
    rng: np.random.Generator | None = None,
) -> Reference:
    """A motion within the joints' limits that teaches much, found knot by knot.

    One joint after the other, in an order drawn anew at each knot, goes at full speed or at a crawl, to either side. Of
    all motions that come of this, those go on after which all standard errors together are smallest: many for a few
    joints, the best alone for six. After the time the arm is brought to rest.

    Args:
        body: with the limits of its file; half a turn, or 0.2 m, to either side where it has none.
        seconds: of the motion, until it is brought to rest.
        max_angle: bound of every angle to either side of zero [rad], if less than the file's.
        max_speed: bound of every angle's speed [rad/s], if less than the file's; 4 rad/s, or 0.5 m/s, without one.
        max_torque: bound of every torque [N m], if less than the file's.
        max_acceleration: bound of every angle's acceleration [rad/s^2]; by default the largest speed takes 0.2 s.
        rng: that draws the orders.

    Raises:
        IdentificationError: if limits leave a joint no room, a bound makes no sense, or every motion needs more torque.
        BodyError: if a link has an inertia that no body has.
    """
    body.refuse_impossible_links()
    if not HOLD <= seconds < np.inf:
        raise IdentificationError(f"a motion cannot last {seconds:g} s: give {HOLD:g} s or more")
    rng, limits = rng or np.random.default_rng(0), limits_of(body, max_angle, max_speed, max_torque, max_acceleration)
    for share in SHARES:
        found = _search(body, limits._replace(acceleration=share * limits.acceleration), seconds, rng)
        if not objection(found, limits):
            return found
    raise IdentificationError(f"{body.name}: {TOO_WEAK}")


def objection(motion: Reference, limits: Limits) -> str:
    """What speaks against a motion: torque beyond the limits, friction left out, or a joint that does not move."""
    q, v, a = motion(np.arange(0.0, motion.seconds, TICK))
    affordable = np.abs(motion.body.torque(q, v, a) @ motion.body.values) <= limits.torque
    if not affordable.all() or motion.speeds[-1].any():
        return TOO_WEAK
    still = np.array(motion.body.joints)[~motion.speeds.any(axis=0)]
    return f"joint '{still[0]}' never moves" if len(still) else ""


def _search(body: Body, limits: Limits, seconds: float, rng: np.random.Generator) -> Reference:
    moving = Moving(body, limits, 1)
    start, speeds = moving.position[0], moving.speed[:, None]  # (W, knots, n) of the W motions that are carried on
    shares, width = np.zeros_like(moving.speed), max(1, BREADTH // len(sizes(body)) ** 2)
    crawl = np.minimum(CRAWL / limits.speed, 1.0)
    levels = np.array([-np.ones_like(crawl), -crawl, crawl, np.ones_like(crawl)])
    for _ in range(round(seconds / HOLD)):
        owners = np.arange(len(shares))
        for joint in rng.permutation(len(body.joints)):
            of, tried = np.repeat(owners, len(levels)), np.repeat(shares, len(levels), axis=0)
            tried[:, joint] = np.tile(levels[:, joint], len(shares))
            candidates = moving.chosen(of)
            candidates.go(tried)
            # the same worth is the same motion, because limits leave no choice, or its image in a mirror
            best = np.unique(candidates.worth.round(9), return_index=True)[1][::-1][:width]
            shares, owners = tried[best], of[best]
        moving = candidates.chosen(best)
        speeds = np.concatenate([speeds[owners], moving.speed[:, None]], axis=1)
    return to_rest(body, moving.chosen(np.arange(1)), start, list(speeds[0][:, None]))


def to_rest(body: Body, moving: Moving, start: Array, speeds: list[Array]) -> Reference:
    """The motion that had these speeds, each (1, n), brought to rest where the torque allows that."""
    count = len(speeds)
    limits = moving.limits
    longest = 10 + 4 * np.ceil(limits.speed / (HOLD * limits.acceleration)).max()  # twice what half of it takes
    while np.any(moving.speed) and len(speeds) < count + longest:
        moving.go(np.zeros_like(moving.speed))
        speeds.append(moving.speed)
    return Reference(body, start, np.concatenate(speeds))
