"""Design of excitation motions of an arm, knot by knot, within the limits of its joints.

The arm follows the motion with its own controller, so the information does not depend on the unknown parameters. The
motion is designed in advance, by A-optimality of relative errors and a beam search.
Source: Fedorov, Theory of Optimal Experiments, 1972; Lowerre, The Harpy Speech Recognition System, 1976.
"""

from __future__ import annotations

from typing import Self

import numpy as np

from estimators.regression.least_squares import IdentificationError
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.plant import PAPER
from robots.arms.body import Body
from robots.arms.limits import Limits, find_limits
from robots.arms.plane import get_friction
from robots.arms.reference import KNOT_PERIOD, TICK, Reference, average_motion, limit_speeds, make_torque_rows

MIN_SPEED = 0.05  # [rad/s or m/s]; slower samples are near stick and have no information
REVERSAL_GUARD = 0.03  # [s] before and after a reversal, including the reach of filters
INFORMATION_PRIOR = 0.1  # (noise / spread)^2 with 0.1 N m of noise per tick and a spread of the arms of 30 %
CRAWL_SPEED = 0.15  # [rad/s or m/s]; slow but clear of stick, to separate dry from viscous friction
BEAM_ELEMENTS = 3200  # elements of all information matrices of a beam: 32 motions for two links, 1 for six
ACCELERATION_SHARES = (1.0, 0.7, 0.5, 0.35, 0.25)  # of the acceleration, tried in this order for enough torque
TORQUE_PROBLEM = "the motion needs more torque than the joints have: allow less speed or angle, or more torque"


def is_clear_of_stick(v: Array, a: Array) -> Mask:
    """Return whether a velocity v with acceleration a is clear of stick and reversals."""
    return np.abs(v) >= MIN_SPEED + REVERSAL_GUARD * np.abs(a)


def compute_parameter_scales(body: Body) -> Array:
    """Compute scales of base parameters, viscous and dry friction (P,) from the robot file.

    The scale of a first moment is the norm of the first moments of its link, and of an inertia that of the inertias. A
    link without values has the smallest scale of another link. A joint without friction has the smallest friction of
    another joint, or that of the paper.
    """
    groups = []  # kind, and link
    for quantity, _, joint in (name.partition("@") for name in body.names):
        alone = quantity in ("m", "rotor")
        groups.append(({"m": "mass", "rotor": "I"}[quantity] if alone else quantity[0], f"{quantity * alone}@{joint}"))
    norms = {group: float(np.linalg.norm(body.values[[other == group for other in groups]])) for group in groups}
    known = sorted((norm, kind) for (kind, _), norm in norms.items() if norm > 0)
    least = {kind: next((norm for norm, other in known if other == kind), 1.0) for kind, _ in groups}
    links = [norms[group] or least[group[0]] for group in groups]
    friction = np.array(get_friction(body)).T
    for values, default in zip(friction, (PAPER["viscous"], PAPER["coulomb"]), strict=True):
        values[values == 0] = min(values[values > 0], default=default)
    return np.concatenate([links, *friction])


def make_information_rows(body: Body, scales: Array, q: Array, v: Array, a: Array) -> Array:
    """Compute rows (N, n, P) of a motion for parameters relative to their `scales` (P,); zero near stick."""
    return make_torque_rows(body, q, v, a) * scales * is_clear_of_stick(v, a)[..., None]


class MotionBatch:
    """B motions of an arm up to a knot, and their information.

    Attributes:
        limits: limits of the joints, (B, n) each.
        speed: speed at the last knot (B, n) [rad/s or m/s].
        information: information on parameters relative to their scales, for unit noise of the mean torque of a tick
            (B, P, P).
        variances: squared standard errors of the relative parameters (B, P).
    """

    def __init__(self, body: Body, limits: Limits, batch: int) -> None:
        """Start at rest, with all joints clipped from zero to the limits (n,) or (B, n)."""
        self._body, self._scales = body, compute_parameter_scales(body)
        self.limits = Limits(*(np.broadcast_to(values, (batch, values.shape[-1])) for values in limits))
        self._previous_position = np.clip(0.0, self.limits.low, self.limits.high)  # at the last but one knot
        self._previous_speed, self.speed = np.zeros((2, *self._previous_position.shape))
        self.information = np.tile(INFORMATION_PRIOR * np.eye(len(self._scales)), (batch, 1, 1))
        self.variances = np.full((batch, len(self._scales)), 1 / INFORMATION_PRIOR)

    def select(self, which: Index) -> Self:
        """Return a batch with copies of motions of this batch; an index may occur several times."""
        copy = object.__new__(type(self))
        copy._body, copy._scales = self._body, self._scales
        copy.limits = Limits(*(values[which] for values in self.limits))
        for name in ("_previous_position", "_previous_speed", "speed", "information", "variances"):
            setattr(copy, name, getattr(self, name)[which])
        return copy

    @property
    def position(self) -> Array:
        """Return the positions at the last knot (B, n) [rad or m]."""
        return self._previous_position + 0.5 * KNOT_PERIOD * (self._previous_speed + self.speed)

    def advance(self, share: Array) -> None:
        """Advance to the next knot, with shares (B, n) in [-1, 1] of the largest speeds, within the limits.

        The information of the reference motion over the next period of knots is added.
        """
        position = self.position
        next_speed = limit_speeds(self._body, self.limits, position, self.speed, share)
        s = np.arange(TICK / 2, KNOT_PERIOD, TICK)[:, None]
        knots = (x[:, None] for x in (self._previous_position, self._previous_speed, self.speed, next_speed))
        path = average_motion(*knots, s)  # type: ignore[call-arg]  # (B, ticks, n) each
        q, v, a = (x.reshape(-1, x.shape[-1]) for x in path)
        rows = make_information_rows(self._body, self._scales, q, v, a).reshape(len(position), -1, len(self._scales))
        self.information = self.information + np.swapaxes(rows, 1, 2) @ rows
        self.variances = np.asarray(np.linalg.inv(self.information).diagonal(axis1=1, axis2=2))
        self._previous_position, self._previous_speed, self.speed = position, self.speed, next_speed

    @property
    def log_precision(self) -> Array:
        """Return minus the log of the RMS standard error (B,) [nat]."""
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
    """Design an informative motion within the limits of the joints by a beam search, knot by knot.

    At each knot, the joints are tried in random order at full and at crawl speed in both directions. The motions with
    the smallest standard errors are kept: 32 for two joints, one for six. At the end, the arm is brought to rest.

    Args:
        body: links with the limits of their file; without limits half a turn, or 0.2 m, to either side.
        seconds: duration of the motion before it is brought to rest [s].
        max_angle: bound of every angle to either side of zero [rad]; the limit of the file applies, too.
        max_speed: bound of every speed [rad/s], 4 rad/s or 0.5 m/s by default; the limit of the file applies, too.
        max_torque: bound of every torque [N m]; the limit of the file applies, too.
        max_acceleration: bound of every acceleration [rad/s^2]; by default the largest speed is reached in 0.2 s.
        rng: random generator of the orders.

    Raises:
        IdentificationError: if limits leave a joint no room, a bound is not positive, or every motion needs too much
            torque.
        BodyError: if a link has an impossible inertia.
    """
    body.refuse_impossible_links()
    if not KNOT_PERIOD <= seconds < np.inf:
        raise IdentificationError(f"a motion of {seconds:g} s is too short: give {KNOT_PERIOD:g} s or more")
    rng, limits = rng or np.random.default_rng(0), find_limits(body, max_angle, max_speed, max_torque, max_acceleration)
    for share in ACCELERATION_SHARES:
        motion = _search_motion(body, limits._replace(acceleration=share * limits.acceleration), seconds, rng)
        if not find_problem(motion, limits):
            return motion
    raise IdentificationError(f"{body.name}: {TORQUE_PROBLEM}")


def find_problem(motion: Reference, limits: Limits) -> str:
    """Return the problem of a motion: too much torque without friction, or a joint at rest; else an empty text.

    A motion that does not end at rest also needs too much torque.
    """
    q, v, a = motion(np.arange(0.0, motion.seconds, TICK))
    is_affordable = np.abs(motion.body.torque(q, v, a) @ motion.body.values) <= limits.torque
    if not is_affordable.all() or motion.speeds[-1].any():
        return TORQUE_PROBLEM
    idle = np.array(motion.body.joints)[~motion.speeds.any(axis=0)]
    return f"joint '{idle[0]}' never moves" if len(idle) else ""


def _search_motion(body: Body, limits: Limits, seconds: float, rng: np.random.Generator) -> Reference:
    """Search for the motion with the smallest standard errors, and bring it to rest.

    The beam has W motions. At each knot, four speeds of each joint are tried with each motion; the W best are kept.
    """
    motions = MotionBatch(body, limits, 1)
    start, speeds = motions.position[0], motions.speed[:, None]  # (W, knots, n) of W motions in the beam
    shares, width = np.zeros_like(motions.speed), max(1, BEAM_ELEMENTS // len(compute_parameter_scales(body)) ** 2)
    crawl = np.minimum(CRAWL_SPEED / limits.speed, 1.0)
    levels = np.array([-np.ones_like(crawl), -crawl, crawl, np.ones_like(crawl)])
    for _ in range(round(seconds / KNOT_PERIOD)):
        owners = np.arange(len(shares))
        for joint in rng.permutation(len(body.joints)):
            candidate_owners = np.repeat(owners, len(levels))
            candidate_shares = np.repeat(shares, len(levels), axis=0)
            candidate_shares[:, joint] = np.tile(levels[:, joint], len(shares))
            candidates = motions.select(candidate_owners)
            candidates.advance(candidate_shares)
            # motions with equal values are equal or mirror images
            best = np.unique(candidates.log_precision.round(9), return_index=True)[1][::-1][:width]
            shares, owners = candidate_shares[best], candidate_owners[best]
        motions = candidates.select(best)
        speeds = np.concatenate([speeds[owners], motions.speed[:, None]], axis=1)
    return stop_motion(body, motions.select(np.arange(1)), start, list(speeds[0][:, None]))


def stop_motion(body: Body, motions: MotionBatch, start: Array, speeds: list[Array]) -> Reference:
    """Bring a motion with speeds (1, n) at its knots to rest if the torque suffices; `motions` and `speeds` change."""
    n_before = len(speeds)
    limits = motions.limits
    # twice the time at half the acceleration
    max_knots = 10 + 4 * np.ceil(limits.speed / (KNOT_PERIOD * limits.acceleration)).max()
    while np.any(motions.speed) and len(speeds) < n_before + max_knots:
        motions.advance(np.zeros_like(motions.speed))
        speeds.append(motions.speed)
    return Reference(body, start, np.concatenate(speeds))
