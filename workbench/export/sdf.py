"""The form `sdf`: for Gazebo. Its own library has no package for pip, so that the few elements are written here."""

from __future__ import annotations

import math
from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from pendulum_env.physics import Model
from workbench.export.arm import Friction, Stop, arm, no_armature, value
from workbench.export.heading import commented, title
from workbench.export.request import Exported, Request, keep

VERSION = "1.9"  # of the format: read by Gazebo 11 and every later one


def export(model: Model, request: Request) -> Exported:
    """The XML of a model: an arm on a joint to the world.

    Raises:
        ExportError: if the model has what the format does not, and may not be exported without it.
    """
    stiffness = value(model, "spring.stiffness")
    friction, stop = Friction.of(model, ("hard_stop", *(("spring",) if stiffness >= 0 else ()))), Stop.of(model)
    notes = keep("sdf", (*friction.missing, *no_armature(request), *(() if stop is None else stop.missing)), request)
    body = arm(model, replace(request, armature=0.0))
    root = Element("sdf", version=VERSION)
    drawn = SubElement(root, "model", name="pendulum")
    link = SubElement(drawn, "link", name="arm")
    inertial = SubElement(link, "inertial")
    _write(inertial, pose=(*body.centre, 0.0, 0.0, 0.0), mass=body.mass)
    moments = dict(zip(("ixx", "iyy", "izz"), body.moments, strict=True))
    _write(SubElement(inertial, "inertia"), **moments, ixy=0.0, ixz=0.0, iyz=0.0)
    joint = SubElement(drawn, "joint", name="joint", type="revolute")
    SubElement(joint, "parent").text, SubElement(joint, "child").text = "world", "arm"
    axis = SubElement(joint, "axis")
    _write(axis, xyz=(1.0, 0.0, 0.0))
    dynamics = SubElement(axis, "dynamics")
    _write(dynamics, damping=friction.viscous, friction=friction.dry)
    if stiffness > 0:
        _write(dynamics, spring_reference=-value(model, "spring.preload") / stiffness, spring_stiffness=stiffness)
    limit = SubElement(axis, "limit")
    ends = (-math.inf, math.inf) if stop is None else (stop.lower, stop.upper)
    _write(limit, lower=ends[0], upper=ends[1])
    if stop is not None:
        _write(limit, stiffness=stop.stiffness, dissipation=stop.damping)
    indent(root)
    text = '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n"
    return Exported(commented(text, (title(model), *notes)), notes)


def _write(parent: Element, **values: float | tuple[float, ...]) -> None:
    """Elements that hold numbers, so that they are read back as they are."""
    for name, given in values.items():
        SubElement(parent, name).text = " ".join(map(repr, given)) if isinstance(given, tuple) else repr(given)
