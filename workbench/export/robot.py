"""The forms `urdf` and `sdf`: robot descriptions for ROS and for Gazebo, of an arm on a joint."""

from collections.abc import Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Model
from workbench.export.arm import Body, Friction, Stop, arm, holds_spring, value
from workbench.export.request import Exported, Request, commented, keep, title

JOINT = "joint"
UNBOUNDED = 1e9  # [N m], [rad/s]: a revolute joint of URDF has to tell both limits, and a model knows neither


def urdf(model: Model, request: Request) -> Exported:
    """For ROS and everything that reads its robot descriptions.

    Raises ExportError if the model has what a robot description does not, and may not be exported without it.
    """
    friction, stop = Friction.of(model, ("hard_stop",)), Stop.of(model)
    rigid = ("the elasticity of hard_stop: the limits are rigid",) if stop.is_there else ()
    body, notes = _body("urdf", model, (*friction.missing, *rigid), request)
    robot = Element("robot", name="pendulum")
    SubElement(robot, "link", name="base")
    add_link(robot, "arm", body.mass, body.centre, np.diag(body.moments))
    joint = SubElement(robot, "joint", name=JOINT, type="revolute" if stop.is_there else "continuous")
    SubElement(joint, "parent", link="base")
    SubElement(joint, "child", link="arm")
    SubElement(joint, "axis", xyz=numbers((1.0, 0.0, 0.0)))
    if stop.is_there:
        lower, upper = map(repr, stop.ends)
        SubElement(joint, "limit", lower=lower, upper=upper, effort=repr(UNBOUNDED), velocity=repr(UNBOUNDED))
    SubElement(joint, "dynamics", damping=repr(friction.viscous), friction=repr(friction.dry))
    return Exported(commented(xml(robot), (title(model), *notes)), notes)


def sdf(model: Model, request: Request) -> Exported:
    """For Gazebo; raises ExportError if the model has what the format does not, and may not be exported without it."""
    stiffness = value(model, "spring.stiffness")
    held = ("hard_stop", *(("spring",) if holds_spring(model) else ()))
    friction, stop = Friction.of(model, held), Stop.of(model)
    body, notes = _body("sdf", model, (*friction.missing, *stop.missing), request)
    root = Element("sdf", version="1.9")  # version of the format: read by Gazebo 11 and every later one
    drawn = SubElement(root, "model", name="pendulum")
    inertial = SubElement(SubElement(drawn, "link", name="arm"), "inertial")
    _write(inertial, pose=(*body.centre, 0.0, 0.0, 0.0), mass=body.mass)
    _write(SubElement(inertial, "inertia"), **_moments(np.diag(body.moments)))
    joint = SubElement(drawn, "joint", name=JOINT, type="revolute")
    SubElement(joint, "parent").text, SubElement(joint, "child").text = "world", "arm"
    axis = SubElement(joint, "axis")
    _write(axis, xyz=(1.0, 0.0, 0.0))
    dynamics = SubElement(axis, "dynamics")
    _write(dynamics, damping=friction.viscous, friction=friction.dry)
    if "spring" in held and stiffness > 0:
        _write(dynamics, spring_reference=-value(model, "spring.preload") / stiffness, spring_stiffness=stiffness)
    limit = SubElement(axis, "limit")
    _write(limit, lower=stop.lower, upper=stop.upper)
    if stop.is_there:
        _write(limit, stiffness=stop.stiffness, dissipation=stop.damping)
    return Exported(commented(xml(root), (title(model), *notes)), notes)


def add_link(robot: Element, name: str, mass: float, centre: Sequence[float], inertia: Array) -> None:
    """A link of URDF: mass [kg], its centre (3,) [m], and inertia (3, 3) about it [kg m^2]."""
    inertial = SubElement(SubElement(robot, "link", name=name), "inertial")
    SubElement(inertial, "origin", xyz=numbers(centre))
    SubElement(inertial, "mass", value=repr(float(mass)))
    SubElement(inertial, "inertia", {name: repr(value) for name, value in _moments(inertia).items()})


def numbers(values: Sequence[float] | Array) -> str:
    """Numbers in a row, so that they are read back as they are."""
    return " ".join(repr(float(x)) for x in values)


def xml(root: Element) -> str:
    """The text of a file."""
    indent(root)
    return '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n"


def _moments(inertia: Array) -> dict[str, float]:
    return {f"i{a}{b}": float(inertia["xyz".index(a), "xyz".index(b)]) for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")}


def _body(format: str, model: Model, missing: Sequence[str], request: Request) -> tuple[Body, tuple[str, ...]]:
    """The arm with what of it turns with a rotor, of which neither format knows, and what the format does not hold."""
    turns = ("an armature: it stays part of the arm's inertia",) if request.armature else ()
    return arm(model, replace(request, armature=0.0)), keep(format, (*missing, *turns), request)


def _write(parent: Element, **values: float | tuple[float, ...]) -> None:
    """Elements that hold numbers."""
    for name, given in values.items():
        SubElement(parent, name).text = numbers(given if isinstance(given, tuple) else (given,))
