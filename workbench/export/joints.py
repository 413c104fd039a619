"""The forms `mjcf` and `urdf` of an arm: the links that are likeliest behind its base parameters, and what joints do.

Links are those of `nearest_body`: bodies that exist, with the base parameters that were found, and near the file
where these leave it open. Shapes and meshes are not part of a model and so of neither form.
"""

from collections.abc import Callable
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from estimators.arms.standard import nearest_body
from pendulum_env._typing import Array
from pendulum_env.arms.body import STANDARD
from pendulum_env.arms.joints import Coupling
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.robot import pinocchio
from pendulum_env.arms.world import library, specification
from pendulum_env.backends.constrained_body import IMPEDANCE, STEPS
from pendulum_env.physics import Model
from pendulum_env.physics.library import term
from pendulum_env.physics.table import Table
from pendulum_env.physics.term import loads
from workbench.export.arm import Friction, holds_spring, value
from workbench.export.request import Exported, Request, commented, keep, plain
from workbench.export.robot import UNBOUNDED, add_link, numbers, xml


def at(model: ArmModel, joint: str) -> tuple[Model, tuple[str, ...]]:
    """What acts at a joint alone as a model of its own, and the effects there that cannot be part of one."""
    own = [one for one in model.terms[1:] if one.at == joint]
    tables = tuple(f"{one.id} ({one.law}): it is left out" for one in own if isinstance(one, Table))
    terms = [term(one.id.partition("@")[0])(**one.shape) for one in own if not isinstance(one, Table)]
    names = [column.name for one in terms for column in one.columns]
    theta = np.array([value(model, f"{name}@{joint}") for name in names])
    return Model.build(terms, theta), tables


def mjcf(model: ArmModel, request: Request) -> Exported:
    """For MuJoCo, with a motor at each joint; springs and motors that turn with two joints are MuJoCo's own.

    Raises ExportError if the model has what MuJoCo does not, and may not be exported without it, and BodyError without
    MuJoCo.
    """
    mujoco, body = library(), model.body
    standard, off = _standard(model)
    joints, notes = _friction("mjcf", model, ("spring", Coupling.id), off, request)
    spec = specification(body, standard, {joint: (own.viscous, own.dry) for joint, own in joints.items()})
    spec.option.timestep = request.step
    for joint in spec.joints:
        joint.solref_friction = STEPS * request.step, 1.0
        stiffness = value(model, f"spring.stiffness@{joint.name}")
        if stiffness > 0 and holds_spring(at(model, joint.name)[0]):
            joint.stiffness, joint.springref = (
                [stiffness, 0.0, 0.0],
                -value(model, f"spring.preload@{joint.name}") / stiffness,
            )
    for tie in spec.equalities:
        tie.solref = STEPS * request.step, 1.0
    for own in (one for one in model.terms if isinstance(one, Coupling)):
        motor = spec.add_tendon(name=own.id, solimp_friction=IMPEDANCE, solref_friction=[STEPS * request.step, 1.0])
        for joint, factor in loads(own.at).items():
            motor.wrap_joint(joint, factor)
        motor.damping = [max(value(model, f"coupling.viscous@{own.at}"), 0.0), 0.0, 0.0]
        motor.frictionloss = max(value(model, f"coupling.coulomb@{own.at}"), 0.0)
        motor.armature = max(value(model, f"coupling.inertia@{own.at}"), 0.0)
    for joint in body.joints:
        motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gainprm[0] = 1.0
    spec.compile()
    return Exported(_said(spec.to_xml(), model, notes), notes)


def urdf(model: ArmModel, request: Request) -> Exported:
    """For ROS: links, joints with limits and friction, and which joint mimics which.

    Raises ExportError if the model has what a robot description does not, and may not be exported without it.
    """
    body, pin = model.body, pinocchio()
    standard, off = _standard(model)
    joints, notes = _friction("urdf", model, (), off, request)
    of, robot = body.model, Element("robot", name=body.name)
    SubElement(robot, "link", name="base")
    for k, joint in enumerate(body.links):
        link = pin.Inertia.FromDynamicParameters(standard[len(STANDARD) * k : len(STANDARD) * (k + 1)])
        add_link(robot, f"{joint}_link", link.mass, link.lever, link.inertia)
        parent = of.parents[k + 1]
        slides, low, high = joint in body.sliding, float(of.lowerPositionLimit[k]), float(of.upperPositionLimit[k])
        bounded = bool(np.isfinite([low, high]).all()) and low < high
        kind = "prismatic" if slides else "revolute" if bounded else "continuous"
        written = SubElement(robot, "joint", name=joint, type=kind)
        SubElement(written, "parent", link=f"{body.links[parent - 1]}_link" if parent else "base")
        SubElement(written, "child", link=f"{joint}_link")
        place = of.jointPlacements[k + 1]
        SubElement(written, "origin", xyz=numbers(place.translation), rpy=numbers(pin.rpy.matrixToRpy(place.rotation)))
        SubElement(written, "axis", xyz=numbers(np.ravel(of.joints[k + 1].createData().S).reshape(2, 3).sum(axis=0)))
        effort, speed = (float(most[k]) or UNBOUNDED for most in (of.upperEffortLimit, of.upperVelocityLimit))
        ends = {"lower": repr(low), "upper": repr(high)} if bounded else {}
        SubElement(written, "limit", ends, effort=repr(min(effort, UNBOUNDED)), velocity=repr(min(speed, UNBOUNDED)))
        if joint in joints:
            SubElement(written, "dynamics", damping=repr(joints[joint].viscous), friction=repr(joints[joint].dry))
        else:
            (leader,) = np.flatnonzero(body.ratios[k])
            ratio, offset = repr(float(body.ratios[k, leader])), repr(float(body.offsets[k]))
            SubElement(written, "mimic", joint=body.joints[leader], multiplier=ratio, offset=offset)
    return Exported(_said(xml(robot), model, notes), notes)


FORMATS: dict[str, Callable[[ArmModel, Request], Exported]] = {"mjcf": mjcf, "urdf": urdf}


def _standard(model: ArmModel) -> tuple[Array, list[str]]:
    """Standard parameters (S,) of the nearest body, and a note where no body has the model's parameters."""
    found = nearest_body(model)
    off = [] if found.exists else [f"the links as identified: {found.text}"]
    return np.array([found.parameters[name].value for name in model.body.standard]), off


def _friction(
    format: str, model: ArmModel, held: tuple[str, ...], off: list[str], request: Request
) -> tuple[dict[str, Friction], tuple[str, ...]]:
    """Friction of each joint, and what the format does not hold, a sentence each, if that is allowed."""
    joints, missing = {}, list(off)
    for joint in model.body.joints:
        own, tables = at(model, joint)
        kept = [id for id in held if id != "spring" or holds_spring(own)]
        joints[joint] = Friction.of(own, kept)
        missing += [f"{text} (at {joint})" for text in (*joints[joint].missing, *tables)]
    if Coupling.id not in held:
        missing += [f"{own.id}: it is left out" for own in model.terms if isinstance(own, Coupling)]
    if format == "urdf" and not model.body.model.gravity.linear.any():
        missing.append("that the driver takes gravity off: switch it off where the robot is simulated")
    if format == "urdf" and model.body.rotors:
        missing.append("rotors' inertia: it is left out")
    return joints, keep(format, missing, request, others="")


def _said(text: str, model: ArmModel, notes: tuple[str, ...]) -> str:
    first = text if text.startswith("<?xml") else f'<?xml version="1.0"?>\n{text}'
    return commented(first, (f"The arm {plain(model.body.name)}, as identified.", *notes))
