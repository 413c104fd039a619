"""The form `urdf`: for ROS and everything that reads its robot descriptions, written by ROS's own `urdf_parser_py`."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

from pendulum_env.physics import Model
from workbench.export.arm import FAR, Friction, Stop, arm, no_armature
from workbench.export.extra import needed
from workbench.export.heading import commented, title
from workbench.export.request import Exported, Request, keep

JOINT = "joint"


def export(model: Model, request: Request) -> Exported:
    """The XML of a model: a base, an arm and the joint between them.

    Raises:
        ExportError: if the model has what a robot description does not, and may not be exported without it.
        InputError: if the extra `export` is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about its own age
        urdf = needed("urdf_parser_py.urdf")
    friction, stop = Friction.of(model, ("hard_stop",)), Stop.of(model)
    rigid = () if stop is None else ("the elasticity of hard_stop: the limits are rigid",)
    notes = keep("urdf", (*friction.missing, *no_armature(request), *rigid), request)
    body = arm(model, replace(request, armature=0.0))
    about = dict(zip(("ixx", "iyy", "izz"), body.moments, strict=True))
    inertial = urdf.Inertial(
        mass=body.mass, inertia=urdf.Inertia(**about), origin=urdf.Pose(xyz=body.centre, rpy=(0.0, 0.0, 0.0))
    )
    limited = stop is not None and any(math.isfinite(end) for end in (stop.lower, stop.upper))
    lower, upper = (-FAR, FAR) if stop is None else stop.ends
    unbounded = 1e9  # [N m], [rad/s]: a revolute joint has to tell both, and the model knows neither
    joint = urdf.Joint(
        name=JOINT,
        parent="base",
        child="arm",
        joint_type="revolute" if limited else "continuous",
        axis=(1.0, 0.0, 0.0),
        origin=urdf.Pose(xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)),
        dynamics=urdf.JointDynamics(damping=friction.viscous, friction=friction.dry),
        limit=urdf.JointLimit(lower=lower, upper=upper, effort=unbounded, velocity=unbounded) if limited else None,
    )
    robot = urdf.Robot(name="pendulum")
    robot.add_link(urdf.Link(name="base"))
    robot.add_link(urdf.Link(name="arm", inertial=inertial))
    robot.add_joint(joint)
    return Exported(commented(robot.to_xml_string(), (title(model), *notes)), notes)
