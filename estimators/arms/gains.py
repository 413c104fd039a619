"""Gains of an arm's motors: currents become torques by a known weight, or by what other joints feel of the same links.

Each joint has its own row of the balance, in which all of the arm is per unit of its current; a known weight adds a
torque of known size, whose coefficient is one over the gain:

    i = Y (theta / K) + f / K + (Y of the weight) / K

Joints in N m tell base parameters theta of the links beyond them, and so a part of the torque of joints in currents,
whose coefficient is one over the gain, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from estimators.regression.equations import IdentificationError
from estimators.schemes.balance import ARM_SCHEMES
from estimators.schemes.fitting import Stack, regressions, stack
from estimators.signals.measurements import measure_joints
from pendulum_env._typing import Array
from pendulum_env.arms.body import STANDARD, Body
from pendulum_env.arms.joints import arm_base
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.arms.robot import pinocchio
from pendulum_env.recording.record import RecordingError, TorqueConstant
from pendulum_env.recording.study import Carried

SCHEME = next(scheme for scheme in ARM_SCHEMES if scheme.id == "filtered_dynamic")
SURE = 10.0  # standard errors of a gain, from which it is known


@dataclass(frozen=True, eq=False)
class Torques:
    """Recordings of an arm in N m, and the gains by which currents became torques.

    Attributes:
        recordings: in the order given; joints whose gain is not known are still in currents.
        gains: by joint.
    """

    recordings: tuple[ArmRecording, ...]
    gains: dict[str, TorqueConstant]


def in_torque(recordings: Sequence[ArmRecording], body: Body) -> Torques:
    """Turn currents into torques, joint by joint, as far as known weights tell the gains.

    Args:
        recordings: some with a known weight (`carried`), some with another or none.
        body: the links.

    Raises:
        RecordingError: if the currents of a joint are in two units, or count against the weight.
    """
    asked = _units(recordings)
    if not asked:
        return Torques(tuple(recordings), {})
    gains: dict[str, TorqueConstant] = {}
    if len({recording.carried for recording in recordings}) > 1:
        gains = _by_weight(recordings, body, asked)
    converted = tuple(_converted(recording, gains) for recording in recordings)
    least = min((one.carried for one in converted), key=lambda own: own.mass if own else 0.0)
    alike = [one for one in converted if one.carried == least]
    others = {joint: unit for joint, unit in asked.items() if joint not in gains}
    if others and len(others) < len(body.joints):
        gains |= (told := _by_other_joints(alike, body, others))
        converted = tuple(_converted(recording, told) for recording in converted)
    return Torques(converted, gains)


def _rows(recordings: Sequence[ArmRecording], body: Body) -> Stack:
    return stack([measure_joints(one.joints) for one in recordings], partial(regressions(arm_base(body)), SCHEME))


def _by_weight(recordings: Sequence[ArmRecording], body: Body, asked: dict[str, str]) -> dict[str, TorqueConstant]:
    """Gains by known weights; raises RecordingError if a current counts against one."""
    rows = _rows(recordings, body)
    gains: dict[str, TorqueConstant] = {}
    carried = [body.combine @ _standard(recording.carried, body) for recording in recordings]  # (P,) each
    weighs = np.einsum("rp,rp->r", rows.equations.phi[:, : len(body.base)], np.array(carried)[rows.recording])
    for joint, unit in asked.items():
        alike = np.array([joint in recording.currents for recording in recordings])  # others are in N m
        weights = {recording.carried for recording in recordings if joint in recording.currents}
        own = rows.usable & (rows.joint == body.joints.index(joint)) & alike[rows.recording]
        value, std = _beside(rows.equations.phi[own], weighs[own], rows.equations.y[own], rows.clusters[own])
        if len(weights) > 1 and value < -SURE * std:
            raise RecordingError(
                f"the known weight acts on joint '{joint}' with the other sign than the current: say -COLUMN for its "
                "torque, or check the center of the weight"
            )
        if len(weights) > 1 and value > SURE * std:
            gains[joint] = TorqueConstant(1 / value, std / value**2, unit, len(weights))
    return gains


def _by_other_joints(
    recordings: Sequence[ArmRecording], body: Body, asked: dict[str, str]
) -> dict[str, TorqueConstant]:
    """Gains with which all joints feel the same links; raises RecordingError if a current has the other sign.

    Base parameters, friction and gains are fitted together; for given gains, all others are linear.
    """
    rows, inertial = _rows(recordings, body), len(body.base)
    currents = np.array([[joint in recording.currents for joint in body.joints] for recording in recordings])
    index = np.full(len(body.joints), -1)
    index[[body.joints.index(joint) for joint in asked]] = np.arange(len(asked))
    of = np.where(currents[rows.recording, rows.joint], index[rows.joint], -1)[rows.usable]  # gain of a row, -1: N m
    joint, clusters = rows.joint[rows.usable], rows.clusters[rows.usable]
    phi, y = (own[rows.usable] for own in (rows.equations.phi, rows.equations.y))
    by_file, start = phi[:, :inertial] @ body.values, np.zeros(len(asked))
    for k in range(len(asked)):
        start[k] = _beside(phi[of == k][:, inertial:], by_file[of == k], y[of == k], clusters[of == k])[0]
    for k, j in sorted(set(zip(of.tolist(), joint.tolist(), strict=True))):
        own = (of == k) & (joint == j)
        noise = max(float(np.std(y[own] - phi[own] @ np.linalg.lstsq(phi[own], y[own], rcond=None)[0])), 1e-9)
        phi[own], y[own] = phi[own] / noise, y[own] / noise

    def residual(inverses: Array, phi: Array, y: Array, of: Array) -> Array:
        left = phi * np.append(inverses, 1.0)[of][:, None]  # the last one is that of rows in N m
        return np.asarray(y - left @ np.linalg.lstsq(left, y, rcond=None)[0])

    parts = [np.linalg.qr(np.column_stack([phi, y])[of == k], mode="r") for k in range(-1, len(asked))]  # as good
    short = np.concatenate(parts)
    of_short = np.repeat(np.arange(-1, len(asked)), [len(part) for part in parts])
    scale = np.maximum(np.abs(start), 1e-9)
    fit = least_squares(residual, start, x_scale=scale, args=(short[:, :-1], short[:, -1], of_short))
    fit = least_squares(residual, fit.x, x_scale=scale, args=(phi, y, of), max_nfev=1)
    scores = np.zeros((clusters.max() + 1, len(asked)))
    np.add.at(scores, clusters, fit.jac * fit.fun[:, None])
    std = np.linalg.norm(scores @ np.linalg.pinv(fit.jac.T @ fit.jac, hermitian=True), axis=0)
    gains: dict[str, TorqueConstant] = {}
    for (name, unit), value, error in zip(asked.items(), fit.x.tolist(), std.tolist(), strict=True):
        if value < -SURE * error:
            raise RecordingError(
                f"the current of joint '{name}' counts against what other joints feel of its links: say -COLUMN for it"
            )
        if value > SURE * error:
            gains[name] = TorqueConstant(1 / value, error / value**2, unit)
    return gains


def without_loads(
    fitted: Sequence[ArmRecording], held_out: Sequence[ArmRecording] = ()
) -> tuple[list[ArmRecording], list[ArmRecording]]:
    """Recordings of the arm with what it carries least, which is part of it: known loads are not.

    Raises:
        IdentificationError: if none is left of those to fit, or of those to hold out.
    """
    masses = {id(one): one.carried.mass if one.carried else 0.0 for one in (*fitted, *held_out)}
    least = min(masses.values(), default=0.0)
    left, checks = ([one for one in part if masses[id(one)] <= least] for part in (fitted, held_out))
    for what, part, bare in (("fitted", fitted, left), ("held-out", held_out, checks)):
        if part and not bare:
            raise IdentificationError(
                f"every {what} recording has a known load, which is no part of the arm: add one of the arm without it"
            )
    return left, checks


def _units(recordings: Sequence[ArmRecording]) -> dict[str, str]:
    """Units of currents by joint; raises RecordingError as `in_torque`."""
    first: dict[str, tuple[str, str]] = {}
    for recording in recordings:
        for joint, unit in recording.currents.items():
            name, other = first.setdefault(joint, (recording.name, unit))
            if unit != other:
                raise RecordingError(
                    f"{recording.name}: torque of joint '{joint}' is in {unit}, and in {other} in {name}: read both in "
                    "one unit"
                )
    return {joint: unit for joint, (_, unit) in first.items()}


def _standard(carried: Carried | None, body: Body) -> Array:
    """Standard parameters (S,) of a weight that is small, in the frame of the last joint."""
    found, first = np.zeros(len(body.standard)), len(STANDARD) * body.links.index(body.joints[-1])
    if carried is not None:
        weight = pinocchio().Inertia(carried.mass, np.array(carried.center), np.zeros((3, 3)))
        found[first : first + len(STANDARD)] = weight.toDynamicParameters()
    return found


def _beside(phi: Array, x: Array, y: Array, clusters: Array) -> tuple[float, float]:
    """Coefficient of x (R,) beside columns phi (R, P), and its standard error by clusters."""
    left, rest = (own - phi @ np.linalg.lstsq(phi, own, rcond=None)[0] for own in (x, y))
    size = float(left @ left)
    if size <= 1e-12 * max(float(x @ x), 1e-300):
        return 0.0, np.inf
    value = float(left @ rest) / size
    scores = np.bincount(np.unique(clusters, return_inverse=True)[1], left * (rest - value * left))
    return value, float(np.sqrt(np.sum(scores**2))) / size


def _converted(recording: ArmRecording, gains: dict[str, TorqueConstant]) -> ArmRecording:
    known = recording.currents.keys() & gains.keys()
    factors = [gains[joint].value if joint in known else 1.0 for joint in recording.names]
    left = {joint: unit for joint, unit in recording.currents.items() if joint not in known}
    return replace(recording, torque=recording.torque * np.array(factors), currents=left)
