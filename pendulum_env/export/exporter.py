"""Exporters of kinds of models, registered by the entry points `EXPORTERS`."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pendulum_env.export import feedforward, mjcf, program, snippet
from pendulum_env.export.actuators import JointActuator
from pendulum_env.export.request import Exported, ExportError, Request
from pendulum_env.physics import Model
from pendulum_env.plugins import load_plugins, make_missing_error
from pendulum_env.recording import Recording

EXPORTERS = "pendulum_ident.exporters"


@dataclass(frozen=True)
class CheckResult:
    """Deviations of simulated motion or of torque from recordings."""

    title: str  # definition of the deviations
    errors: Mapping[str, float]  # by pair of compared motions
    motion: float | Mapping[str, float]  # the same measure of the recorded position about its mean, or of the torque;
    # of an arm by pair
    unit: str = "rad"
    of: str = "of the motion"  # what the deviations are compared with


class Exporter(ABC):
    """Export of one kind of models."""

    @abstractmethod
    def accepts(self, model: Model, request: Request) -> bool:
        """Return whether a model and a request belong to the kind."""

    @abstractmethod
    def export(self, model: Model, format: str, request: Request) -> Exported:
        """Write a model in a format; raises ExportError if the format cannot represent it."""

    def check(self, model: Model, exported: Exported, request: Request, recordings: Sequence[Recording]) -> CheckResult:
        """Compare an exported model in MuJoCo with recordings; raises ExportError if that is impossible."""
        raise ExportError("this kind of model has no check: leave --check out")


def export_joint(model: Model, format: str, request: Request, actuator: JointActuator) -> Exported:
    """Write a joint with an actuator in a format, `mjcf`, `python`, `c`, `snippet` or `feedforward`."""
    if format == "mjcf":
        return mjcf.export(model, request, actuator)
    if format == "snippet":
        return snippet.write_joints([snippet.JointParameters.from_model(model, request, actuator)])
    if format == "feedforward":
        return feedforward.export([("", model)], request.language)
    return program.export(model, request.step, actuator, "c" if format == "c" else "python")


def find_exporter(model: Model, request: Request) -> Exporter | None:
    """Return the exporter of an installed package for a model; None for a joint with a torque input.

    Raises:
        UserError: if no installed package exports the drive of the request, or an arm.
    """
    for exporter in load_plugins(EXPORTERS).values():
        if isinstance(exporter, Exporter) and exporter.accepts(model, request):
            return exporter
    if request.drive is not None or not model.mechanism.can_simulate:
        raise make_missing_error(EXPORTERS, "exports such a model")
    return None
