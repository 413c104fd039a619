"""The form `isaaclab`: the configuration of an actuator of Isaac Lab 2, on Isaac Sim 5 or later.

With back-EMF it is a `DCMotorCfg`: a limit of the voltage, kp e - kd q' within +-L, less back-EMF k q', is the same as
kp e - (kd + k) q' within +-L - k q', the line from stall torque L to the speed L / k without load. Below that speed it
brakes with less than 2 L, where Isaac Lab limits it besides.
"""

from __future__ import annotations

import math

from pendulum_env.physics import Model
from workbench.export.arm import Friction, value
from workbench.export.heading import remark
from workbench.export.request import Exported, Request, keep
from workbench.export.servo import Servo, needed_drive, settings


def export(model: Model, request: Request) -> Exported:
    """The configuration, as a Python file.

    Raises:
        ExportError: if there is no drive, or the model has what Isaac Lab has not and may not be approximated.
    """
    drive = needed_drive("isaaclab", request)
    servo = Servo.of(drive)
    is_motor = math.isfinite(servo.limit) and not drive.acts_on_speed
    brake = value(model, "back_emf") if is_motor else 0.0
    friction = Friction.of(model, (), less=brake)
    notes = keep("isaaclab", (*friction.missing, *servo.missing), request)
    kind = "DCMotorCfg" if brake else "IdealPDActuatorCfg"
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
    head = remark(model, (*notes, "For the joint of that name in your robot; N m, rad and s."))
    return Exported(f"{head}\nfrom isaaclab.actuators import {kind}\n\n{settings(kind, values)}", notes)
