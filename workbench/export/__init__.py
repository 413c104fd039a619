"""A model in the forms that simulators and programs read.

`python` and `c` hold the simulator's own step, whatever the effects. `mjcf`, `urdf` and `sdf` describe a body
on a joint, `isaaclab` and `mjlab` the actuator of one, and name what of a model they cannot hold.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from pendulum_env.arms.model import ArmModel
from pendulum_env.lookup import find
from pendulum_env.physics import Model
from pendulum_env.words import listing
from workbench.export import mjcf, program, robot, servo
from workbench.export.request import Exported, ExportError, Request
from workbench.mistakes import InputError


class Format(NamedTuple):
    """A form of a model: what it is, what writes it, and the options of the command line that it takes."""

    what: str
    write: Callable[[Model, Request], Exported]
    options: tuple[str, ...]


FORMATS = {
    "mjcf": Format("a model for MuJoCo", mjcf.export, ("mass", "armature", "drive", "callback", "check")),
    "urdf": Format("a robot description for ROS", robot.urdf, ("mass", "armature", "check")),
    "sdf": Format("a model for Gazebo", robot.sdf, ("mass", "armature")),
    "python": Format("a module without dependencies", partial(program.export, language="python"), ("drive",)),
    "c": Format("a file of C99", partial(program.export, language="c"), ("drive",)),
    "isaaclab": Format("an actuator of Isaac Lab", servo.isaaclab, ("armature", "drive")),
    "mjlab": Format("an actuator of mjlab", servo.mjlab, ("armature", "drive")),
}


def export(model: Model, format: str, request: Request | None = None) -> Exported:
    """A model in a format of `FORMATS`.

    Raises:
        ValueError: if the format is unknown.
        ExportError: if the format cannot hold the model, and approximations are not allowed, or a drive is in another
            unit than the model.
        InputError: if a library of the extra `export` is not installed, or the format is none of an arm.
    """
    request, write = request or Request(), find("format", format, FORMATS).write
    if isinstance(model, ArmModel):
        from workbench.export.joints import FORMATS as OF_ARMS  # needs Pinocchio

        if format not in OF_ARMS:
            raise InputError(f"an arm is exported to {listing(list(OF_ARMS))}, not to {format}")
        return OF_ARMS[format](model, request)
    if request.drive is not None:
        request = replace(request, drive=servo.in_units_of(model, request.drive))
    return write(model, request)


__all__ = ["FORMATS", "ExportError", "Exported", "Request", "export"]
