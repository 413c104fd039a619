"""Arms of robot files in MuJoCo (extra `export`), for simulation and export.

Links are a tree of bodies on hinge and slide joints; equality constraints tie mimic joints. Viscous friction is
MuJoCo's implicit damping. Dry friction is its `frictionloss`, with the stiffness of `constrained_body`. Other effects
are evaluated at the start of a step. The scheme is of first order.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.backends.constrained_body import IMPEDANCE, STEPS, import_mujoco
from pendulum_env.physics import Model
from pendulum_env.physics.simulation import UNBOUNDED
from robots.arms.body import STANDARD, Body
from robots.arms.planar import JointBalances
from robots.arms.robot import import_pinocchio

TIE_IMPEDANCE = (0.999, 0.9999, 1e-4, 0.5, 2.0)  # impedance of the constraint between follower and leader


def build_specification(body: Body, standard: Array, friction: Mapping[str, tuple[float, float]]) -> Any:
    """Build the `MjSpec` of an arm from its standard parameters (S,).

    `friction` holds viscous [N m s/rad] and dry friction [N m] by joint.
    """
    mujoco, pin, model = import_mujoco(), import_pinocchio(), body.model
    spec = mujoco.MjSpec()
    spec.modelname = body.name
    spec.compiler.degree = False
    spec.option.gravity = model.gravity.linear
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    bodies, low, high = [spec.worldbody], model.lowerPositionLimit, model.upperPositionLimit
    rotors = dict(zip(body.joints, standard[len(STANDARD) * len(body.links) :], strict=False))
    for k, joint in enumerate(body.links):
        place = model.jointPlacements[k + 1]
        link = pin.Inertia.FromDynamicParameters(standard[len(STANDARD) * k : len(STANDARD) * (k + 1)])
        tensor = link.inertia
        body_spec = bodies[model.parents[k + 1]].add_body(
            name=f"{joint}_link",
            pos=place.translation,
            quat=pin.Quaternion(place.rotation).coeffs()[[3, 0, 1, 2]],
            mass=link.mass,
            ipos=link.lever,
            fullinertia=[*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]],
            explicitinertial=True,
        )
        bodies.append(body_spec)
        viscous, dry = friction.get(joint, (0.0, 0.0))
        body_spec.add_joint(
            name=joint,
            type=mujoco.mjtJoint.mjJNT_SLIDE if joint in body.prismatic_joints else mujoco.mjtJoint.mjJNT_HINGE,
            axis=np.ravel(model.joints[k + 1].createData().S).reshape(2, 3).sum(axis=0),  # one part is zero
            damping=[viscous, 0.0, 0.0],
            frictionloss=dry,
            solimp_friction=IMPEDANCE,
            armature=rotors.get(joint, 0.0),
            range=[low[k], high[k]] if np.isfinite([low[k], high[k]]).all() and low[k] < high[k] else [0.0, 0.0],
        )
    for k, follower in enumerate(body.links):
        if follower not in body.joints:
            (leader,) = np.flatnonzero(body.ratios[k])
            tie = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=follower, name2=body.joints[leader])
            tie.data[:5] = body.offsets[k], body.ratios[k, leader], 0.0, 0.0, 0.0
            tie.solimp = TIE_IMPEDANCE
    return spec


class SpatialBodies:
    """Simulated arm; positions and velocities are those of the independent joints."""

    longest_step = 2.5e-4  # [s]

    def __init__(self, body: Body, models: Sequence[Model], period: float) -> None:
        """Set the body, the models of the joints, and the sample time [s]."""
        self._steps = int(np.ceil(period / self.longest_step))
        self._h = period / self._steps
        viscous = {at: model.estimates["viscous"].value for at, model in zip(body.joints, models, strict=True)}
        spec = build_specification(body, body.standard_values, {at: (b, 1.0) for at, b in viscous.items()})
        mujoco = import_mujoco()
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
        spec.option.timestep = self._h
        self._body, self._world = body, spec.compile()
        self._world.dof_solref[:] = STEPS * self._h, 1.0
        self._world.eq_solref[:] = STEPS * self._h, 1.0
        self._joints = [int(self._world.joint(at).dofadr[0]) for at in body.joints]  # also of positions
        self._links = [int(self._world.joint(at).dofadr[0]) for at in body.links]
        self._balances = JointBalances(
            [replace(model, terms=tuple(term for term in model.terms if term.id != "viscous")) for model in models],
            self._h,
        )

    def start(self, position: Array, velocity: Array) -> None:
        """Put the joints at positions (n,) [rad] with velocities (n,) [rad/s], or m and m/s for linear joints."""
        body, self._data = self._body, import_mujoco().MjData(self._world)
        self._data.qpos[self._links] = body.ratios @ position + body.offsets
        self._data.qvel[self._links] = body.ratios @ velocity
        self._balances.start(self.position, self.velocity)

    @property
    def position(self) -> Array:
        """Return the joint positions (n,) [rad] or [m]."""
        return np.array(self._data.qpos[self._joints])

    @property
    def velocity(self) -> Array:
        """Return the joint velocities (n,) [rad/s] or [m/s]."""
        return np.array(self._data.qvel[self._joints])

    def advance(self, torque: Array) -> None:
        """Hold torques (n,) [N m], or forces [N], for one period."""
        world, data, mujoco = self._world, self._data, import_mujoco()
        for _ in range(self._steps):
            position, velocity, delayed = self.position, self.velocity, self._balances.delay_torque(torque)
            net, dry = self._balances.torques(position, velocity, delayed)
            data.qfrc_applied[self._joints], world.dof_frictionloss[self._joints] = net, dry
            mujoco.mj_step(world, data)
            np.clip(data.qvel, -UNBOUNDED, UNBOUNDED, out=data.qvel)
            self._balances.advance(position, velocity, delayed, 0.5 * (velocity + self.velocity))
