"""The MuJoCo backend: a body on a hinge, whose dry friction is MuJoCo's own constraint.

All other torques are the model's terms, taken at the start of a step, after which MuJoCo moves on by its semi-implicit
Euler rule: first order in the step, where the pymunk backend is second order.

MuJoCo's `frictionloss` is regularised, as all its constraints: a joint that should stick creeps with the speed
(1 - d) T tau / (2 I), tau being the torque it holds, T the constraint's time constant and d its impedance, near 1. Both
are at MuJoCo's bounds here, T two steps and d 0.9999: under 0.5 N m the paper's arm creeps by 0.6 urad/s, with MuJoCo's
defaults of 20 ms and 0.9 by 5.7 mrad/s, and in the pymunk backend, where friction is set-valued, not at all. Over 30 s
of the paper's excitation at 1 ms the motion is 2.3 mrad RMS off, 0.17 % of it, with the defaults 17 mrad, 1.3 %; four
substeps leave 0.6 mrad. A step takes about 15 us, 6 us more than pymunk's. Source: MuJoCo's documentation, chapter
Computation, on the constraint model.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from pendulum_env.physics import Samples
from pendulum_env.physics.simulation import UNBOUNDED, TorqueBalance

# Of the friction constraint, near its bound of 1: it takes all that friction can hold.
IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
STEPS = 2.0  # time constant of the friction, in steps; MuJoCo's own lower bound


class ConstrainedBody:
    """Pendulum in MuJoCo, as the engine of a simulator."""

    def __init__(self, balance: TorqueBalance, longest: float) -> None:
        """Take the torques that act on it; steps may be of any length.

        Raises:
            ModuleNotFoundError: if the extra `export` is not installed.
        """
        import_mujoco()
        self._balance = balance

    def take(self, balance: TorqueBalance) -> None:
        """Go on from where it is with other torques, of terms with the same state variables."""
        self._balance = balance

    def place(self, x: Samples) -> None:
        """Put a new body there."""
        mujoco = import_mujoco()
        spec = mujoco.MjSpec()
        spec.option.gravity = (0.0, 0.0, 0.0)  # it comes from the model's term, as every other torque
        inertia = (float(self._balance.mass(x)),) * 3
        joint = spec.worldbody.add_body(mass=1.0, inertia=inertia, explicitinertial=True).add_joint(axis=(1, 0, 0))
        joint.solimp_friction = IMPEDANCE
        self._world: Any = spec.compile()
        self._data: Any = mujoco.MjData(self._world)
        self._data.qpos[0], self._data.qvel[0] = x.position, x.velocity
        self._x = x

    def step(self, torque: float, h: float) -> tuple[float, float]:
        """Advance by h [s] under a torque [N m]; returns angle [rad] and velocity [rad/s]."""
        command: Any = np.float64(torque)
        world, data, balance, x = self._world, self._data, self._balance, replace(self._x, torque=command)
        world.opt.timestep = h
        world.dof_solref[0] = STEPS * h, 1.0
        world.dof_frictionloss[0] = max(float(balance.dry(x)), 0.0)
        world.dof_M0[0] = balance.mass(x)  # where MuJoCo keeps the inertia of a body with one joint
        data.qfrc_applied[0] = balance.net(x)
        import_mujoco().mj_step(world, data)
        reached = min(max(data.qvel[0], -UNBOUNDED), UNBOUNDED)
        data.qvel[0] = reached
        moved: Any = np.float64(data.qpos[0])
        velocity: Any = np.float64(reached)
        memory = balance.advance(x, 0.5 * (x.velocity + velocity), h)
        self._x = Samples(x.time + h, moved, velocity, x.torque, memory)
        return float(moved), float(velocity)


def import_mujoco() -> Any:
    """Import MuJoCo where it is needed."""
    try:
        import mujoco
    except ModuleNotFoundError:
        raise ModuleNotFoundError("MuJoCo is needed for this: pip install 'pendulum-ident[export]'") from None
    return mujoco
