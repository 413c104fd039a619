"""Payloads of an arm: the body at a link in some recordings, relative to others or to a model.

A payload is fixed to a link. Its ten standard parameters have the columns Y K, with Y the columns of the base
parameters and K the link's columns of `Body.combine`. The base parameters of the arm come from a model or from
recordings without the payload. Friction is fitted separately for each payload, as it changes with temperature. The rows
are those of the windows of torque.
Source: Khosla and Kanade, IEEE Conference on Decision and Control, 1985; Gaz and De Luca, IROS 2017.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from estimators.regression.least_squares import (
    Equations,
    Fit,
    IdentificationError,
    compute_joint_rms,
    project_out,
    solve,
    solve_least_squares,
    weigh_joints,
)
from estimators.weak_form.links import prepare_arm
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import JSON, Array, Index
from pendulum_env.lookup import find
from pendulum_env.physics import Estimate, Model, Term
from pendulum_env.physics.mechanism import LinkLoad
from pendulum_env.recording import Recording
from robots.arms.body import STANDARD, Body, find_body
from robots.arms.standard import find_nearest_link, make_pseudo_inertia

MAX_HIDDEN_SHARE = 1e-6  # largest share of a determined parameter in directions that no motion of the joints shows
MIN_Z_SCORE = 5.0  # least mass or first moment of a significant payload [standard errors]
MAX_SHARE = 0.5  # largest residual torque with a significant payload, relative to that without it
MIN_MASS_GAP = 0.25  # least difference of the masses of two payloads, relative to the range of all masses


@dataclass(frozen=True)
class Payload:
    """A body that an arm carries.

    Attributes:
        joint: joint in front of the link that carries it; all parameters are in its frame.
        estimates: mass, first moments and moments of inertia about the joint's origin of the nearest possible body, by
            their names in URDF's frame (`m`, `mx` ... `Izz`); only parameters that the motion determines.
        center: centre of mass [m] by axis x, y and z; only axes with a determined first moment.
        exists: whether a body has the parameters of the free fit, within two standard errors; None if some are
            undetermined.
        torque_rms: RMS residual torque of each joint without and with the payload [N m].
        load: the parameters at the link; undetermined parameters have the least norm.
    """

    joint: str
    estimates: Mapping[str, Estimate]
    center: Mapping[str, Estimate]
    exists: bool | None
    torque_rms: Mapping[str, tuple[float, float]]
    load: LinkLoad

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of parameters that no motion of the joints determines."""
        return tuple(name for name in STANDARD if name not in self.estimates)

    @property
    def is_significant(self) -> bool:
        """Return whether the mass or a first moment is significant, and the payload halves the residual of two joints.

        The motion may determine the first moments better than the mass.
        """
        mass = self.estimates.get("m")
        weights = [self.estimates[name] for name in STANDARD[:4] if name in self.estimates]
        is_significant = any(abs(weight.value) > MIN_Z_SCORE * weight.std for weight in weights)
        n_improved = sum(after < MAX_SHARE * before for before, after in self.torque_rms.values())
        return mass is not None and mass.value > 0 and is_significant and n_improved >= 2

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        return {
            "schema": "pendulum-ident/payload@1",
            "joint": self.joint,
            "theta": {name: estimate.json() for name, estimate in self.estimates.items()},
            "center": [estimate.json() for estimate in self.center.values()] if len(self.center) == 3 else None,
            "hidden": list(self.hidden),
            "exists": self.exists,
            "torque_rms": {name: {"without": a, "with": b} for name, (a, b) in self.torque_rms.items()},
        }


def find_payload(
    model: Model, carrying: Sequence[Recording], without: Sequence[Recording] = (), joint: str | None = None
) -> Payload:
    """Identify the body that an arm carries in some recordings.

    Args:
        model: model of the arm without it. Its friction is refitted. Recordings `without` the payload refit its other
            parameters, too; without these, the payload's standard errors do not include theirs.
        carrying: recordings with the payload.
        without: recordings without it.
        joint: joint in front of the link that carries it, by default the last joint.

    Raises:
        IdentificationError: if the recordings have too little motion.
        ValueError: if the joint is unknown.
    """
    joints = find_body(model.terms).joints
    joint = find("joint", joint or joints[-1], {name: name for name in joints})
    parts = [prepare_arm(recordings, model.terms) for recordings in (without, carrying) if recordings]
    group = [0] * len(without) + [1] * len(carrying)
    return PayloadRows.from_parts(parts, model.terms, joint).fit(group, None if without else model)[0][0]


def detect_payloads(parts: Sequence[TorqueWindows], terms: Sequence[Term]) -> list[tuple[Payload, tuple[int, ...]]]:
    """Identify the payloads that an arm carries at its last link in some of its recordings.

    Each recording is first fitted with a separate payload, relative to the first recording. Sorted masses are split
    into groups at differences above `MIN_MASS_GAP`. The group without payload is the lightest, or the heaviest if
    masses are uncertain. Both groupings are fitted with possible bodies. The grouping with a significant payload and
    the lower residual is chosen.

    Returns:
        The significant payloads, with the numbers of the recordings of each; none if the motion does not determine the
        mass.
    """
    count = sum(len({w.run for w in part.windows}) for part in parts)
    rows = PayloadRows.from_parts(parts, terms, find_body(terms).joints[-1])
    if count < 2 or "m" not in rows.determined_names:
        return []
    mass = np.append(0.0, rows.estimate_masses(count))
    order = np.argsort(mass)
    groups = np.append(0, np.cumsum(np.diff(mass[order]) > MIN_MASS_GAP * np.ptp(mass)))
    group_of_recording = np.empty((2, count), dtype=np.intp)
    group_of_recording[:, order] = groups, groups[-1] - groups
    fits = [(rows.fit(grouping.tolist()), grouping) for grouping in group_of_recording]
    candidates = []
    for (payloads, residual), grouping in fits:
        carried = [
            (payload, tuple(np.flatnonzero(grouping == k + 1).tolist()))
            for k, payload in enumerate(payloads)
            if payload.is_significant
        ]
        candidates.append((not carried, round(residual, 6), carried))  # rounding differs; a possible body first
    return min(candidates, key=lambda candidate: candidate[:2])[2]


class PayloadRows(NamedTuple):
    """Rows of recordings of an arm (R,), for payloads at one of its links.

    Attributes:
        body: links of the arm.
        joint: joint in front of the link.
        equations: equations of the model's parameters.
        friction_columns: indices of the columns of friction (P,).
        row_joint: number of the joint in each row (R,).
        recording: number of the recording in each row (R,).
        clusters: block of time of each row (R,).
    """

    body: Body
    joint: str
    equations: Equations
    friction_columns: Index
    row_joint: Index
    recording: Index
    clusters: Index

    @classmethod
    def from_parts(cls, parts: Sequence[TorqueWindows], terms: Sequence[Term], joint: str) -> PayloadRows:
        """Join the rows of parts, linearised at their fit; numbers of recordings and clusters continue over parts."""
        phi, y, row_joint, recording, clusters = [], [], [], [], []
        body, n_recordings, n_clusters = find_body(terms), 0, 0
        for data in parts:
            tangent = TorqueRows(data).equations(terms).linearise()
            phi.append(tangent.slopes)
            y.append(tangent.target)
            runs = np.array([w.run for w in data.windows], dtype=np.intp)
            joints = np.array([body.joints.index(w.at) for w in data.windows], dtype=np.intp)
            recording.append(n_recordings + runs[data.recording_of_window])
            row_joint.append(joints[data.recording_of_window])
            clusters.append(n_clusters + data.clusters)
            n_recordings, n_clusters = n_recordings + int(runs.max()) + 1, n_clusters + int(data.clusters.max()) + 1
        is_friction = np.repeat([term.kind == "dissipative" for term in terms], [len(term.columns) for term in terms])
        equations = Equations(np.concatenate(phi), np.concatenate(y))
        indices = (np.concatenate(series) for series in (row_joint, recording, clusters))
        return cls(body, joint, equations, np.flatnonzero(is_friction), *indices)

    @property
    def basis(self) -> Array:
        """Orthonormal basis (10, S) of the parameters of a link that the motion of the joints determines."""
        unseen = scipy.linalg.null_space(self.body.link_columns(self.joint), rcond=MAX_HIDDEN_SHARE)
        return np.asarray(scipy.linalg.null_space(unseen.T) if unseen.size else np.eye(len(STANDARD)))

    @property
    def determined_names(self) -> tuple[str, ...]:
        """Names of the parameters of a link that the motion of the joints determines."""
        length = np.linalg.norm(self.basis, axis=1)
        return tuple(name for name, norm in zip(STANDARD, length, strict=True) if 1 - norm < MAX_HIDDEN_SHARE)

    def _build_columns(self, group: Sequence[int], model: Model | None) -> tuple[Array, list[Array], Array]:
        """Return the columns of the arm, those of the payload of each group from 1, and the torque (R,).

        Friction has columns for each group. With a model of the empty arm, its torque is subtracted, and the arm has
        only columns for the friction of groups from 1.
        """
        group_of_row, phi, y = np.asarray(group)[self.recording], self.equations.phi, self.equations.y
        count = len(self.body.base)
        link = phi[:, :count] @ (self.body.link_columns(self.joint) @ self.basis)
        shared = np.setdiff1d(np.arange(phi.shape[1]), self.friction_columns)
        friction = [phi[:, self.friction_columns] * (group_of_row == k)[:, None] for k in range(max(group) + 1)]
        if model is None:
            known = [phi[:, shared], *friction]
        else:
            known, y = friction[1:], y - phi[:, shared] @ model.theta[shared]
        return np.column_stack(known), [link * (group_of_row == k)[:, None] for k in range(1, max(group) + 1)], y

    def estimate_masses(self, count: int) -> Array:
        """Estimate the masses of all recordings except the first, relative to the first (count - 1,) [kg]."""
        known, carried, y = self._build_columns(range(count), None)
        phi = np.column_stack([known, *carried])
        w = weigh_joints(Equations(phi, y), self.row_joint)
        theta = solve_least_squares(phi * w[:, None], y * w)[known.shape[1] :]
        return np.asarray(theta.reshape(count - 1, -1) @ self.basis[STANDARD.index("m")])

    def fit(self, group: Sequence[int], model: Model | None = None) -> tuple[list[Payload], float]:
        """Fit the payload of each group of recordings from 1, relative to group 0.

        Without a model of the empty arm, its parameters are fitted, too.

        Returns:
            The payloads, and the RMS residual torque relative to that of each joint in a fit of any parameters.
        """
        known, carried, y = self._build_columns(group, model)
        if not all(columns.any() for columns in carried):
            raise IdentificationError("too little motion clear of reversals to tell a payload: record longer")
        clusters = np.unique(self.clusters, return_inverse=True)[1]
        designs = known, np.column_stack([known, *carried])
        weights = [weigh_joints(Equations(phi, y), self.row_joint) for phi in designs]
        pairs = zip(designs, weights, strict=True)
        without_payload, free = (solve(Equations(phi, y), w, clusters) for phi, w in pairs)
        width, payloads, remaining_y = self.basis.shape[1], [], y
        values = free.theta[known.shape[1] :].reshape(len(carried), width)
        for k, columns in enumerate(carried):
            if width == len(STANDARD):  # replace the free fit by the best possible body
                other_columns = np.column_stack([known, *carried[:k], *carried[k + 1 :]]) * weights[1][:, None]
                own_columns = project_out(np.linalg.qr(other_columns)[0], columns * weights[1][:, None])
                values[k] = self.basis.T @ find_nearest_link(self.basis @ values[k], own_columns @ self.basis.T)
            remaining_y = remaining_y - columns @ values[k]
        fit = free
        if not np.array_equal(values.ravel(), free.theta[known.shape[1] :]):
            fit = solve(Equations(known, remaining_y), weights[1], clusters)
        for k in range(len(carried)):
            place = slice(known.shape[1] + k * width, known.shape[1] + (k + 1) * width)
            covariance = self.basis @ free.covariance[place, place] @ self.basis.T
            row_joint = np.where(np.asarray(group)[self.recording] == k + 1, self.row_joint, -1)
            torque_rms = _compute_torque_rms(self.body.joints, row_joint, without_payload, fit)
            payloads.append(
                self._make_payload(self.basis @ values[k], self.basis @ free.theta[place], covariance, torque_rms)
            )
        return payloads, float(np.sqrt(np.mean((fit.residual * weights[1]) ** 2)))

    def _make_payload(
        self, physical: Array, free: Array, covariance: Array, torque_rms: Mapping[str, tuple[float, float]]
    ) -> Payload:
        """Build the payload from its parameters (10,), in `STANDARD` order.

        `physical` is the nearest possible body if all are determined, else the free fit. `free` and `covariance` (10,
        10) belong to the free fit. `torque_rms` maps joints to RMS residual torque without and with the payload [N m].
        """
        std, units = np.sqrt(np.diag(covariance)), (self.body.get_unit(f"{name}@{self.joint}") for name in STANDARD)
        named_estimates = zip(STANDARD, map(Estimate, physical.tolist(), std.tolist(), units), strict=True)
        estimates = {name: estimate for name, estimate in named_estimates if name in self.determined_names}
        center = _compute_center(physical, covariance)
        center = {axis: estimate for axis, estimate in center.items() if {"m", f"m{axis}"} <= estimates.keys()}
        exists = _is_possible(free, covariance) if len(estimates) == len(STANDARD) else None
        return Payload(self.joint, estimates, center, exists, torque_rms, LinkLoad(self.joint, physical))


def _compute_torque_rms(
    joints: Sequence[str], row_joint: Index, before: Fit, after: Fit
) -> dict[str, tuple[float, float]]:
    """Return the RMS residual torque of two fits by joint [N m]; joints without rows are left out.

    `row_joint` is the joint of each row (R,), -1 for excluded rows.
    """
    own = row_joint >= 0
    old, new = (compute_joint_rms(fit.residual[own], row_joint[own]).tolist() for fit in (before, after))
    return {joints[n]: (old[n], new[n]) for n in np.unique(row_joint[own]).tolist()}


def _compute_center(values: Array, covariance: Array) -> dict[str, Estimate]:
    """Compute the centre of mass by axis from parameters (10,) and their covariance, with first-order standard errors.

    The result is empty if the mass is below two standard errors.
    """
    mass, center = values[0], dict[str, Estimate]()
    if mass <= 2 * np.sqrt(covariance[0, 0]):
        return center
    for n, axis in enumerate("xyz", 1):
        slope = np.array([-values[n] / mass**2, 1 / mass])
        variance = max(0.0, slope @ covariance[np.ix_([0, n], [0, n])] @ slope)  # below 0 by rounding
        center[axis] = Estimate(float(values[n] / mass), float(np.sqrt(variance)), "m")
    return center


def _is_possible(values: Array, covariance: Array) -> bool:
    """Return whether a body may have the parameters (10,): its pseudo-inertia is positive.

    The least eigenvalue may be negative by two standard errors.
    Source: Wensing, Kim and Slotine, IEEE Robotics and Automation Letters 3(1), 2018.
    """
    eigenvalues, vectors = np.linalg.eigh(make_pseudo_inertia(values))
    least = vectors[:, 0]
    slope = np.array([least @ make_pseudo_inertia(unit) @ least for unit in np.eye(len(values))])
    return bool(eigenvalues[0] + 2 * np.sqrt(slope @ covariance @ slope) > 0)
