"""The form `mjcf`: a model for MuJoCo, written by MuJoCo's own `MjSpec`.

What MuJoCo solves is not quite the model's law: its dry friction is regularised, a joint that should stick creeps with
a speed proportional to the torque it holds, and a stop is a soft constraint. The constants below make both as close as
its solver allows at the step that is written into the file.
"""

import math
from typing import Any

from pendulum_env.backends.constrained_body import IMPEDANCE, STEPS, import_mujoco
from pendulum_env.physics import Model
from pendulum_env.physics.transmission import JointFlexibility
from workbench.export.arm import Friction, RigidBody, Stop, get_value, is_spring_linear, make_body
from workbench.export.request import Exported, Request, escape_comment, note_missing, write_title
from workbench.export.servo import Motor, Servo

JOINT, ACTUATOR = "joint", "torque"  # names in the file
BODILY = ("quadratic_drag", "spring", "hard_stop")  # effects that its joints have, beside those of `EVERY`
# Impedance of the stop: MuJoCo's lower bound of 0.0001. A constraint with impedance d replaces the share d of what else
# accelerates the joint, so that a small one only adds to it, as a spring does.
SOFT = (1e-4, 1e-4, 0.001, 0.5, 2.0)


def export(model: Model, request: Request, actuator: Motor | Servo) -> Exported:
    """Write the XML of a model.

    Raises ExportError if the model has what MuJoCo does not, and may not be exported without it, and
    ModuleNotFoundError if the extra `export` is not installed.
    """
    mujoco = import_mujoco()
    links = [term for term in model.terms if isinstance(term, JointFlexibility)]
    # there is a motor and a link, each with an inertia of its own
    link = next((own for own in links if 0.0 < get_value(model, own.id) < get_value(model, "inertia")), None)
    held = {*BODILY, *([] if link is None else [link.id])}
    if get_value(model, "quadratic_drag") < 0:  # MuJoCo's dampers brake
        held.remove("quadratic_drag")
    if not is_spring_linear(model):
        held.remove("spring")
    held |= set(actuator.held)
    friction, stop = Friction.from_model(model, held), Stop.from_model(model)
    missing = (*friction.missing, *stop.missing, *actuator.missing)
    notes = note_missing(missing, request)
    spec = mujoco.MjSpec()
    spec.modelname, spec.comment = "pendulum", escape_comment((write_title(model), *notes))
    spec.option.timestep = request.step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if link is None:
        body = _add(spec.worldbody, "arm", make_body(model, request))
    else:
        inertia = get_value(model, link.id)  # [kg m^2], J of the link
        motor = RigidBody.from_pendulum(
            get_value(model, "inertia") - inertia - request.armature,
            get_value(model, "gravity") - inertia * link.gravity,
            get_value(model, "gravity_tilt"),
        )
        body = _add(spec.worldbody, "motor", motor)
        behind = _add(body, "link", RigidBody.from_pendulum(inertia, inertia * link.gravity, mass=request.mass))
        spring = behind.add_joint(name="transmission", axis=(1, 0, 0))
        spring.stiffness = inertia * link.resonance**2, 0.0, 0.0
        spring.damping = inertia * link.damping, 0.0, 0.0
    joint = body.add_joint(name=JOINT, axis=(1, 0, 0))
    joint.damping = friction.viscous, get_value(model, "quadratic_drag") if "quadratic_drag" in held else 0.0, 0.0
    joint.frictionloss, joint.armature = friction.dry, request.armature
    joint.solref_friction, joint.solimp_friction = (STEPS * request.step, 1.0), IMPEDANCE
    if "spring" in held and (stiffness := get_value(model, "spring.stiffness")):
        joint.stiffness = stiffness, 0.0, 0.0
        joint.springref = math.degrees(-get_value(model, "spring.preload") / stiffness)
    if stop.is_there:
        inertia = get_value(model, "inertia")
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = [math.degrees(end) for end in stop.ends]
        joint.solref_limit = -stop.stiffness / inertia, -stop.damping / inertia
        joint.solimp_limit = SOFT
    _add_actuator(mujoco, spec, model, actuator)
    spec.compile()
    return Exported(spec.to_xml(), notes)


def _add(parent: Any, name: str, body: RigidBody) -> Any:
    added = parent.add_body(name=name, mass=body.mass, ipos=body.centre, inertia=body.moments, explicitinertial=True)
    added.add_geom(
        name=name, fromto=(0.0, 0.0, 0.0, *(2.0 * x for x in body.centre)), size=(0.01, 0.0, 0.0), mass=0.0,
        type=3, contype=0, conaffinity=0,
    )  # fmt: skip
    return added


def _add_actuator(mujoco: Any, spec: Any, model: Model, kind: Motor | Servo) -> None:
    """Add the actuator: a torque with what lies between the command and the joint, or a servo."""
    offset = get_value(model, "torque_offset") + get_value(model, "coulomb_asymmetry")
    actuator = spec.add_actuator(name=ACTUATOR, target=JOINT, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    kind.actuate(mujoco, actuator, model, offset)
    if offset:
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.biasprm = [-offset, *actuator.biasprm[1:]]
