"""Gains of an arm's motors: currents become torques where the arm carried a known weight in some recordings.

Each joint has its own row of the balance, in which all of the arm is per unit of its current; a known weight adds a
torque of known size, whose coefficient is one over the gain:

    i = Y (theta / K) + f / K + (Y of the weight) / K
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from estimators.regression.equations import IdentificationError
from estimators.schemes.balance import ARM_SCHEMES
from estimators.schemes.fitting import regressions, stack
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
    if not asked or len({recording.carried for recording in recordings}) < 2:
        return Torques(tuple(recordings), {})
    segments = [measure_joints(recording.joints) for recording in recordings]
    data = stack(segments, partial(regressions(arm_base(body)), SCHEME))
    of = data.recording
    carried = [body.combine @ _standard(recording.carried, body) for recording in recordings]  # (P,) each
    weighs = np.einsum("rp,rp->r", data.equations.phi[:, : len(body.base)], np.array(carried)[of])
    gains = {}
    for joint, unit in asked.items():
        alike = np.array([joint in recording.currents for recording in recordings])  # others are in N m
        weights = {recording.carried for recording in recordings if joint in recording.currents}
        own = data.usable & (data.joint == body.joints.index(joint)) & alike[of]
        value, std = _beside(data.equations.phi[own], weighs[own], data.equations.y[own], data.clusters[own])
        if len(weights) > 1 and value < -SURE * std:
            raise RecordingError(
                f"the known weight acts on joint '{joint}' with the other sign than the current: say -COLUMN for its "
                "torque, or check the center of the weight"
            )
        if len(weights) > 1 and value > SURE * std:
            gains[joint] = TorqueConstant(1 / value, std / value**2, unit, len(weights))
    return Torques(tuple(_converted(recording, gains) for recording in recordings), gains)


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
