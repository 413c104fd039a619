"""The form `mjcf`: a model for MuJoCo, written by MuJoCo's own `MjSpec`.

What MuJoCo solves is not quite the model's law: its dry friction is regularised, a joint that should stick creeps with
a speed proportional to the torque it holds, and a stop is a soft constraint. The constants below make both as close as
its solver allows at the step that is written into the file.
"""

from __future__ import annotations

import math
from typing import Any

from pendulum_env.backends.constrained_body import IMPEDANCE, STEPS
from pendulum_env.physics import Model
from pendulum_env.physics.actuation import ActuatorLag
from pendulum_env.physics.transmission import JointFlexibility
from workbench.export.arm import Body, Friction, Stop, arm, value
from workbench.export.extra import needed
from workbench.export.heading import comment, title
from workbench.export.request import Exported, Request, keep

HELD = ("torque_offset", "coulomb_asymmetry", "quadratic_drag", "spring", "hard_stop", "actuator_lag", "dead_time")
JOINT, ACTUATOR = "joint", "torque"
# Impedance of the stop: MuJoCo's lower bound of 0.0001. A constraint with impedance d replaces the share d of what else
# accelerates the joint, so that a small one only adds to it, as a spring does.
SOFT = (1e-4, 1e-4, 0.001, 0.5, 2.0)


def export(model: Model, request: Request) -> Exported:
    """The XML of a model.

    Raises:
        ExportError: if the model has what MuJoCo does not, and may not be exported without it.
        InputError: if the extra `export` is not installed.
    """
    mujoco = needed("mujoco")
    link = next((term for term in model.terms if isinstance(term, JointFlexibility) and _holds(model, term)), None)
    held = [*HELD, *([] if link is None else [link.id])]
    for effect, parameter in (("quadratic_drag", "quadratic_drag"), ("spring", "spring.stiffness")):
        if value(model, parameter) < 0:  # MuJoCo's springs pull and its dampers brake
            held.remove(effect)
    friction, stop = Friction.of(model, held), Stop.of(model)
    notes = keep("mjcf", (*friction.missing, *(() if stop is None else stop.missing)), request)
    spec = mujoco.MjSpec()
    spec.modelname, spec.comment = "pendulum", comment((title(model), *notes))
    spec.option.timestep = request.step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if link is None:
        body = _add(spec.worldbody, "arm", arm(model, request))
    else:
        inertia = value(model, link.id)  # [kg m^2], J of the link
        motor = Body.of(
            value(model, "inertia") - inertia - request.armature,
            value(model, "gravity") - inertia * link.gravity,
            value(model, "gravity_tilt"),
        )
        body = _add(spec.worldbody, "motor", motor)
        behind = _add(body, "link", Body.of(inertia, inertia * link.gravity, mass=request.mass))
        spring = behind.add_joint(name="transmission", axis=(1, 0, 0))
        spring.stiffness = inertia * link.resonance**2, 0.0, 0.0
        spring.damping = inertia * link.damping, 0.0, 0.0
    joint = body.add_joint(name=JOINT, axis=(1, 0, 0))
    joint.damping = friction.viscous, value(model, "quadratic_drag") if "quadratic_drag" in held else 0.0, 0.0
    joint.frictionloss, joint.armature = friction.dry, request.armature
    joint.solref_friction, joint.solimp_friction = (STEPS * request.step, 1.0), IMPEDANCE
    if "spring" in held and (stiffness := value(model, "spring.stiffness")):
        joint.stiffness = stiffness, 0.0, 0.0
        joint.springref = math.degrees(-value(model, "spring.preload") / stiffness)
    if stop is not None:
        inertia = value(model, "inertia")
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = [math.degrees(end) for end in stop.ends]
        joint.solref_limit = -stop.stiffness / inertia, -stop.damping / inertia
        joint.solimp_limit = SOFT
    _drive(mujoco, spec, model, request)
    spec.compile()
    return Exported(spec.to_xml(), notes)


def _holds(model: Model, link: JointFlexibility) -> bool:
    """Whether there is a motor and a link in the model, each with an inertia of its own."""
    return 0.0 < value(model, link.id) < value(model, "inertia")


def _add(parent: Any, name: str, body: Body) -> Any:
    added = parent.add_body(name=name, mass=body.mass, ipos=body.centre, inertia=body.moments, explicitinertial=True)
    added.add_geom(
        name=name, fromto=(0.0, 0.0, 0.0, *(2.0 * x for x in body.centre)), size=(0.01, 0.0, 0.0), mass=0.0,
        type=3, contype=0, conaffinity=0,
    )  # fmt: skip
    return added


def _drive(mujoco: Any, spec: Any, model: Model, request: Request) -> None:
    """The actuator: torque with what lies between the command and the joint."""
    offset = value(model, "torque_offset") + value(model, "coulomb_asymmetry")
    drive = spec.add_actuator(name=ACTUATOR, target=JOINT, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    drive.set_to_motor()
    if offset:
        drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        drive.biasprm = [-offset, *([0.0] * 9)]
    delay = sum(term.delay for term in model.terms)
    for term in model.terms:
        if isinstance(term, ActuatorLag):
            drive.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
            drive.dynprm = [term.time_constant, *([0.0] * 9)]
            drive.actearly = True  # what the filter has reached at the end of a step acts in it: half a step early
            delay += 0.5 * request.step
    if delay:
        drive.delay, drive.interp = delay, 1  # between commands, as ours
        drive.nsample = math.ceil(delay / request.step) + 2
