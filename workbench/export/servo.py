"""A servo as MuJoCo knows it: a spring to the goal, a damper, and a limit of the torque."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from pendulum_env.physics import Model
from pendulum_env.recording.record import NEWTON_METRE
from pendulum_env.servo.drive import UNIT, Drive
from workbench.export.request import ExportError


@dataclass(frozen=True)
class Servo:
    """A drive as gains at the joint."""

    stiffness: float  # torque by the error of the angle [N m/rad]
    damping: float  # torque by the speed, or by its error under velocity control [N m s/rad]
    limit: float  # largest torque [N m], perhaps infinite
    missing: tuple[str, ...]  # what of the drive this is not

    @classmethod
    def of(cls, drive: Drive) -> Self:
        """The gains of a drive under its supply; raises ExportError if it needs one that nobody says."""
        scale = float(drive.scale(np.array(supply_of(drive))))
        missing = []
        if drive.ki:
            missing.append("an integral of the error (ki): it is left out")
        if drive.rate is not None:
            missing.append(f"a controller at {drive.rate:g} Hz: it looks at every step")
        if drive.cutoff is not None:
            missing.append("a filter of the speed (cutoff): it is left out")
        if drive.delay:
            missing.append(f"a delay of {drive.delay:g} s from measuring to acting: it is left out")
        stiffness, damping = (0.0, drive.kp) if drive.acts_on_speed else (drive.kp, drive.kd)
        return cls(stiffness * scale, damping * scale, drive.most * scale, tuple(missing))


def in_units_of(model: Model, drive: Drive) -> Drive:
    """A drive whose torque is in the unit of a model's; raises ExportError if nobody knows its gain."""
    known = model.torque_constant
    if drive.gain is None and known is not None and known.unit == f"{NEWTON_METRE}/{UNIT[drive.output]}":
        drive = replace(drive, gain=known.value)
    if drive.unit != model.torque_unit:
        raise ExportError(
            f"the model is in {model.torque_unit}, but the drive gives {drive.unit}: give the drive its gain, or take "
            "a model in that unit"
        )
    return drive


def supply_of(drive: Drive) -> float:
    """Voltage of the bus [V], for an output that is a share of it; raises ExportError if nobody says it."""
    if drive.supply is None and drive.output == "duty":
        raise ExportError("a duty is a share of the bus: say its voltage, as --drive output=duty,kp=0.6,supply=12")
    return drive.supply or 1.0
