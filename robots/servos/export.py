"""Export of a servo: a joint with its drive and a goal input."""

from collections.abc import Sequence

from pendulum_env.export.exporter import CheckResult, Exporter, export_joint
from pendulum_env.export.request import Exported, Request
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from robots.servos import ServoDrive
from robots.servos.exported_servo import make_servo


class ServoExporter(Exporter):
    """Export of a joint with a drive."""

    def accepts(self, model: Model, request: Request) -> bool:
        """Return whether the model is that of a joint, and the drive of the request that of a servo."""
        return isinstance(request.drive, ServoDrive) and model.mechanism.can_simulate

    def export(self, model: Model, format: str, request: Request) -> Exported:
        """Write a joint with its drive; raises ExportError as `make_servo`, and as `export_joint`."""
        assert isinstance(request.drive, ServoDrive)
        return export_joint(model, format, request, make_servo(model, request.drive))

    def check(self, model: Model, exported: Exported, request: Request, recordings: Sequence[Recording]) -> CheckResult:
        """Compare whole recordings of servos; see `check_in_loop`."""
        from robots.servos.export_check import check_in_loop  # slow to import

        return check_in_loop(model, request, recordings)


EXPORTER = ServoExporter()
