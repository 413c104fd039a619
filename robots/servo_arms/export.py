"""Export of an arm of servos: refused, since the scale of its torque is unknown."""

from pendulum_env.export.exporter import Exporter
from pendulum_env.export.request import Exported, ExportError, Request
from pendulum_env.physics import Model
from robots.servo_arms.model import ServoArmModel


class ServoArmExporter(Exporter):
    """Export of an arm of servos."""

    def accepts(self, model: Model, request: Request) -> bool:
        """Return whether the model is that of an arm of servos."""
        return isinstance(model, ServoArmModel)

    def export(self, model: Model, format: str, request: Request) -> Exported:
        """Raise an ExportError."""
        raise ExportError("an arm of servos cannot be exported yet: take the parameters from the model file")


EXPORTER = ServoArmExporter()
