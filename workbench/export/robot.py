"""The forms `urdf` and `sdf`: robot descriptions for ROS and for Gazebo, of an arm on a joint."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from pendulum_env.physics import Model
from workbench.export.arm import Body, Friction, Stop, arm, value
from workbench.export.request import Exported, Request, commented, keep, needed, title

JOINT = "joint"
SDF = "1.9"  # version of the format: read by Gazebo 11 and every later one


def urdf(model: Model, request: Request) -> Exported:
    """For ROS and everything that reads its robot descriptions, written by ROS's own `urdf_parser_py`.

    Raises:
        ExportError: if the model has what a robot description does not, and may not be exported without it.
        InputError: if the extra `export` is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about its own age
        urdf = needed("urdf_parser_py.urdf")
    friction, stop = Friction.of(model, ("hard_stop",)), Stop.of(model)
    rigid = ("the elasticity of hard_stop: the limits are rigid",) if stop.is_there else ()
    body, notes = _body("urdf", model, (*friction.missing, *_armature(request), *rigid), request)
    about = dict(zip(("ixx", "iyy", "izz"), body.moments, strict=True))
    inertial = urdf.Inertial(
        mass=body.mass, inertia=urdf.Inertia(**about), origin=urdf.Pose(xyz=body.centre, rpy=(0.0, 0.0, 0.0))
    )
    lower, upper = stop.ends
    unbounded = 1e9  # [N m], [rad/s]: a revolute joint has to tell both, and the model knows neither
    joint = urdf.Joint(
        name=JOINT,
        parent="base",
        child="arm",
        joint_type="revolute" if stop.is_there else "continuous",
        axis=(1.0, 0.0, 0.0),
        origin=urdf.Pose(xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)),
        dynamics=urdf.JointDynamics(damping=friction.viscous, friction=friction.dry),
        limit=urdf.JointLimit(lower=lower, upper=upper, effort=unbounded, velocity=unbounded)
        if stop.is_there
        else None,
    )
    robot = urdf.Robot(name="pendulum")
    robot.add_link(urdf.Link(name="base"))
    robot.add_link(urdf.Link(name="arm", inertial=inertial))
    robot.add_joint(joint)
    return Exported(commented(robot.to_xml_string(), (title(model), *notes)), notes)


def sdf(model: Model, request: Request) -> Exported:
    """For Gazebo; its own library has no package for pip, so that the few elements are written here.

    Raises:
        ExportError: if the model has what the format does not, and may not be exported without it.
    """
    stiffness = value(model, "spring.stiffness")
    friction, stop = Friction.of(model, ("hard_stop", *(("spring",) if stiffness >= 0 else ()))), Stop.of(model)
    body, notes = _body("sdf", model, (*friction.missing, *_armature(request), *stop.missing), request)
    root = Element("sdf", version=SDF)
    drawn = SubElement(root, "model", name="pendulum")
    link = SubElement(drawn, "link", name="arm")
    inertial = SubElement(link, "inertial")
    _write(inertial, pose=(*body.centre, 0.0, 0.0, 0.0), mass=body.mass)
    moments = dict(zip(("ixx", "iyy", "izz"), body.moments, strict=True))
    _write(SubElement(inertial, "inertia"), **moments, ixy=0.0, ixz=0.0, iyz=0.0)
    joint = SubElement(drawn, "joint", name=JOINT, type="revolute")
    SubElement(joint, "parent").text, SubElement(joint, "child").text = "world", "arm"
    axis = SubElement(joint, "axis")
    _write(axis, xyz=(1.0, 0.0, 0.0))
    dynamics = SubElement(axis, "dynamics")
    _write(dynamics, damping=friction.viscous, friction=friction.dry)
    if stiffness > 0:
        _write(dynamics, spring_reference=-value(model, "spring.preload") / stiffness, spring_stiffness=stiffness)
    limit = SubElement(axis, "limit")
    _write(limit, lower=stop.lower, upper=stop.upper)
    if stop.is_there:
        _write(limit, stiffness=stop.stiffness, dissipation=stop.damping)
    indent(root)
    text = '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n"
    return Exported(commented(text, (title(model), *notes)), notes)


def _body(format: str, model: Model, missing: Sequence[str], request: Request) -> tuple[Body, tuple[str, ...]]:
    """The arm with what of it turns with a rotor, and what the format does not hold."""
    return arm(model, replace(request, armature=0.0)), keep(format, missing, request)


def _armature(request: Request) -> tuple[str, ...]:
    """What a format without rotors does with an armature, if there is one."""
    return ("an armature: it stays part of the arm's inertia",) if request.armature else ()


def _write(parent: Element, **values: float | tuple[float, ...]) -> None:
    """Elements that hold numbers, so that they are read back as they are."""
    for name, given in values.items():
        SubElement(parent, name).text = " ".join(map(repr, given)) if isinstance(given, tuple) else repr(given)
