"""Export of a model to other programs.

`python` and `c` contain the simulator's step with all effects. `mjcf` describes a joint, a servo or an arm for MuJoCo,
and lists the parts of the model that it lacks. `snippet` has the parameters of each joint as text for other programs,
`feedforward` the torque that compensates friction and weight.
"""

from pendulum_env.export.actuators import Motor
from pendulum_env.export.exporter import export_joint, find_exporter
from pendulum_env.export.request import Exported, ExportError, Request
from pendulum_env.lookup import find
from pendulum_env.physics import Model

FORMATS = {
    "mjcf": "a model for MuJoCo",
    "python": "a module without dependencies",
    "c": "a file of C99",
    "snippet": "text for URDF, MJCF, mjlab, Isaac Lab and BAM",
    "feedforward": "the torque that compensates friction, cogging and weight, as a function and tables",
}


def export(model: Model, format: str, request: Request | None = None) -> Exported:
    """Write a model in a format of `FORMATS`.

    Raises:
        ValueError: if the format is unknown.
        ExportError: if the format cannot represent the model and approximations are not allowed, the units of model and
            drive differ, or an arm is to be exported to code.
        ModuleNotFoundError: if a library of the extra `export` is not installed.
    """
    find("format", format, FORMATS)
    request = request or Request()
    if (exporter := find_exporter(model, request)) is not None:
        return exporter.export(model, format, request)
    return export_joint(model, format, request, Motor(request.step))


__all__ = ["FORMATS", "ExportError", "Exported", "Request", "export"]
