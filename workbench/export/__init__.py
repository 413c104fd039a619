"""A model in the forms that simulators and programs read.

`python` and `c` hold the simulator's own step, whatever the effects. `mjcf`, `urdf` and `sdf` describe a body
on a joint, `isaaclab` and `mjlab` the actuator of one, and name what of a model they cannot hold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pendulum_env.lookup import find
from pendulum_env.physics import Model
from workbench.export import actuator, mjcf, program, robot
from workbench.export.request import Exported, ExportError, Request
from workbench.export.servo import in_units_of

FORMATS: dict[str, tuple[str, Callable[[Model, Request], Exported]]] = {  # what each is, and what writes it
    "mjcf": ("a model for MuJoCo", mjcf.export),
    "urdf": ("a robot description for ROS", robot.urdf),
    "sdf": ("a model for Gazebo", robot.sdf),
    "python": ("a module without dependencies", program.python),
    "c": ("a file of C99", program.c),
    "isaaclab": ("an actuator of Isaac Lab", actuator.isaaclab),
    "mjlab": ("an actuator of mjlab", actuator.mjlab),
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
    _, write = find("format", format, FORMATS)
    request = request or Request()
    if request.drive is not None:
        request = replace(request, drive=in_units_of(model, request.drive))
    return write(model, request)


__all__ = ["ACTUATORS", "BODIES", "FORMATS", "READABLE", "ExportError", "Exported", "Request", "export"]
