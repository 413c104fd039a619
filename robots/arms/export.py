"""Export of an arm to MJCF.

The links are those of `nearest_body`: physically possible bodies with the identified base parameters, otherwise near
the robot file. Shapes and meshes are left out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.backends.constrained_body import IMPEDANCE, STEPS, import_mujoco
from pendulum_env.export import feedforward, snippet
from pendulum_env.export.actuators import JointActuator
from pendulum_env.export.exporter import Exporter
from pendulum_env.export.mjcf import Friction, get_value, is_spring_linear
from pendulum_env.export.request import Exported, ExportError, Request, escape_comment, escape_text, note_missing
from pendulum_env.export.sizes import SPEEDS
from pendulum_env.physics import Model, Table, find_term, list_loads
from pendulum_env.physics.joints import Coupling, Rotor
from robots.arms.body import Body
from robots.arms.model import ArmModel
from robots.arms.standard import nearest_body
from robots.arms.texts import describe_nearest_body
from robots.arms.world import build_specification

LINKS = "the links: --to mjcf has those that belong to the armatures"  # missing in snippets


def select_joint(model: ArmModel, joint: str) -> tuple[Model, tuple[str, ...]]:
    """Return the terms at one joint as a pendulum model, and the tables at it, which are left out."""
    of_joint = [term for term in model.terms[1:] if term.at == joint]
    tables = tuple(f"{table.id} ({table.law}): it is left out" for table in of_joint if isinstance(table, Table))
    effects = [term for term in of_joint if not isinstance(term, Table | Rotor)]
    terms = [find_term(term.id.partition("@")[0])(**term.nonlinear_values) for term in effects]
    names = [column.name for term in terms for column in term.columns]
    theta = np.array([get_value(model, f"{name}@{joint}") for name in names])
    known = [model.estimates.get(f"{name}@{joint}") for name in names]
    std = np.array([0.0 if estimate is None else estimate.std for estimate in known])
    return Model.build(terms, theta, std), tables


@dataclass(frozen=True)
class JointExport:
    """Joint of an exported arm.

    Attributes:
        model: terms at the joint, without links.
        actuator: of the joint; None for a torque input.
        losses: parts of the joint and its actuator that MuJoCo lacks, a phrase each.
        speeds: at which viscous and dry friction approximate other friction [rad/s].
        load: typical torque at the joint, for friction that follows it [N m].
    """

    model: Model
    actuator: JointActuator | None
    losses: tuple[str, ...] = ()
    speeds: Array = field(default_factory=lambda: SPEEDS)
    load: float = 0.0


def build_arm(
    body: Body, standard: Array, joints: Mapping[str, JointExport], omissions: Sequence[str], request: Request
) -> tuple[Any, tuple[str, ...]]:
    """Build the `MjSpec` of an arm with friction and springs, without actuators; return it with notes on what it lacks.

    `standard` are the standard parameters of the links (S,), `omissions` further parts that MuJoCo lacks. Raises
    ExportError if MuJoCo cannot represent the model and approximations are not allowed, and ModuleNotFoundError without
    MuJoCo.
    """
    import_mujoco()
    omissions, friction, drag = [*omissions], dict[str, tuple[float, float]](), dict[str, float]()
    for at, joint in joints.items():
        held = {"spring"} if is_spring_linear(joint.model) else set()
        held.update(() if joint.actuator is None else joint.actuator.list_held(joint.model))
        if (drag_at := get_value(joint.model, "quadratic_drag")) > 0:  # MuJoCo's dampers only dissipate
            held.add("quadratic_drag")
            drag[at] = drag_at
        of_joint = Friction.from_model(joint.model, held, joint.speeds, joint.load)
        friction[at] = of_joint.viscous, of_joint.dry
        omissions += [f"{text} (at {at})" for text in (*of_joint.missing, *joint.losses)]
    notes = note_missing(omissions, request, remedy="")
    spec = build_specification(body, standard, friction)
    spec.option.timestep = request.step
    for hinge in spec.joints:
        hinge.solref_friction = STEPS * request.step, 1.0
        hinge.damping = [hinge.damping[0], drag.get(hinge.name, 0.0), 0.0]
        model = joints[hinge.name].model if hinge.name in joints else Model(())
        stiffness = get_value(model, "spring.stiffness")
        if stiffness > 0 and is_spring_linear(model):
            hinge.stiffness = [stiffness, 0.0, 0.0]
            hinge.springref = -get_value(model, "spring.preload") / stiffness
    for tie in spec.equalities:
        tie.solref = STEPS * request.step, 1.0
    return spec, notes


def write_specification(spec: Any, body: Body, notes: tuple[str, ...]) -> Exported:
    """Write a specification of an arm, with notes in its head."""
    spec.compile()
    head = escape_comment((f"The arm {escape_text(body.name)}, as identified.", *notes))
    return Exported(f'<?xml version="1.0"?>\n<!-- {head} -->\n{spec.to_xml()}', notes)


def export_arm(model: ArmModel, request: Request) -> Exported:
    """Write an arm for MuJoCo, with a motor at each joint; raises as `build_arm`."""
    body, links = model.mechanism, nearest_body(model)
    standard = np.array([links.parameters[name].value for name in body.standard])
    omissions = [] if links.exists else [f"the links as identified: {describe_nearest_body(links)}"]
    parts = {at: select_joint(model, at) for at in body.joints}
    joints = {at: JointExport(part, None, tables) for at, (part, tables) in parts.items()}
    spec, notes = build_arm(body, standard, joints, omissions, request)
    for rotor in (part for part in model.terms if isinstance(part, Rotor)):  # those of `body` are in `standard`
        spec.joint(rotor.at).armature += get_value(model, f"rotor@{rotor.at}")
    for term in (part for part in model.terms if isinstance(part, Coupling)):
        tendon = spec.add_tendon(name=term.id, solimp_friction=IMPEDANCE, solref_friction=[STEPS * request.step, 1.0])
        for joint, factor in list_loads(term.at).items():
            tendon.wrap_joint(joint, factor)
        tendon.damping = [max(get_value(model, f"coupling.viscous@{term.at}"), 0.0), 0.0, 0.0]
        tendon.frictionloss = max(get_value(model, f"coupling.coulomb@{term.at}"), 0.0)
        tendon.armature = max(get_value(model, f"coupling.inertia@{term.at}"), 0.0)
    for at in body.joints:
        motor = spec.add_actuator(name=at, target=at, trntype=import_mujoco().mjtTrn.mjTRN_JOINT)
        motor.gainprm[0] = 1.0
    return write_specification(spec, body, notes)


def export_joints(model: ArmModel, format: str, request: Request) -> Exported:
    """Write the joints of an arm as snippets or feedforwards, without the links."""
    joints = {joint: select_joint(model, joint) for joint in model.mechanism.joints}
    if format == "feedforward":
        return feedforward.export([(joint, part) for joint, (part, _) in joints.items()], request.language)
    rotors = {name: estimate.value for name, estimate in nearest_body(model).parameters.items()}
    added = [term.id for term in model.terms if isinstance(term, Rotor)]  # to those of the body
    armatures = [
        rotors.get(name, 0.0) + (name in added) * get_value(model, name) for name in map("rotor@{}".format, joints)
    ]
    parts = zip(joints.items(), armatures, strict=True)
    return snippet.write_joints(
        [
            snippet.JointParameters(joint, part, armature, None, (*tables, LINKS))
            for (joint, (part, tables)), armature in parts
        ]
    )


class ArmExporter(Exporter):
    """Export of an arm."""

    def accepts(self, model: Model, request: Request) -> bool:
        """Return whether the model is that of an arm."""
        return isinstance(model, ArmModel)

    def export(self, model: Model, format: str, request: Request) -> Exported:
        """Write an arm for MuJoCo, or the friction of its joints; raises ExportError for other formats."""
        assert isinstance(model, ArmModel)
        if request.drive is not None:
            raise ExportError("a model of known torques has no drive: leave --drive out")
        if format in ("snippet", "feedforward"):
            return export_joints(model, format, request)
        if format != "mjcf":
            raise ExportError(f"an arm is exported to mjcf, snippet or feedforward, not to {format}")
        return export_arm(model, request)


EXPORTER = ArmExporter()
