"""Links of a robot file for the planar simulator."""

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.plant import PAPER
from pendulum_env.recording.study import GRAVITY
from pendulum_env.settings import format_setting
from robots.arms.body import Body, BodyError
from robots.arms.planar import Link
from robots.arms.robot import import_pinocchio

TOLERANCE = 1e-6  # relative tolerance of directions and lengths


def get_friction(body: Body, shares: Array | None = None) -> list[tuple[float, float]]:
    """Return viscous [N m s/rad] and dry [N m] friction per joint, from the file or `shares` (n,) of the paper's."""
    model, places = body.model, [body.links.index(joint) for joint in body.joints]
    default = np.outer(np.ones(len(places)) if shares is None else shares, [PAPER["viscous"], PAPER["coulomb"]])
    friction = [(float(model.damping[k]), float(model.upperDryFrictionLimit[k])) for k in places]
    return [pair if any(pair) else (b, fc) for pair, (b, fc) in zip(friction, default.tolist(), strict=True)]


def find_planar_links(body: Body) -> tuple[Link, ...]:
    """Return the links of a chain of parallel, horizontal revolute joints.

    Friction comes from the file (`<dynamics damping="..." friction="..."/>` of URDF), by default from the paper.

    Raises:
        BodyError: if the arm is another mechanism, or a link has an impossible inertia.
    """
    body.refuse_impossible_links()
    model, pin, count = body.model, import_pinocchio(), len(body.joints)
    if list(model.parents)[1:] != list(range(count)):  # also refuses mimic joints
        raise BodyError(
            f"{body.name}: branches, the simulator knows chains only: simulate it with "
            f"{format_setting('backend', 'mujoco')}"
        )
    gravity, data = np.array(model.gravity.linear), model.createData()
    jacobian = np.reshape(pin.computeJointJacobians(model, data, np.zeros(count)), (6, count))  # flat if n = 1
    axes = jacobian[3:].T  # (n, 3), world frame, all joints at zero
    up = -gravity / max(float(np.linalg.norm(gravity)), TOLERANCE)
    for joint, axis in zip(body.joints, axes, strict=True):
        if abs(axis @ up) > TOLERANCE or axis @ axes[0] < 1 - TOLERANCE:
            raise BodyError(
                f"{body.name}: joint '{joint}' does not turn in a vertical plane that all joints share, and the "
                f"simulator knows planar arms only: simulate it with {format_setting('backend', 'mujoco')}"
            )
    if abs(np.linalg.norm(gravity) - GRAVITY) > TOLERANCE * GRAVITY:
        raise BodyError(f"{body.name}: has another gravity than {GRAVITY:g} m/s^2, which the simulator has")
    if np.any(np.asarray(model.armature) > 0):
        raise BodyError(
            f"{body.name}: motors have inertia of their own, which the simulator does not know: "
            f"simulate it with {format_setting('backend', 'mujoco')}"
        )
    plane = np.stack([np.cross(up, axes[0]), up])  # right and up, (2, 3)
    places = list(data.oMi)[1:]
    solids = [place.act(link) for place, link in zip(places, list(model.inertias)[1:], strict=True)]
    joints = np.array([place.translation for place in places]) @ plane.T  # (n, 2)
    centers = np.array([solid.lever for solid in solids]) @ plane.T
    links = []
    for k, (solid, (viscous, coulomb)) in enumerate(zip(solids, get_friction(body), strict=True)):
        mass, inertia = float(solid.mass), float(axes[k] @ solid.inertia @ axes[k])
        to_center, is_last = centers[k] - joints[k], k + 1 == len(joints)
        line = to_center if is_last else joints[k + 1] - joints[k]
        length = float(np.linalg.norm(line))
        if length <= TOLERANCE * np.ptp(centers, axis=0).max():
            if not is_last:
                raise BodyError(f"{body.name}: joints '{body.joints[k]}' and '{body.joints[k + 1]}' are in one place")
            line, length = np.array([0.0, -1.0]), float(np.sqrt(inertia / mass))  # centre of mass on the axis
        along = line / length
        links.append(
            Link(
                mass=mass,
                length=length,
                center=float(to_center @ along),
                inertia=inertia,
                viscous=viscous,
                coulomb=coulomb,
                center_offset=float(along[0] * to_center[1] - along[1] * to_center[0]),
                angle=float(np.arctan2(along[0], -along[1])),
            )
        )
    return tuple(links)
