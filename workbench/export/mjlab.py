"""The form `mjlab`: the configuration of an actuator of mjlab, which is MuJoCo's own with another name."""

from __future__ import annotations

import math

from pendulum_env.physics import Model
from workbench.export.arm import Friction
from workbench.export.heading import remark
from workbench.export.request import Exported, Request, keep
from workbench.export.servo import Servo, needed_drive, settings


def export(model: Model, request: Request) -> Exported:
    """The configuration, as a Python file.

    Raises:
        ExportError: if there is no drive, or the model has what mjlab has not and may not be approximated.
    """
    drive = needed_drive("mjlab", request)
    servo, friction = Servo.of(drive), Friction.of(model, ())
    notes = keep("mjlab", (*friction.missing, *servo.missing), request)
    kind = "BuiltinVelocityActuatorCfg" if drive.acts_on_speed else "BuiltinPositionActuatorCfg"
    values: dict[str, object] = {
        "target_names_expr": ("joint",),
        **({} if drive.acts_on_speed else {"stiffness": servo.stiffness}),
        "damping": servo.damping,
        "effort_limit": servo.limit if math.isfinite(servo.limit) else None,
        "armature": request.armature,
        "frictionloss": friction.dry,
        "viscous_damping": friction.viscous,
    }
    head = remark(model, (*notes, "For the joint of that name in your robot; N m, rad and s."))
    return Exported(f"{head}\nfrom mjlab.actuator import {kind}\n\n{settings(kind, values)}", notes)
