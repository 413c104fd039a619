"""Robots as they come: arms with grippers or a sliding torso, written as URDF, and their motion in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.six_joint import draw_reference

STEP, RATE = 2e-4, 500.0  # [s], [Hz]


@dataclass(frozen=True)
class Joint:
    """A joint and the link behind it; lengths in m, masses in kg, friction in N m s/rad and N m, or N s/m and N."""

    name: str
    parent: str  # joint before it, empty for the base
    axis: str
    place: str
    mass: float
    center: str
    inertia: tuple[float, float, float]
    slides: bool = False
    mimics: tuple[str, float, float] | None = None  # leader, multiplier, offset
    viscous: float = 0.0
    coulomb: float = 0.0
    sweep: float = 0.0  # of the reference, 0 for a joint that is held
    middle: float = 0.0


def finger(name: str, parent: str, side: int, slides: bool, **more) -> Joint:
    axis = f"0 {side} 0" if slides else f"0 0 {side}"
    place = f"0.02 {0.01 * side} -0.1"
    return Joint(name, parent, axis, place, 0.09, f"0.003 {0.012 * side} -0.04", (9e-5, 8e-5, 2e-5), slides, **more)


SHOULDER = Joint("shoulder", "", "0 1 0", "0 0 0.3", 2.4, "0.01 0.02 -0.18", (0.03, 0.031, 0.004),
                 viscous=0.8, coulomb=1.1, sweep=0.9, middle=0.2)  # fmt: skip
ELBOW = Joint("elbow", "shoulder", "0 1 0", "0 0.03 -0.4", 1.3, "0.02 -0.01 -0.14", (0.012, 0.013, 0.002),
              viscous=0.4, coulomb=0.6, sweep=1.0, middle=-0.4)  # fmt: skip
WRIST = Joint("wrist", "elbow", "1 0 0", "0 0 -0.3", 0.7, "0.005 0.01 -0.06", (0.004, 0.0035, 0.0012),
              viscous=0.15, coulomb=0.25, sweep=1.1)  # fmt: skip
PARALLEL = (  # the right finger as far out as the left one
    SHOULDER,
    ELBOW,
    finger("left", "elbow", 1, True),
    finger("right", "elbow", -1, True, mimics=("left", 1.0, 0.0)),
)
ANGULAR = (  # its second finger turns against the first one, a thumb follows that
    SHOULDER,
    ELBOW,
    WRIST,
    finger("left", "wrist", 1, False),
    finger("right", "wrist", 1, False, mimics=("left", -1.0, 0.1)),
    finger("thumb", "wrist", -1, True, mimics=("right", 0.02, 0.01)),
)
DRIVEN = (  # its gripper is heavy, and moves
    SHOULDER,
    Joint("jaw", "shoulder", "0 1 0", "0 0 -0.4", 0.8, "0.03 0.01 -0.12", (0.006, 0.0062, 0.001),
          viscous=0.2, coulomb=0.35, sweep=0.8, middle=0.5),
    Joint("other", "shoulder", "0 1 0", "0.05 0 -0.4", 0.5, "0.02 0.01 -0.1", (0.004, 0.0042, 0.001),
          mimics=("jaw", -1.2, 0.2)),
)  # fmt: skip
TORSO = (
    Joint("torso", "", "0 0 1", "0 0 0.4", 9.0, "0.02 0.01 0.1", (0.3, 0.25, 0.2), slides=True,
          viscous=60.0, coulomb=35.0, sweep=0.15, middle=0.2),
    Joint("shoulder", "torso", "0 1 0", "0.1 0 0.3", 2.4, "0.18 0.02 0.01", (0.004, 0.031, 0.03),
          viscous=0.8, coulomb=1.1, sweep=0.9, middle=0.2),
    Joint("elbow", "shoulder", "0 1 0", "0.4 0 0", 1.3, "0.14 -0.01 0.02", (0.002, 0.013, 0.012),
          viscous=0.4, coulomb=0.6, sweep=1.0, middle=-0.4),
    finger("left", "elbow", 1, True),
    finger("right", "elbow", -1, True, mimics=("left", 1.0, 0.0)),
)  # fmt: skip


def urdf(joints: Sequence[Joint], fixed: Mapping[str, float] | None = None) -> str:
    """The robot as a file, with some joints fixed where they are told to be."""
    text = ['<robot name="own"><link name="ground"/>']
    for own in joints:
        a, b, c = own.inertia
        kind, place, turn = ("prismatic" if own.slides else "revolute"), own.place, "0 0 0"
        axis = np.array(own.axis.split(), dtype=float)
        if fixed is not None and own.name in fixed:
            kind, at = "fixed", fixed[own.name] * axis
            x = np.array(own.place.split(), dtype=float) + (at if own.slides else 0.0)
            place, turn = (" ".join(map(str, v)) for v in (x, 0 * at if own.slides else at))  # about one axis of three
        before, tie = f"{own.parent}_link" if own.parent else "ground", ""
        if own.mimics is not None and kind != "fixed":
            leader, ratio, offset = own.mimics
            tie = f'<mimic joint="{leader}" multiplier="{ratio}" offset="{offset}"/>'
        text.append(
            f'<link name="{own.name}_link"><inertial><origin xyz="{own.center}"/><mass value="{own.mass}"/>'
            f'<inertia ixx="{a}" ixy="0" ixz="0" iyy="{b}" iyz="0" izz="{c}"/></inertial></link>'
            f'<joint name="{own.name}" type="{kind}"><parent link="{before}"/>'
            f'<child link="{own.name}_link"/><origin xyz="{place}" rpy="{turn}"/><axis xyz="{own.axis}"/>'
            f'<limit lower="-3" upper="3" effort="900" velocity="6"/>{tie}</joint>'
        )
    return "".join([*text, "</robot>"])


def positions(joints: Sequence[Joint], held: Mapping[str, float]) -> dict[str, float]:
    """Where all joints are that do not move, those that mimic others included."""
    found: dict[str, float] = {}
    for own in joints:
        if own.mimics is None and own.sweep == 0.0:
            found[own.name] = held.get(own.name, 0.0)
        elif own.mimics is not None and own.mimics[0] in found:
            leader, ratio, offset = own.mimics
            found[own.name] = ratio * found[leader] + offset
    return found


def simulate(
    joints: Sequence[Joint],
    held: Mapping[str, float],
    seed: int = 0,
    seconds: float = 10.0,
    hidden: Mapping[str, Callable[[float], float]] | None = None,
) -> dict[str, np.ndarray]:
    """Columns of a recording in MuJoCo: position and torque of each joint that moves, positions of the others."""
    rng, spec = np.random.default_rng(seed), mujoco.MjSpec.from_string(urdf(joints))
    for own in joints:  # MuJoCo's own constraints hold and tie joints
        if own.sweep == 0.0:
            tie = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=own.name)
            tie.solref, tie.solimp[:3] = (2 * STEP, 1.0), (0.999, 0.9999, 1e-4)
            tie.data[:5] = held.get(own.name, 0.0), 0, 0, 0, 0
            if own.mimics is not None:
                tie.name2, (_, ratio, offset) = own.mimics[0], own.mimics
                tie.data[:5] = offset, ratio, 0, 0, 0
    model = spec.compile()
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    where = {own.name: int(model.joint(own.name).qposadr[0]) for own in joints}
    for own in joints:
        model.dof_damping[where[own.name]], model.dof_frictionloss[where[own.name]] = own.viscous, own.coulomb
    model.dof_solref[:], model.dof_solimp[:, :3] = (2 * STEP, 1.0), (0.95, 0.999, 1e-4)
    data, moving = mujoco.MjData(model), [own for own in joints if own.sweep]
    order = [where[own.name] for own in moving]
    reference = draw_reference(rng, np.array([own.sweep for own in moving]), np.array([own.middle for own in moving]))
    still = positions(joints, held)
    data.qpos[order], data.qvel[order] = reference(0.0)
    for own in joints:
        if own.name in still:
            data.qpos[where[own.name]] = still[own.name]
        elif own.mimics is not None:
            leader, ratio, offset = own.mimics
            data.qpos[where[own.name]] = ratio * data.qpos[where[leader]] + offset
            data.qvel[where[own.name]] = ratio * data.qvel[where[leader]]
    mujoco.mj_forward(model, data)
    heavy = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, heavy)
    inertia = 1.5 * np.diag(heavy)[order] + 0.01
    steps, substeps = round(seconds * RATE), round(1 / RATE / STEP)
    every, torques = np.empty((steps, model.nq)), np.empty((steps, len(moving)))
    for k in range(steps):
        q, v = reference(k / RATE)
        mujoco.mj_forward(model, data)
        off, rate = q - data.qpos[order], v - data.qvel[order]
        torque = data.qfrc_bias[order] + inertia * (900.0 * off + 60.0 * rate)
        every[k], torques[k] = data.qpos, torque
        for _ in range(substeps):
            data.qfrc_applied[order] = torque
            for name, force in (hidden or {}).items():
                data.qfrc_applied[where[name]] += force(float(data.qvel[where[name]]))
            mujoco.mj_step(model, data)
    torques += 0.004 * np.abs(torques).max(axis=0) * rng.normal(size=torques.shape)
    columns = {"time": np.arange(steps) / RATE}
    columns |= {f"position_{own.name}": every[:, where[own.name]] for own in joints}
    return columns | {f"torque_{own.name}": torques[:, k] for k, own in enumerate(moving)}


def write(columns: Mapping[str, np.ndarray], path) -> None:
    """A recording as CSV."""
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
