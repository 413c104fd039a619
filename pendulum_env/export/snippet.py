"""Export of joints as text for robot files and simulators: URDF, MJCF, mjlab, Isaac Lab 2 and BAM.

These formats have an armature, viscous and dry friction; BAM also has Stribeck and load-dependent friction. The text
lists what each one lacks, with its size.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

from pendulum_env.export.actuators import Gains, JointActuator
from pendulum_env.export.mjcf import EVERY, Friction, get_value
from pendulum_env.export.request import Exported, Request, escape_comment, escape_text, write_title
from pendulum_env.export.sizes import WEIGHT, describe_size
from pendulum_env.physics import Model
from pendulum_env.recording.channel import NEWTON_METRE

IN_BAM = (*EVERY, "stribeck", "load_dependent_friction")  # terms that BAM has


@dataclass(frozen=True)
class JointParameters:
    """Parameters of a joint for other programs.

    Attributes:
        name: of the joint.
        model: of the joint.
        armature: inertia that the joint adds to that of its links [kg m^2].
        gains: of its servo; None without one.
        missing: parts of the servo that the formats lack.
        friction: viscous and dry friction that approximate the model.
    """

    name: str
    model: Model
    armature: float
    gains: Gains | None = None
    missing: tuple[str, ...] = ()
    friction: Friction = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "friction", Friction.from_model(self.model, ()))

    @classmethod
    def from_model(cls, model: Model, request: Request, actuator: JointActuator) -> Self:
        """Return the parameters of a joint without links, whose armature is all of the inertia unless it is given."""
        inertia, missing = get_value(model, "inertia"), actuator.missing
        if not request.armature:
            missing += (f"the inertia of the links: the armature has all {inertia:.3g} {model.units().unit('kg m^2')}",)
        return cls("joint", model, request.armature or inertia, actuator.gains, missing)

    @property
    def losses(self) -> tuple[str, ...]:
        """Return the parts of model and servo that all formats but BAM lack, a phrase each."""
        weight = [
            f"{term.id} ({term.law}; {describe_size(self.model, term)}): the masses of the links have it"
            for term in self.model.terms
            if term.id in WEIGHT
        ]
        return (*weight, *self.friction.missing, *self.missing)


def write_joints(joints: Sequence[JointParameters]) -> Exported:
    """Write the text for some joints, each with its own sections."""
    parts, notes = [], list[str]()
    for joint in joints:
        parts += [escape_text(f"{joint.name}: {write_title(joint.model)}"), "Units: N m, rad, s, kg m^2.", ""]
        parts += ["Lost, except in BAM:", *(f"- {text}" for text in joint.losses or ("nothing",)), ""]
        for title, text in (
            ("URDF, within <joint>", write_urdf(joint)),
            ("MJCF, within <default>", write_mjcf(joint)),
            ("mjlab", write_mjlab(joint)),
            ("Isaac Lab 2", write_isaac_lab(joint)),
            ("BAM, params/SERVO/MODEL.json", write_bam(joint)),
        ):
            parts += [f"== {title} ==", text, ""]
        parts += ["Lost in BAM:", *(f"- {text}" for text in list_bam_losses(joint) or ("nothing",)), ""]
        notes += [f"{joint.name}: no format but BAM has {text}" for text in joint.losses]
    return Exported("\n".join(parts), tuple(notes))


def write_urdf(joint: JointParameters) -> str:
    """Write the dynamics of a joint of URDF, which has no armature."""
    return (
        f'<dynamics damping="{_write(joint.friction.viscous)}" friction="{_write(joint.friction.dry)}"/>'
        "  <!-- N m s/rad, N m -->"
    )


def write_mjcf(joint: JointParameters) -> str:
    """Write a default class of MJCF for joint and actuator."""
    friction, gains, name = joint.friction, joint.gains, escape_comment((escape_text(joint.name),))
    lines = [
        f'<default class="{name}">',
        f'  <joint armature="{_write(joint.armature)}" damping="{_write(friction.viscous)}" '
        f'frictionloss="{_write(friction.dry)}"/>  <!-- kg m^2, N m s/rad, N m -->',
    ]
    if gains is not None:
        kind = f'position kp="{_write(gains.stiffness)}"' if gains.stiffness else "velocity"
        limit = f' forcerange="{_write(-gains.limit)} {_write(gains.limit)}"' if math.isfinite(gains.limit) else ""
        lines.append(f'  <{kind} kv="{_write(gains.damping)}"{limit}/>  <!-- N m/rad, N m s/rad, N m -->')
    return "\n".join([*lines, "</default>"])


def write_mjlab(joint: JointParameters) -> str:
    """Write the configuration of an actuator of mjlab: a servo, or a motor without one."""
    friction, gains = joint.friction, joint.gains
    values: dict[str, object] = {"target_names_expr": (joint.name,)}
    if gains is not None:
        values |= ({"stiffness": gains.stiffness} if gains.stiffness else {}) | {"damping": gains.damping}
        values |= {"effort_limit": gains.limit} if math.isfinite(gains.limit) else {}
    values |= {"armature": joint.armature, "frictionloss": friction.dry, "viscous_damping": friction.viscous}
    kind = "Motor" if gains is None else "Position" if gains.stiffness else "Velocity"
    return _write_call("mjlab.actuator", f"Builtin{kind}ActuatorCfg", values)


def write_isaac_lab(joint: JointParameters) -> str:
    """Write the configuration of an actuator of Isaac Lab, without gains for a motor."""
    friction, gains = joint.friction, joint.gains or Gains(0.0, 0.0, math.inf, None)
    values: dict[str, object] = {"joint_names_expr": [joint.name]}
    values |= {"stiffness": gains.stiffness, "damping": gains.damping}
    values |= {"effort_limit_sim": gains.limit} if math.isfinite(gains.limit) else {}
    values |= {"armature": joint.armature, "friction": friction.dry, "dynamic_friction": friction.dry}
    values |= {"viscous_friction": friction.viscous}
    return _write_call("isaaclab.actuators", "ImplicitActuatorCfg", values)


def write_bam(joint: JointParameters) -> str:
    """Write the parameters of BAM: its model m1, with Stribeck friction m2, with load-dependent friction m5.

    Torque is kt / R per volt, and back-EMF kt^2 / R; both are left out if gain or back-EMF are unknown.
    """
    model, gains = joint.model, joint.gains
    terms = {term.id: term for term in model.terms}
    content: dict[str, object] = {"model": "m1", "actuator": "SERVO", "armature": joint.armature}
    emf = get_value(model, "back_emf")
    has_motor = gains is not None and gains.per_volt is not None and emf > 0
    if has_motor and gains is not None and gains.per_volt is not None:
        content |= {"kt": emf / gains.per_volt, "R": emf / gains.per_volt**2}
    viscous = get_value(model, "viscous") + (0.0 if has_motor else emf)
    content |= {"friction_base": get_value(model, "coulomb"), "friction_viscous": viscous}
    if has_load := "load_dependent_friction" in terms:
        motor, load = (get_value(model, f"load_dependent_friction{end}") for end in ("", ".output"))
        content |= {"load_friction_motor": motor, "load_friction_external": load}
        content |= {"load_friction_motor_stribeck": 0.0, "load_friction_external_stribeck": 0.0}
    if has_load or "stribeck" in terms:
        shape = terms["stribeck"].nonlinear_values if "stribeck" in terms else {}
        content |= {"friction_stribeck": get_value(model, "stribeck")}
        content |= {"dtheta_stribeck": shape.get("stribeck_velocity", 1.0), "alpha": shape.get("exponent", 2.0)}
        content["model"] = "m5" if has_load else "m2"
    return json.dumps(content, indent=2)


def list_bam_losses(joint: JointParameters) -> tuple[str, ...]:
    """List the parts of model and servo that BAM lacks, a phrase each."""
    model = joint.model
    losses = [f"{term.id} ({describe_size(model, term)})" for term in model.terms if term.id not in IN_BAM]
    if get_value(model, "back_emf") <= 0 or joint.gains is None or joint.gains.per_volt is None:
        losses.append("kt and R: torque per volt and back-EMF are not both known; friction_viscous has the back-EMF")
    if "load_dependent_friction" in model.effects:
        losses.append("load-dependent friction where motor and load push the same way: BAM subtracts them")
    if model.torque_unit != NEWTON_METRE:
        losses.append(f"the scale of the torque: all parameters are per {model.torque_unit}")
    return (*losses, *joint.missing)


def _write(value: float) -> str:
    return f"{value:.9g}"


def _write_call(module: str, kind: str, values: Mapping[str, object]) -> str:
    """Write Python code that makes an object, with a keyword in each line."""
    rounded = {key: float(_write(value)) if isinstance(value, float) else value for key, value in values.items()}
    body = [f"ACTUATOR = {kind}(", *(f"    {key}={value!r}," for key, value in rounded.items()), ")"]
    return "\n".join([f"from {module} import {kind}", *body])
