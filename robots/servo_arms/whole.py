"""Common links of an arm of servos: each joint has fitted its own copy of their parameters.

At joint i, the base parameters p of the links act as r_i + S_i p: r_i is the inertia of the rotor, S_i the shares of
`LinkTable`. The common links have the least squared distance from the parameters of all joints, in standard errors, and
are possible bodies near the robot file. In the unit of a drive without a gain, the file's masses give the scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.export.request import ExportError, Request
from pendulum_env.physics import Model
from pendulum_env.physics.terms import set_nonlinear_values
from pendulum_env.recording.actuator import name_joint_errors, parse_actuator
from pendulum_env.recording.channel import NEWTON_METRE
from pendulum_env.units import is_of_torque
from robots.arms.body import Body, find_body
from robots.arms.standard import fit_possible_links
from robots.servo_arms.links import LinkTorque, find_table, list_link_columns, list_names
from robots.servo_arms.model import ServoArmModel
from robots.servos.drive import ServoDrive

POSTURES = 500  # random ones, for typical loads
LEAST_ERROR = 0.02  # least standard error of a parameter of the links, relative to the largest of its unit at the joint


@dataclass(frozen=True)
class WholeArm:
    """Arm of servos with common links.

    Attributes:
        body: links with rotors.
        standard: standard parameters of the links (S,).
        joints: terms at each joint without those of the links and the rotor.
        drives: drive of each joint.
        scale: torque in N m per unit of the drives, by the masses of the robot file; None if the drives have N m.
    """

    body: Body
    standard: Array
    joints: Mapping[str, Model]
    drives: Mapping[str, ServoDrive]
    scale: float | None


def join_links(model: ServoArmModel, request: Request) -> WholeArm:
    """Find the common links of the joints.

    Raises:
        ExportError: if the model has no drive, or is of an earlier version.
    """
    body, drives = replace(find_body(model.terms), rotors=True), find_drives(model, request)
    fixed = replace(body, rotors=False)
    pairs = {at: _select_links(servo, at) for at, servo in model.servos.items()}
    scale = None if model.torque_unit == NEWTON_METRE else _find_scale(fixed, model.servos)
    columns, target = [], []
    for k, (values, covariance, shares) in enumerate(pairs.values()):
        root = np.linalg.cholesky(np.linalg.inv(covariance)).T
        rotors = np.zeros((len(values), len(body.joints)))
        rotors[0, k] = 1.0
        columns.append(root @ np.hstack([shares @ fixed.combine, rotors]) / (scale or 1.0))
        target.append(root @ values)
    standard = fit_possible_links(body, np.vstack(columns), np.concatenate(target))
    joints = {at: scale_torque(_drop_links(servo), scale or 1.0) for at, servo in model.servos.items()}
    if scale is not None:
        drives = {at: drive.with_gain(scale, model.torque_unit) for at, drive in drives.items()}
    return WholeArm(body, standard, joints, drives, scale)


def find_typical_loads(arm: WholeArm) -> dict[str, float]:
    """Find the mean size of gravity at each joint over random postures within the joint limits [N m]."""
    gravity = _draw_gravity(arm.body) @ (arm.body.combine @ arm.standard)
    return dict(zip(arm.body.joints, np.abs(gravity).mean(axis=0).tolist(), strict=True))


def _draw_gravity(body: Body) -> Array:
    """Return the regressors of gravity (M, n, P) in random postures within the joint limits."""
    model, joints = body.model, len(body.joints)
    low, high = (np.asarray(end)[:joints] for end in (model.lowerPositionLimit, model.upperPositionLimit))
    low, high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    postures = np.random.default_rng(0).uniform(low, high, (POSTURES, joints))
    rest = np.zeros_like(postures)
    return body.torque(postures, rest, rest)


def find_drives(model: ServoArmModel, request: Request) -> dict[str, ServoDrive]:
    """Find the drive of each joint: of the request, or with which the model was fitted."""
    given, drives = request.drive or parse_actuator(model.log_format.get("drive", {})), dict[str, ServoDrive]()
    for at, servo in model.servos.items():
        with name_joint_errors(at):
            drive = given and given.select_joint(at).complete_conventions({**model.log_format, **servo.log_format})
        if not isinstance(drive, ServoDrive):
            raise ExportError("the model has no drive of its servos: give --drive, as for its recordings")
        drives[at] = drive
    return drives


def scale_torque(model: Model, factor: float) -> Model:
    """Return the model in N m, of one in a unit of `factor` N m."""
    units = {column.name: column.unit for column in model.columns}
    units |= {term.get_full_name(p.name): p.unit for term in model.terms for p in term.nonlinear_parameters}

    def scale(name: str) -> float:
        return factor if is_of_torque(units.get(name, "")) else 1.0

    estimates = {
        name: replace(one, value=one.value * scale(name), std=one.std * scale(name))
        for name, one in model.estimates.items()
    }
    values = {name: estimates[name].value for name in estimates if scale(name) != 1.0}
    model = replace(model, terms=set_nonlinear_values(model.terms, values), estimates=estimates)
    return model.convert_units(replace(model.units(), torque_unit=NEWTON_METRE))


def _select_links(servo: Model, at: str) -> tuple[Array, Array, Array]:
    """Return inertia and parameters of the links at a joint (K + 1,), their covariance, and the shares of `LinkTable`.

    Raises:
        ExportError: if the model file has no shares.
    """
    table = find_table(servo.terms)
    if table is not None and not table.shares.size:
        raise ExportError(f"{at}: the model is of an earlier version: identify it again")
    names = ["inertia", *(f"{LinkTorque.id}.{name}" for name in (table.names if table else ()))]
    place = [list(servo.estimates).index(name) for name in names]
    values = np.array([servo.estimates[name].value for name in names])
    units = np.array([servo.estimates[name].unit for name in names])
    largest = np.array([np.abs(values[units == unit]).max() for unit in units])
    covariance = servo.assumed_covariance[np.ix_(place, place)] + np.diag((LEAST_ERROR * largest) ** 2)
    shares = table.shares if table else np.zeros((1, 0))
    return values, covariance, shares


def _find_scale(body: Body, servos: Mapping[str, Model]) -> float:
    """Return the torque in N m per unit of the drives with which gravity has the size that the file's masses give.

    Sizes are RMS values over random postures, which wrong zeros of joints change little.
    """
    gravity, names = _draw_gravity(body), list_names(body.names)
    known, fitted = np.sum((gravity @ body.values) ** 2), 0.0
    for k, servo in enumerate(servos.values()):
        chosen = list_link_columns(servo.terms)
        values = np.array([servo.estimates[f"{LinkTorque.id}.{name}"].value for name in chosen])
        fitted += np.sum((gravity[:, k, [names.index(name) for name in chosen]] @ values) ** 2)
    return float(np.sqrt(known / fitted)) if known > 0 and fitted > 0 else 1.0


def _drop_links(servo: Model) -> Model:
    """Return the model of a servo without links and rotor."""
    terms = tuple(term for term in servo.terms if not isinstance(term, LinkTorque) and term.id != "inertia")
    names = {name for term in terms for name in term.parameter_names}
    estimates = {name: one for name, one in servo.estimates.items() if name in names}
    return replace(servo, terms=terms, estimates=estimates, correlation=())
