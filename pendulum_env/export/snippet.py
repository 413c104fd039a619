"""Export of joints as text for robot files and simulators: URDF, MJCF, mjlab, Isaac Lab 2 and BAM.

These formats have an armature, viscous and dry friction; BAM also has Stribeck and load-dependent friction. The text
lists what each one lacks, with its size.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

from pendulum_env.export.actuators import Gains, JointActuator
from pendulum_env.export.mjcf import EVERY, Friction, get_value
from pendulum_env.export.program import load_environment
from pendulum_env.export.request import Exported, Request, escape_text, write_title
from pendulum_env.export.sizes import describe_size
from pendulum_env.physics import Model
from pendulum_env.physics.potential import WEIGHT
from pendulum_env.recording.channel import NEWTON_METRE

IN_BAM = (*EVERY, "stribeck", "load_dependent_friction")  # terms that BAM has


@dataclass(frozen=True)
class JointParameters:
    """Parameters of a joint for other programs.

    Attributes:
        joint: name of the joint.
        model: of the joint.
        armature: inertia that the joint adds to that of its links [kg m^2].
        gains: of its servo; None without one.
        missing: parts of the servo that the formats lack.
    """

    joint: str
    model: Model
    armature: float
    gains: Gains | None = None
    missing: tuple[str, ...] = ()

    @classmethod
    def from_model(cls, model: Model, request: Request, actuator: JointActuator) -> Self:
        """Return the parameters of a joint without links, whose armature is all of the inertia unless it is given."""
        inertia, missing = get_value(model, "inertia"), actuator.missing
        if not request.armature:
            missing += (f"the inertia of the links: the armature has all {inertia:.3g} {model.units().unit('kg m^2')}",)
        return cls("joint", model, request.armature or inertia, actuator.gains, missing)

    @property
    def name(self) -> str:
        """Return the name of the joint for text in any language."""
        return escape_text(self.joint).replace("--", "- -")

    def unit(self, si: str) -> str:
        """Return the unit of a quantity of the joint; see `JointUnits.unit`."""
        return self.model.units().unit(si)

    @property
    def title(self) -> str:
        """Return the title of the joint."""
        return f"{self.name}: {write_title(self.model)}"

    @cached_property
    def friction(self) -> Friction:
        """Return the viscous and dry friction that approximate the model."""
        return Friction.from_model(self.model, ())

    @property
    def limit(self) -> float | None:
        """Return the largest torque of the servo [N m]; None without a limit."""
        return None if self.gains is None or math.isinf(self.gains.limit) else self.gains.limit

    @property
    def losses(self) -> tuple[str, ...]:
        """Return the parts of model and servo that all formats but BAM lack, a phrase each."""
        weights = [term for term in self.model.terms if term.id in WEIGHT]
        of_links = (
            f"{t.id} ({t.law}; {describe_size(self.model, t)}): the masses of the links have it" for t in weights
        )
        return (*of_links, *self.friction.missing, *self.missing)

    @property
    def bam(self) -> str:
        """Return the parameters of BAM: its model m1, with Stribeck friction m2, with load-dependent friction m5.

        Torque is kt / R per volt, and back-EMF kt^2 / R; both are left out if gain or back-EMF are unknown.
        """
        content: dict[str, object] = {"model": "m1", "actuator": "SERVO", "armature": self.armature}
        shape = {term.id: term.nonlinear_values for term in self.model.terms}
        emf, viscous = (get_value(self.model, name) for name in ("back_emf", "viscous"))
        if self.gains is not None and self.gains.per_volt is not None and emf > 0:
            content |= {"kt": emf / self.gains.per_volt, "R": emf / self.gains.per_volt**2}
            emf = 0.0
        content |= {"friction_base": get_value(self.model, "coulomb"), "friction_viscous": viscous + emf}
        if has_load := "load_dependent_friction" in shape:
            motor, load = (get_value(self.model, f"load_dependent_friction{end}") for end in ("", ".output"))
            content |= {"load_friction_motor": motor, "load_friction_external": load}
            content |= {"load_friction_motor_stribeck": 0.0, "load_friction_external_stribeck": 0.0}
        if has_load or "stribeck" in shape:
            values = shape.get("stribeck", {"stribeck_velocity": 1.0, "exponent": 2.0})
            content |= {"model": "m5" if has_load else "m2", "friction_stribeck": get_value(self.model, "stribeck")}
            content |= {"dtheta_stribeck": values["stribeck_velocity"], "alpha": values["exponent"]}
        return json.dumps(content, indent=2)

    @property
    def bam_losses(self) -> tuple[str, ...]:
        """Return the parts of model and servo that BAM lacks, a phrase each."""
        model = self.model
        losses = [f"{term.id} ({describe_size(model, term)})" for term in model.terms if term.id not in IN_BAM]
        if '"kt"' not in self.bam:
            losses.append(
                "kt and R: torque per volt and back-EMF are not both known; friction_viscous has the back-EMF"
            )
        if "load_dependent_friction" in model.effects:
            losses.append("load-dependent friction where motor and load push the same way: BAM subtracts them")
        if model.torque_unit != NEWTON_METRE:
            losses.append(f"the scale of the torque: all parameters are per {model.torque_unit}")
        return (*losses, *self.missing)


def write_joints(joints: Sequence[JointParameters]) -> Exported:
    """Write the text for some joints, each with its own sections."""
    notes = tuple(f"{joint.name}: no format but BAM has {text}" for joint in joints for text in joint.losses)
    return Exported(load_environment().get_template("snippet.txt").render(joints=joints), notes)
