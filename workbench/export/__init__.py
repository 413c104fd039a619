"""Export of a model to other programs.

`python` and `c` contain the simulator's step with all effects. `mjcf` describes a joint, a servo or an arm for MuJoCo,
and lists the parts of the model that it lacks.
"""

from pendulum_env.lookup import find
from pendulum_env.physics import Model
from robots.arms.model import ArmModel
from workbench.errors import InputError
from workbench.export import joints, mjcf, program, servo
from workbench.export.request import Exported, ExportError, Request

FORMATS = {"mjcf": "a model for MuJoCo", "python": "a module without dependencies", "c": "a file of C99"}


def export(model: Model, format: str, request: Request | None = None) -> Exported:
    """Write a model in a format of `FORMATS`.

    Raises:
        ValueError: if the format is unknown.
        ExportError: if the format cannot represent the model and approximations are not allowed, or the units of
            model and drive differ.
        InputError: if a library of the extra `export` is not installed, or an arm is to be exported to code.
    """
    find("format", format, FORMATS)
    request = request or Request()
    if isinstance(model, ArmModel):
        if format != "mjcf":
            raise InputError(f"an arm is exported to mjcf, not to {format}")
        return joints.export_arm(model, request)
    actuator = servo.choose_actuator(model, request)
    if format == "mjcf":
        return mjcf.export(model, request, actuator)
    return program.export(model, request.step, actuator, "c" if format == "c" else "python")


__all__ = ["FORMATS", "ExportError", "Exported", "Request", "export"]
