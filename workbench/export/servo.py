"""A servo as simulators know it: a spring to the goal, a damper, and a limit of the torque.

The forms `isaaclab` and `mjlab` configure such an actuator of Isaac Lab 2, or of mjlab, in a Python file.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from pendulum_env.physics import Model
from pendulum_env.recording.record import NEWTON_METRE
from pendulum_env.servo.drive import UNIT, Drive
from workbench.export.arm import Friction, value
from workbench.export.request import Exported, ExportError, Request, keep, plain, title


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


def isaaclab(model: Model, request: Request) -> Exported:
    """For Isaac Lab 2, on Isaac Sim 5 or later.

    With back-EMF it is a `DCMotorCfg`: a limit of the voltage, kp e - kd q' within +-L, less back-EMF k q', is the same
    as kp e - (kd + k) q' within +-L - k q', the line from stall torque L to the speed L / k without load. Below that
    speed it brakes with less than 2 L, where Isaac Lab limits it besides.

    Raises ExportError if there is no drive, or the model has what Isaac Lab has not and may not be approximated.
    """
    drive = _needed_drive("isaaclab", request)
    servo = Servo.of(drive)
    is_motor = math.isfinite(servo.limit) and not drive.acts_on_speed
    brake = value(model, "back_emf") if is_motor else 0.0
    friction = Friction.of(model, (), less=brake)
    notes = keep("isaaclab", (*friction.missing, *servo.missing), request)
    values: dict[str, object] = {
        "joint_names_expr": ["joint"],
        "stiffness": servo.stiffness,
        "damping": servo.damping + brake,
        "armature": request.armature,
        "friction": friction.dry,
        "dynamic_friction": friction.dry,
        "viscous_friction": friction.viscous,
    }
    if math.isfinite(servo.limit):
        values["effort_limit"] = 2 * servo.limit if brake else servo.limit
    if brake:
        values |= {"saturation_effort": servo.limit, "velocity_limit": servo.limit / brake}
    return _configured("isaaclab.actuators", "DCMotorCfg" if brake else "IdealPDActuatorCfg", values, model, notes)


def mjlab(model: Model, request: Request) -> Exported:
    """For mjlab, whose actuators are MuJoCo's own with other names.

    Raises ExportError if there is no drive, or the model has what mjlab has not and may not be approximated.
    """
    drive = _needed_drive("mjlab", request)
    servo, friction = Servo.of(drive), Friction.of(model, ())
    notes = keep("mjlab", (*friction.missing, *servo.missing), request)
    values: dict[str, object] = {
        "target_names_expr": ("joint",),
        **({} if drive.acts_on_speed else {"stiffness": servo.stiffness}),
        "damping": servo.damping,
        "effort_limit": servo.limit if math.isfinite(servo.limit) else None,
        "armature": request.armature,
        "frictionloss": friction.dry,
        "viscous_damping": friction.viscous,
    }
    kind = "BuiltinVelocityActuatorCfg" if drive.acts_on_speed else "BuiltinPositionActuatorCfg"
    return _configured("mjlab.actuator", kind, values, model, notes)


def _needed_drive(format: str, request: Request) -> Drive:
    """The drive that a format is of; raises ExportError if nobody says it."""
    if request.drive is None:
        raise ExportError(
            f"{format} is of a servo: say its controller with --drive, as --drive output=torque,kp=4,limit=5"
        )
    return request.drive


def _configured(module: str, kind: str, values: Mapping[str, object], model: Model, notes: Sequence[str]) -> Exported:
    """A Python file that makes one object of a module, with keywords, one a line."""
    head = [
        f"# {plain(line)}"
        for line in (title(model), *notes, "For the joint of that name in your robot; N m, rad and s.")
    ]
    rounded = {key: float(f"{value:.6g}") if isinstance(value, float) else value for key, value in values.items()}
    body = [f"ACTUATOR = {kind}(", *(f"    {key}={value!r}," for key, value in rounded.items()), ")"]
    return Exported("\n".join([*head, f"from {module} import {kind}", "", *body, ""]), tuple(notes))
