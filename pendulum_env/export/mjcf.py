"""Export of a joint to MJCF by MuJoCo's `MjSpec`.

MuJoCo regularises dry friction: a sticking joint creeps at a speed proportional to the torque. A stop is a soft
constraint. The constants below make both as stiff as the solver allows at the step of the file.

Motion determines the inertia about the axis and the gravity torque, not mass, lever and central inertia separately.
Unless the mass is given, the pendulum is a uniform rod; any other choice has the same motion.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from pendulum_env._typing import Array
from pendulum_env.backends.constrained_body import IMPEDANCE, STEPS, import_mujoco
from pendulum_env.export.actuators import JointActuator
from pendulum_env.export.request import Exported, ExportError, Request, escape_comment, note_missing, write_title
from pendulum_env.export.sizes import SPEEDS, describe_size
from pendulum_env.physics import Model, Samples
from pendulum_env.physics.effect_texts import find_description
from pendulum_env.physics.potential import HardStop
from pendulum_env.physics.transmission import JointFlexibility
from pendulum_env.recording.channel import NEWTON_METRE

JOINT, ACTUATOR = "joint", "torque"  # names in the file
BODILY = ("quadratic_drag", "spring", "hard_stop")  # effects of a single joint in MuJoCo, in addition to `EVERY`
# Impedance of the stop: MuJoCo's lower bound 0.0001. A constraint of impedance d removes the share d of other
# accelerations; a small d adds a torque as a spring does.
SOFT = (1e-4, 1e-4, 0.001, 0.5, 2.0)
G = 9.81  # [m/s^2]
FAR = 1e4  # position of an inactive stop [rad]
EVERY = ("inertia", "gravity", "gravity_tilt", "viscous", "coulomb", "back_emf")  # terms that MuJoCo represents exactly


@dataclass(frozen=True)
class RigidBody:
    """Rigid body on a horizontal hinge along x; at q = 0 its centre of mass hangs down, except for a tilt."""

    mass: float  # [kg]
    lever: float  # from the axis to the centre of mass [m]
    tilt: float  # angle of the centre of mass at q = 0 [rad]
    inertia: float  # about the centre of mass [kg m^2]

    @property
    def centre(self) -> tuple[float, float, float]:
        """Return the centre of mass at q = 0 [m]."""
        return 0.0, self.lever * math.sin(self.tilt), -self.lever * math.cos(self.tilt)

    @property
    def moments(self) -> tuple[float, float, float]:
        """Return the central moments of inertia of a rod about x (the hinge), y and z [kg m^2]."""
        return self.inertia, self.inertia, 0.01 * self.inertia  # about its length: 1 % of that about the hinge

    @classmethod
    def from_pendulum(cls, inertia: float, gravity: float, tilted: float = 0.0, mass: float | None = None) -> RigidBody:
        """Return the body with an inertia about the axis [kg m^2] and the torque gravity sin q + tilted cos q.

        Raises ExportError if the given mass [kg] is too small, or no inertia remains after the armature.
        """
        if inertia <= 0:
            raise ExportError("the armature leaves the pendulum no inertia: give a smaller --armature")
        weight = math.hypot(gravity, tilted)  # gravity torque of the horizontal pendulum [N m]
        least_mass = weight**2 / (G**2 * inertia)  # mass of a point at the end of the lever [kg]
        # a uniform rod has 4/3 of the mass of a point with equal inertia and gravity torque
        mass = mass or 4.0 / 3.0 * least_mass or 1.0
        lever = weight / (mass * G)
        central = inertia - mass * lever**2
        if central <= 0:
            raise ExportError(
                f"a mass of {mass:g} kg cannot have this weight and inertia: --mass has to be above {least_mass:.4g}"
            )
        return cls(mass, lever, math.atan2(tilted, gravity), central)


def get_value(model: Model, parameter: str) -> float:
    """Return the value of a linear parameter of the model, 0 if it is missing."""
    return model.estimates[parameter].value if parameter in model.estimates else 0.0


def is_spring_linear(model: Model) -> bool:
    """Return whether MuJoCo's linear spring represents the spring of the model."""
    return get_value(model, "spring.stiffness") >= 0 and "spring.cubic" not in model.estimates


@dataclass(frozen=True)
class Friction:
    """Friction parameters of MuJoCo, and the friction of the model that they approximate."""

    viscous: float  # [N m s/rad]
    dry: float  # [N m]
    missing: tuple[str, ...]  # parts of the model that are missing or approximated

    @classmethod
    def from_model(cls, model: Model, included: Collection[str], speeds: Array = SPEEDS, load: float = 0.0) -> Friction:
        """Return the friction of a model; terms in `included` and `EVERY` are represented elsewhere.

        Other friction laws are approximated by symmetric viscous and dry friction, by a fit over `speeds` [rad/s].
        Friction that follows the torque is that at a typical `load` [N m], and left out without one.
        """
        unit = model.torque_unit
        remaining = [term for term in model.terms if term.id not in EVERY and term.id not in included]
        at_load = {term.id for term in remaining if load and any(column.of_torque for column in term.columns)}
        approximated_terms = [t for t in remaining if t.id in at_load or find_description(t.id).fits_friction]
        omissions = [] if unit == NEWTON_METRE else [f"a torque in {unit}: masses and inertias are those per {unit}"]
        omitted_terms = [term for term in remaining if term not in approximated_terms]
        omissions += [
            f"{term.id} ({term.law}; {describe_size(model, term)}): {find_description(term.id).omission}"
            for term in omitted_terms
        ]
        viscous, dry = get_value(model, "viscous") + get_value(model, "back_emf"), get_value(model, "coulomb")
        if not approximated_terms and min(viscous, dry) >= 0:
            return cls(viscous, dry, tuple(omissions))
        zeros = np.zeros_like(speeds)
        law = viscous * speeds + dry
        for column in (column for term in approximated_terms for column in term.columns):
            ways = [column.torque(Samples(zeros, zeros, v, zeros + load), 0.0) for v in (speeds, -speeds)]
            law = law + 0.5 * model.estimates[column.name].value * (ways[0] - ways[1])
        (viscous, dry), _ = scipy.optimize.nnls(np.column_stack([speeds, np.ones_like(speeds)]), law)
        typical = f" at a load of {load:.2g} {model.units().unit('N m')}" if at_load else ""
        kinds = [f"{t.id} ({t.law}){typical * (t.id in at_load)}" for t in approximated_terms]
        kinds = kinds or ["friction below zero"]
        error = float(np.abs(viscous * speeds + dry - law).max())
        units = model.units()
        close = (
            f"viscous and dry friction come closest to the sum up to {speeds[-1]:g} {units.unit('rad/s')}, within "
            f"{error:.2g} {units.unit('N m')}"
        )
        return cls(float(viscous), float(dry), (*omissions, *(f"{kind}: {close}" for kind in kinds)))


@dataclass(frozen=True)
class Stop:
    """Elastic and damped limits of the angle; an infinite limit is inactive."""

    lower: float = -math.inf  # [rad], -inf: none
    upper: float = math.inf
    stiffness: float = 0.0  # [N m/rad]
    damping: float = 0.0  # [N m s/rad]
    missing: tuple[str, ...] = ()  # parts of the model's stop that are left out

    @property
    def is_there(self) -> bool:
        """Return whether a limit is active."""
        return math.isfinite(self.lower) or math.isfinite(self.upper)

    @property
    def ends(self) -> tuple[float, float]:
        """Return the lower and upper limit [rad], finite as MuJoCo requires."""
        return max(self.lower, -FAR), min(self.upper, FAR)

    @classmethod
    def from_model(cls, model: Model, speed: float = 1.0) -> Stop:
        """Return the stop of a model.

        A hysteresis is replaced by the damper with the same restitution at an impact speed [rad/s]. A spring with a
        small damping ratio z returns the share exp(-pi z) of the speed.
        """
        stop = next((term for term in model.terms if isinstance(term, HardStop)), None)
        stiffness = get_value(model, "hard_stop.stiffness")
        if stop is None:
            return cls()
        damping, missing = stiffness * stop.damping_time, []
        if stop.hysteresis:
            lost_share = min(2.0 * stop.hysteresis * speed / 3.0, 0.9)
            ratio = -math.log(1.0 - lost_share) / math.pi
            damping += 2.0 * ratio * math.sqrt(stiffness * get_value(model, "inertia"))
            missing.append(f"the hysteresis of hard_stop: a damper loses as much of an impact at {speed:g} rad/s")
        return cls(stop.lower, stop.upper, stiffness, damping, tuple(missing))


def export(model: Model, request: Request, actuator: JointActuator) -> Exported:
    """Write the XML of a model.

    Raises ExportError if MuJoCo cannot represent the model and approximations are not allowed, and
    ModuleNotFoundError if the extra `export` is not installed.
    """
    mujoco = import_mujoco()
    links = [term for term in model.terms if isinstance(term, JointFlexibility)]
    # motor and link are two bodies: both need a positive inertia
    link = next((term for term in links if 0.0 < get_value(model, term.id) < get_value(model, "inertia")), None)
    held = {*BODILY, *([] if link is None else [link.id])}
    if get_value(model, "quadratic_drag") < 0:  # MuJoCo's dampers only dissipate
        held.remove("quadratic_drag")
    if not is_spring_linear(model):
        held.remove("spring")
    held |= set(actuator.list_held(model))
    friction, stop = Friction.from_model(model, held), Stop.from_model(model)
    rubs = link is not None and (link.friction or link.viscous)
    approximations = ("friction of the link: all friction acts at the motor",) if rubs else ()
    missing = (*friction.missing, *stop.missing, *actuator.missing, *approximations)
    notes = note_missing(missing, request)
    spec = mujoco.MjSpec()
    spec.modelname, spec.comment = "pendulum", escape_comment((write_title(model), *notes))
    spec.option.timestep = request.step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    total, gravity, tilted = (get_value(model, name) for name in ("inertia", "gravity", "gravity_tilt"))
    total -= request.armature
    if link is None:
        body = _add(spec.worldbody, "arm", RigidBody.from_pendulum(total, gravity, tilted, request.mass))
    else:
        inertia = get_value(model, link.id)  # of the link [kg m^2]
        rotor = RigidBody.from_pendulum(total - inertia, gravity - inertia * link.gravity, tilted)
        body = _add(spec.worldbody, "motor", rotor)
        link_body = _add(body, "link", RigidBody.from_pendulum(inertia, inertia * link.gravity, mass=request.mass))
        spring = link_body.add_joint(name="transmission", axis=(1, 0, 0))
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
    add_actuator(spec, ACTUATOR, JOINT, actuator, model)
    spec.compile()
    return Exported(spec.to_xml(), notes)


def add_actuator(spec: Any, name: str, joint: str, actuator: JointActuator, model: Model) -> None:
    """Add an actuator at a joint of a specification, with the torque offset of the joint's model."""
    mujoco = import_mujoco()
    offset = get_value(model, "torque_offset") + get_value(model, "coulomb_asymmetry")
    motor = spec.add_actuator(name=name, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.actuate(mujoco, motor, model, offset)
    if offset:
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        motor.biasprm = [-offset, *motor.biasprm[1:]]


def _add(parent: Any, name: str, body: RigidBody) -> Any:
    link = parent.add_body(name=name, mass=body.mass, ipos=body.centre, inertia=body.moments, explicitinertial=True)
    link.add_geom(
        name=name, fromto=(0.0, 0.0, 0.0, *(2.0 * x for x in body.centre)), size=(0.01, 0.0, 0.0), mass=0.0,
        type=3, contype=0, conaffinity=0,
    )  # fmt: skip
    return link
