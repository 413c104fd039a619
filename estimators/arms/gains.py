"""Gains of an arm's motors: currents become torques by a known weight, or by what other joints feel of the same links.

Each joint has its own row of the balance, in which all of the arm is per unit of its current; a known weight adds a
torque of known size, whose coefficient is one over the gain:

    i = Y (theta / K) + f / K + (Y of the weight) / K

Joints in N m tell base parameters theta of the links beyond them, and so a part of the torque of joints in currents,
whose coefficient is one over the gain, too. Where every joint is in a current, and no weight is known, all is per unit
of the current of one of them: `A@shoulder`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
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
from pendulum_env.recording.record import NEWTON_METRE, RecordingError, TorqueConstant
from pendulum_env.recording.study import Carried
from pendulum_env.words import listing, per, plus_minus

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

    @property
    def unit(self) -> str:
        """Of the torques: `N m`, or `A@shoulder`, the current of that joint."""
        return self.recordings[0].torque_unit if self.recordings else NEWTON_METRE

    def texts(self, body: Body) -> list[str]:
        """Each gain in a sentence, with what tells it, and what its error means."""
        current, _, reference = self.unit.partition("@")
        said = [
            f"nothing tells torques in N m: all are in {self.unit}, the torque of one {current} at {reference}; give "
            "its gain, or record with a known load, too"
        ] * bool(reference) + [
            f"torque gain of {joint}: {plus_minus(gain.value, gain.std)} "
            f"{per(body.worded(joint, gain.unit), self.unit)}, as "
            + ("known loads tell it" if gain.loads else "the other joints tell it, which feel the same links")
            for joint, gain in self.gains.items()
        ]
        notable = 0.01  # standard error of a gain, as a share, that is told again
        vague = [f"{joint} ({_share(gain):.1%})" for joint, gain in self.gains.items() if _share(gain) > notable]
        if vague:
            said.append(
                f"standard errors of parameters leave out those of the gains of {listing(vague)}: record longer, or "
                "with a heavier weight"
            )
        return said


def in_torque(recordings: Sequence[ArmRecording], body: Body, unit: str | None = None) -> Torques:
    """Turn currents into torques, as far as known weights, and then joints in N m, tell the gains.

    Where no torque is in N m, all become multiples of the current of one joint.

    Args:
        recordings: some perhaps with a known weight (`carried`).
        body: the links.
        unit: of the torques, `N m` or `A@shoulder`, where a model has it; None: `N m` where anything tells it.

    Raises:
        RecordingError: if the currents of a joint are in two units, or count against the weight, or against what joints
            in N m, or else the file, have of the same links, or if no gains fit those, or a known weight does not show.
    """
    asked = _units(recordings)
    if not asked:
        return Torques(tuple(recordings), {})
    gains: dict[str, TorqueConstant] = {}
    if len({recording.carried for recording in recordings}) > 1:
        gains = _by_weight(recordings, body, asked)
    # gains by a known weight with more than three times the least standard error may be told better by other joints
    clear = 3.0 * min(map(_share, gains.values()), default=0.0)
    anchors = {joint: gain for joint, gain in gains.items() if _share(gain) <= clear}
    if not anchors and len({recording.carried for recording in recordings}) > 1 and not _in_torque(recordings):
        raise RecordingError("the known weight shows in no joint's current: check its mass and center, or lift it more")
    rows = None
    if not anchors and unit is None and not body.sliding and not _in_torque(recordings):
        rows = _rows(recordings, body)
        unit = _most_telling(rows, body, asked)
    if not anchors and unit is not None:
        recordings = _per_current(recordings, unit)
        asked = _units(recordings)
    converted = [_converted(recording, anchors) for recording in recordings]
    left = {joint: unit for joint, unit in asked.items() if joint not in anchors}
    if not left:
        return Torques(tuple(converted), gains)
    vague = max(map(_share, anchors.values()), default=0.0)  # of what other joints build on
    bare = _bare(converted)
    try:
        told = _by_other_joints(bare, _rows(bare, body) if rows is None else rows, body, left)
    except RecordingError:
        if left.keys() - gains.keys():
            raise
        told = {}  # all have a gain by the weight, which asks nothing of the arm's model
    for joint, own in told.items():
        own = replace(own, std=float(np.hypot(own.std, vague * own.value)))
        if joint not in gains or _share(own) < _share(gains[joint]):
            gains[joint] = own
    return Torques(tuple(_converted(recording, gains) for recording in recordings), gains)


def _share(gain: TorqueConstant) -> float:
    return gain.std / gain.value


def _bare(recordings: Sequence[ArmRecording]) -> list[ArmRecording]:
    """Recordings of the arm with what it carries least."""
    masses = [one.carried.mass if one.carried else 0.0 for one in recordings]
    return [one for one, mass in zip(recordings, masses, strict=True) if mass <= min(masses)]


def _most_telling(rows: Stack, body: Body, asked: dict[str, str]) -> str:
    """Unit in which all torques are told where none is in N m: the current of the joint that by the file feels most.

    Raises:
        RecordingError: if that current has the other sign.
    """
    links, friction = np.split(rows.equations.phi, [len(body.base)], axis=1)
    felt = links @ body.values
    reference = body.joints[int(np.argmax(np.bincount(rows.joint, felt**2)))]
    own = rows.usable & (rows.joint == body.joints.index(reference))
    value, std = _beside(friction[own], felt[own], rows.equations.y[own], rows.clusters[own])
    if value < -SURE * std:
        raise RecordingError(
            f"the current of joint '{reference}' counts against the weight and inertia of its links: say -COLUMN for "
            "it, and for all others that do"
        )
    return f"{asked[reference]}@{reference}"


def _per_current(recordings: Sequence[ArmRecording], unit: str) -> list[ArmRecording]:
    """Recordings whose torques are to be in a unit such as `A@shoulder`, as they are where that joint is in another."""
    current, _, reference = unit.partition("@")
    return [
        replace(one, torque_unit=unit, currents={at: of for at, of in one.currents.items() if at != reference})
        if one.currents.get(reference) == current
        else one
        for one in recordings
    ]


def _in_torque(recordings: Sequence[ArmRecording]) -> bool:
    """Whether a joint is in N m in any of some recordings."""
    return any(one.currents.keys() != {*one.names} for one in recordings)


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
    recordings: Sequence[ArmRecording], rows: Stack, body: Body, asked: dict[str, str]
) -> dict[str, TorqueConstant]:
    """Gains with which all joints feel the same links, of currents that anything tells of.

    Base parameters, friction and gains are fitted together. For given gains all others are linear and projected out
    (Golub and Pereyra, SIAM Journal on Numerical Analysis 10(2), 1973).

    Raises:
        RecordingError: if a current has the other sign, or no gains fit.
    """
    currents = np.array([[joint in asked and joint in one.currents for joint in body.joints] for one in recordings])
    index = np.array([[*asked].index(joint) if joint in asked else -1 for joint in body.joints])
    of = np.where(currents[rows.recording, rows.joint], index[rows.joint], -1)[rows.usable]  # gain of a row, -1: N m
    if not (of < 0).any() or not (of >= 0).any():
        return {}
    joint, clusters = rows.joint[rows.usable], rows.clusters[rows.usable]
    phi, y = (own[rows.usable] for own in (rows.equations.phi, rows.equations.y))
    noise = _noise(phi, y, of * len(body.joints) + joint)

    def projected(inverses: Array, rows: Array, of: Array) -> tuple[Array, Array, Array]:
        """Residual, regressor and what the arm needs in N m, of rows (R, P + 1) of regressor and torque."""
        per = np.append(inverses, 1.0)[of][:, None]  # the last one is that of rows in N m
        theta = np.linalg.lstsq(rows[:, :-1] * per, rows[:, -1], rcond=None)[0]
        needed = rows[:, :-1] @ theta
        return rows[:, -1] - per[:, 0] * needed, rows[:, :-1] * per, needed

    whole = np.column_stack([phi, y]) / noise[:, None]
    parts = [np.linalg.qr(whole[of == k], mode="r") for k in range(-1, len(asked))]  # tell as much in fewer rows
    of_short, short = np.repeat(range(-1, len(asked)), [len(part) for part in parts]), np.concatenate(parts)
    start = 1.0 / _linear(phi, y, noise, of, len(asked))
    fit = least_squares(lambda x: projected(x, short, of_short)[0], start, x_scale=np.abs(start))
    residual, linear, needed = projected(fit.x, whole, of)
    felt = np.array([np.where(of == k, needed, 0.0) for k in range(len(asked))])  # slopes of the residual
    beside = [np.column_stack([linear, *np.delete(felt, k, axis=0)]) for k in range(len(asked))]
    std = [_beside(beside[k], felt[k], residual, clusters)[1] for k in range(len(asked))]
    # times each joint's own noise: beyond, joints do not feel the same links, as with rotors left out
    if (misfit := float(np.sqrt(np.mean(residual**2)))) > 1.5:
        raise RecordingError(
            f"no gains let all joints feel the same links ({misfit:.1f} times the noise): say --rotors if motors have "
            f"inertia of their own, or give the gain of each of {listing([*asked])}"
        )
    sure = {name: (x, e) for name, x, e in zip(asked, fit.x.tolist(), std, strict=True) if abs(x) > SURE * e}
    if turned := [name for name, (x, _) in sure.items() if x < 0]:
        every = len(turned) == len(sure)
        raise RecordingError(
            f"currents of {listing(turned)} count against what the joints in N m feel of the same links: say -COLUMN "
            f"for {'them, or for the joints in N m' if every else 'them'}"
        )
    return {name: TorqueConstant(1 / x, e / x**2, asked[name]) for name, (x, e) in sure.items()}


def _noise(phi: Array, y: Array, group: NDArray[Any]) -> Array:
    """What each group of rows leaves when it is fitted alone, root mean square of a row's group (R,)."""
    noise = np.ones(len(y))
    for one in np.unique(group):
        own = group == one
        left = y[own] - phi[own] @ np.linalg.lstsq(phi[own], y[own], rcond=None)[0]
        least = 1e-3 * float(np.std(y[own]))  # below it nothing is taken for noise: simulations have hardly any
        noise[own] = max(float(np.std(left)), least, 1e-9)
    return noise


def _linear(phi: Array, y: Array, noise: Array, of: Array, count: int) -> Array:
    """Gains by which currents y (R,) are torques phi theta, a linear problem whose noise depends on them, in passes."""
    sizes = [float(np.sqrt(np.mean((y[of == k]) ** 2))) if (of == k).any() else 1.0 for k in range(-1, count)]
    alike = gains = sizes[0] / np.maximum(np.array(sizes[1:]), 1e-12)  # of torques as large as those in N m
    for _ in range(3):  # the search for gains starts from here
        weights = 1.0 / (noise * np.append(np.abs(gains), 1.0)[of])
        columns = np.column_stack([np.where(of == k, -y, 0.0) for k in range(count)])
        known = np.where(of < 0, y, 0.0)
        left = np.column_stack([phi, columns]) * weights[:, None]
        size = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
        found = (np.linalg.lstsq(left / size, known * weights, rcond=None)[0] / size)[-count:]
        gains = np.where(np.abs(found) > 1e-6 * alike, found, alike)  # which nothing tells
    return gains


def without_loads(
    fitted: Sequence[ArmRecording], held_out: Sequence[ArmRecording] = ()
) -> tuple[list[ArmRecording], list[ArmRecording]]:
    """Recordings of the arm with what it carries least, which is part of it: known loads are not.

    Raises:
        IdentificationError: if none is left of those to fit, or of those to hold out.
    """
    bare = {id(one) for one in _bare([*fitted, *held_out])}
    left, checks = ([one for one in part if id(one) in bare] for part in (fitted, held_out))
    for what, part, those in (("fitted", fitted, left), ("held-out", held_out, checks)):
        if part and not those:
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


def _beside(phi: Array, x: Array, y: Array, clusters: NDArray[Any]) -> tuple[float, float]:
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
