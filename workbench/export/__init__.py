"""A model in the forms that simulators and programs read; each form is a module of its name.

`python` and `c` hold the simulator's own step, whatever the effects. `mjcf`, `urdf` and `sdf` describe a body
on a joint, `isaaclab` and `mjlab` the actuator of one, and name what of a model they cannot hold.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

from pendulum_env.lookup import find
from pendulum_env.physics import Model
from workbench.export.request import Exported, ExportError, Request
from workbench.export.servo import in_units_of

FORMATS: dict[str, tuple[str, str]] = {  # ending of a file's name, and what it is
    "mjcf": (".xml", "a model for MuJoCo"),
    "urdf": (".urdf", "a robot description for ROS"),
    "sdf": (".sdf", "a model for Gazebo"),
    "python": (".py", "a module without dependencies"),
    "c": (".c", "a file of C99"),
    "isaaclab": (".py", "an actuator of Isaac Lab"),
    "mjlab": (".py", "an actuator of mjlab"),
}
BODIES = ("mjcf", "urdf", "sdf")  # rigid ones, on a joint
READABLE = ("mjcf", "urdf")  # by MuJoCo
ACTUATORS = ("isaaclab", "mjlab")  # of servos


def export(model: Model, format: str, request: Request | None = None) -> Exported:
    """A model in a format of `FORMATS`.

    Raises:
        ValueError: if the format is unknown.
        ExportError: if the format cannot hold the model, and approximations are not allowed, or a drive is in another
            unit than the model.
        InputError: if a library of the extra `export` is not installed.
    """
    find("format", format, FORMATS)
    request = request or Request()
    if request.drive is not None:
        request = replace(request, drive=in_units_of(model, request.drive))
    exported: Exported = import_module(f"workbench.export.{format}").export(model, request)
    return exported


__all__ = ["ACTUATORS", "BODIES", "FORMATS", "READABLE", "ExportError", "Exported", "Request", "export"]
