"""Payloads of an arm: the body at a link that some recordings show beside others, or beside a model.

The ten standard parameters of a body that is fixed to a link have ten columns, which combine those of the base
parameters: Y_link = Y K, with K the link's columns of `Body.combine`. In one recording they are part of the base
parameters. Where these are known, or the same in other recordings, the rest is the payload's. Friction is fitted anew
where another payload is carried, as it changes with temperature. The rows are those of the windows of torque.
Source: Khosla and Kanade, IEEE Conference on Decision and Control, 1985; Gaz and De Luca, IROS 2017.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from estimators.arms.standard import nearest_link, pseudo_inertia
from estimators.regression.least_squares import (
    Equations,
    Fit,
    IdentificationError,
    project_out,
    solve,
    solve_least_squares,
    weigh_joints,
)
from estimators.weak_form.links import prepare_arm
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import JSON, Array, Index
from pendulum_env.arms.body import STANDARD, Body, LinkLoad
from pendulum_env.arms.joints import find_links
from pendulum_env.lookup import find
from pendulum_env.physics import Estimate, Model, Term
from pendulum_env.recording import Recording

HIDDEN = 1e-6  # share of a direction that no motion of the joints shows, from which a parameter is unknown
SURE, SHARE = 5.0, 0.5  # standard errors of a mass, and share of the torque left, from which a payload stands out
GAP = 0.25  # share of the range of masses, from which two recordings carry different payloads


@dataclass(frozen=True)
class Payload:
    """A body that an arm carries.

    Attributes:
        joint: in front of the link that carries it, in whose frame everything is told.
        estimates: its mass, first moments and moments of inertia about the joint's origin, by their names in URDF's
            frame (`m`, `mx` ... `Izz`), those that the motion of the joints shows; of the nearest body that exists.
        center: of mass [m], by those of the axes x, y and z along which mass and first moment are shown.
        exists: whether some body has the parameters of the free fit, within two standard errors; None if not all are
            shown.
        left: torque that remains of each joint [N m], without the payload and with it.
        load: the same parameters at the link; those that are not shown have the least norm.
    """

    joint: str
    estimates: Mapping[str, Estimate]
    center: Mapping[str, Estimate]
    exists: bool | None
    left: Mapping[str, tuple[float, float]]
    load: LinkLoad

    @property
    def hidden(self) -> tuple[str, ...]:
        """Parameters that no motion of the joints shows."""
        return tuple(name for name in STANDARD if name not in self.estimates)

    @property
    def stands_out(self) -> bool:
        """Return whether the payload is significant: it has mass, and explains most of the residual of two joints."""
        mass = self.estimates.get("m")
        helped = sum(after < SHARE * before for before, after in self.left.values())
        return mass is not None and mass.value > SURE * mass.std and helped >= 2

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {
            "schema": "pendulum-ident/payload@1",
            "joint": self.joint,
            "theta": {name: one.json() for name, one in self.estimates.items()},
            "center": [one.json() for one in self.center.values()] if len(self.center) == 3 else None,
            "hidden": list(self.hidden),
            "exists": self.exists,
            "torque_rms": {name: {"without": a, "with": b} for name, (a, b) in self.left.items()},
        }


def find_payload(
    model: Model,
    carrying: Sequence[Recording],
    without: Sequence[Recording] = (),
    joint: str | None = None,
) -> Payload:
    """Identify the body that an arm carries in some recordings.

    Args:
        model: of the arm without it. Its friction is fitted anew. Its other parameters are, too, if there are
            recordings without the payload, and taken as they are otherwise: the standard errors then count the noise of
            the recordings that carry alone.
        carrying: recordings with the payload.
        without: recordings without it.
        joint: in front of the link that carries it, the last one by default.

    Raises:
        IdentificationError: if there is too little motion.
        ValueError: if there is no such joint.
    """
    joints = find_links(model.terms).joints
    joint = find("joint", joint or joints[-1], {name: name for name in joints})
    parts = [prepare_arm(own, model.terms) for own in (without, carrying) if own]
    group = [0] * len(without) + [1] * len(carrying)
    return PayloadRows.from_parts(parts, model.terms, joint).fit(group, None if without else model)[0]


def find_carried(
    parts: Sequence[TorqueWindows], terms: Sequence[Term], joint: str | None = None
) -> list[tuple[Payload, tuple[int, ...]]]:
    """Identify what an arm carries in some of its recordings and not in others.

    Each recording is first fitted with a payload of its own. Recordings with masses of about one size then share one.
    Those with the least are without a payload.
    Returns the payloads that stand out, with the numbers of the recordings that carry each.
    """
    count = sum(len({w.run for w in own.windows}) for own in parts)
    rows = PayloadRows.from_parts(parts, terms, joint or find_links(terms).joints[-1])
    if count < 2 or "m" not in rows.shown:
        return []
    mass = np.append(0.0, rows.masses(count))
    order = np.argsort(mass)
    steps = np.append(0, np.cumsum(np.diff(mass[order]) > GAP * np.ptp(mass)))
    group = np.empty(count, dtype=np.intp)
    group[order] = steps
    found = rows.fit(group.tolist())
    return [
        (payload, tuple(np.flatnonzero(group == k + 1).tolist()))
        for k, payload in enumerate(found)
        if payload.stands_out
    ]


class PayloadRows(NamedTuple):
    """Rows of recordings of an arm (R,), for payloads at one of its links.

    Attributes:
        body: of the arm.
        joint: in front of the link.
        terms: of the model.
        equations: of the model's parameters.
        of_friction: columns of friction (P,).
        number: of the joint in each row (R,).
        recording: number of the recording in each row (R,).
        clusters: block of time of each row (R,).
    """

    body: Body
    joint: str
    terms: Sequence[Term]
    equations: Equations
    of_friction: Index
    number: Index
    recording: Index
    clusters: Index

    @classmethod
    def from_parts(cls, parts: Sequence[TorqueWindows], terms: Sequence[Term], joint: str) -> PayloadRows:
        """Join the rows of several parts."""
        phi, y, number, recording, clusters = [], [], [], [], []
        body, first, cluster = find_links(terms), 0, 0
        for data in parts:
            near = TorqueRows(data).equations(terms).tangent()
            phi.append(near.slopes)
            y.append(near.error + near.slopes @ near.theta)
            runs = np.array([w.run for w in data.windows], dtype=np.intp)
            at = np.array([body.joints.index(w.at) for w in data.windows], dtype=np.intp)
            recording.append(first + runs[data.recording_of_window])
            number.append(at[data.recording_of_window])
            clusters.append(cluster + data.clusters)
            first, cluster = first + int(runs.max()) + 1, cluster + int(data.clusters.max()) + 1
        owner = np.repeat([term.kind == "dissipative" for term in terms], [len(term.columns) for term in terms])
        equations = Equations(np.concatenate(phi), np.concatenate(y))
        rest = (np.concatenate(own) for own in (number, recording, clusters))
        return cls(body, joint, terms, equations, np.flatnonzero(owner), *rest)

    @property
    def basis(self) -> Array:
        """Orthonormal basis (10, S) of the parameters of a link that the motion of the joints shows."""
        unseen = scipy.linalg.null_space(self.body.link_columns(self.joint), rcond=HIDDEN)
        return np.asarray(scipy.linalg.null_space(unseen.T) if unseen.size else np.eye(len(STANDARD)))

    @property
    def shown(self) -> tuple[str, ...]:
        """Parameters of a link that the motion of the joints shows."""
        length = np.linalg.norm(self.basis, axis=1)
        return tuple(name for name, own in zip(STANDARD, length, strict=True) if 1 - own < HIDDEN)

    def _columns(self, group: Sequence[int], model: Model | None) -> tuple[Array, list[Array], Array]:
        """Return the columns of the arm, those of the payload of each group from 1, and the torque of both (R,)."""
        own, phi, y = np.asarray(group)[self.recording], self.equations.phi, self.equations.y
        count = len(self.body.base)
        link = phi[:, :count] @ (self.body.link_columns(self.joint) @ self.basis)
        shared = np.setdiff1d(np.arange(phi.shape[1]), self.of_friction)
        friction = [phi[:, self.of_friction] * (own == k)[:, None] for k in range(max(group) + 1)]
        if model is None:
            known = [phi[:, shared], *friction]
        else:
            known, y = friction[1:], y - phi[:, shared] @ model.theta[shared]
        return np.column_stack(known), [link * (own == k)[:, None] for k in range(1, max(group) + 1)], y

    def masses(self, count: int) -> Array:
        """Return the mass of each recording but the first, in excess of its mass (count - 1,) [kg]."""
        known, carried, y = self._columns(range(count), None)
        phi = np.column_stack([known, *carried])
        w = weigh_joints(Equations(phi, y), self.number)
        theta = solve_least_squares(phi * w[:, None], y * w)[known.shape[1] :]
        return np.asarray(theta.reshape(count - 1, -1) @ self.basis[STANDARD.index("m")])

    def fit(self, group: Sequence[int], model: Model | None = None) -> list[Payload]:
        """Fit the payload of each group of recordings from 1, beside those of group 0.

        Without a model of the empty arm, its parameters are fitted, too.
        """
        known, carried, y = self._columns(group, model)
        if not all(own.any() for own in carried):
            raise IdentificationError("too little motion clear of reversals to tell a payload: record longer")
        clusters = np.unique(self.clusters, return_inverse=True)[1]
        w = [weigh_joints(Equations(phi, y), self.number) for phi in (known, np.column_stack([known, *carried]))]
        empty = solve(Equations(known, y), w[0], clusters)
        free = solve(Equations(np.column_stack([known, *carried]), y), w[1], clusters)
        width, found, possible = self.basis.shape[1], [], y
        values = free.theta[known.shape[1] :].reshape(len(carried), width)
        for k, columns in enumerate(carried):
            if width == len(STANDARD):  # the best fit of all bodies that exist
                others = np.column_stack([known, *carried[:k], *carried[k + 1 :]]) * w[1][:, None]
                own = project_out(np.linalg.qr(others)[0], columns * w[1][:, None])
                values[k] = self.basis.T @ nearest_link(self.basis @ values[k], own @ self.basis.T)
            possible = possible - columns @ values[k]
        fit = free
        if not np.array_equal(values.ravel(), free.theta[known.shape[1] :]):
            fit = solve(Equations(known, possible), w[1], clusters)
        for k in range(len(carried)):
            here = slice(known.shape[1] + k * width, known.shape[1] + (k + 1) * width)
            covariance = self.basis @ free.covariance[here, here] @ self.basis.T
            own = np.asarray(group)[self.recording] == k + 1
            left = _errors(self.body.joints, np.where(own, self.number, -1), empty, fit)
            found.append(self._payload(self.basis @ values[k], self.basis @ free.theta[here], covariance, left))
        return found

    def _payload(
        self, values: Array, free: Array, covariance: Array, left: Mapping[str, tuple[float, float]]
    ) -> Payload:
        std, units = np.sqrt(np.diag(covariance)), (self.body.get_unit(f"{name}@{self.joint}") for name in STANDARD)
        each = zip(STANDARD, map(Estimate, values.tolist(), std.tolist(), units), strict=True)
        estimates = {name: estimate for name, estimate in each if name in self.shown}
        center = _center(values, covariance)
        center = {axis: own for axis, own in center.items() if {"m", f"m{axis}"} <= estimates.keys()}
        exists = _exists(free, covariance) if len(estimates) == len(STANDARD) else None
        return Payload(self.joint, estimates, center, exists, left, LinkLoad(self.joint, values))


def _errors(joints: Sequence[str], number: Index, before: Fit, after: Fit) -> dict[str, tuple[float, float]]:
    """Return the residual torque of two fits at each joint with rows, by its number in each fit (R,), -1 for none."""
    rows = {name: number == n for n, name in enumerate(joints)}
    return {
        name: (float(np.sqrt(np.mean(before.residual[own] ** 2))), float(np.sqrt(np.mean(after.residual[own] ** 2))))
        for name, own in rows.items()
        if own.any()
    }


def _center(values: Array, covariance: Array) -> dict[str, Estimate]:
    """Compute the centre of mass from mass and first moments, with first-order standard errors; empty without mass."""
    mass, found = values[0], dict[str, Estimate]()
    if mass <= 2 * np.sqrt(covariance[0, 0]):
        return found
    for n, axis in enumerate("xyz", 1):
        slope = np.array([-values[n] / mass**2, 1 / mass])
        variance = slope @ covariance[np.ix_([0, n], [0, n])] @ slope
        found[axis] = Estimate(float(values[n] / mass), float(np.sqrt(variance)), "m")
    return found


def _exists(values: Array, covariance: Array) -> bool:
    """Return whether the pseudo-inertia is positive, within two standard errors of its least eigenvalue.

    Source: Wensing, Kim and Slotine, IEEE Robotics and Automation Letters 3(1), 2018.
    """
    eigenvalues, vectors = np.linalg.eigh(pseudo_inertia(values))
    least = vectors[:, 0]
    slope = np.array([least @ pseudo_inertia(unit) @ least for unit in np.eye(len(values))])
    return bool(eigenvalues[0] + 2 * np.sqrt(slope @ covariance @ slope) > 0)
