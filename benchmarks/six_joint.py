"""Diagnoses of arms with two to seven joints and hidden effects, simulated by MuJoCo.

    python -m benchmarks.six_joint [RUNS [JOINTS]]

The arm is fictitious: links of plausible size, a rotor, and random viscous and dry friction at each joint; encoders of
2^20 counts; torque with noise. A position controller follows a multisine. Hidden friction changes MuJoCo's
`frictionloss`, other effects are applied torques. A verdict is right if it names only the effect, at its joint.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from estimators import compare, diagnose, identify
from estimators.schemes.six import scheme
from robots.arms import arm_base
from robots.arms.body import Body, read_body
from robots.arms.recording import ArmRecording

SEVEN = ("base", "shoulder", "elbow", "roll", "pitch", "flange", "tool")
JOINTS = SEVEN[:6]
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 0 1")
OFFSETS = ("0 0 0.15", "0 0.08 0.12", "0.38 0 0", "0.12 0 0.05", "0.22 0 0", "0.09 0 0", "0.07 0 0.02")
MASSES = (4.0, 5.5, 3.2, 1.6, 1.1, 0.5, 0.6)  # [kg]
CENTERS = (
    "0.01 0.02 0.06",
    "0.17 0.03 0.01",
    "0.06 -0.01 0.03",
    "0.09 0.005 -0.004",
    "0.03 0.01 0.006",
    "0.04 0.003 0.01",
    "0.06 0.02 0.03",
)
INERTIAS = (  # about the centres of mass, along the links' axes [kg m^2]
    (0.018, 0.016, 0.012),
    (0.014, 0.095, 0.09),
    (0.009, 0.016, 0.015),
    (0.003, 0.009, 0.008),
    (0.0016, 0.0021, 0.0019),
    (0.0006, 0.0009, 0.0008),
    (0.0005, 0.0011, 0.001),
)
VISCOUS = np.array([1.2, 1.5, 0.9, 0.3, 0.25, 0.1, 0.12])  # [N m s/rad]
COULOMB = np.array([2.0, 2.5, 1.6, 0.6, 0.5, 0.2, 0.25])  # [N m]
ROTORS = np.array([0.4, 0.5, 0.3, 0.08, 0.06, 0.02, 0.02])  # [kg m^2]
NOISE = np.array([0.05, 0.05, 0.04, 0.02, 0.02, 0.01, 0.01])  # [N m]
SWEEP = np.array([0.9, 0.5, 0.6, 0.9, 0.8, 1.1, 1.0])  # amplitude of the reference [rad]
MIDDLE = np.array([0.0, -0.6, 0.7, 0.0, 0.4, 0.0, 0.2])  # mean of the reference [rad]
STIFFNESS = np.array([600, 900, 500, 100, 70, 22.0, 22.0])  # [N m/rad], of the controller
DAMPING = np.array([35, 50, 25, 6, 4, 1.2, 1.2])  # [N m s/rad]
COUNTS = 2**20
RATE, STEP = 500.0, 2e-4  # [Hz], [s]
WARMER, WARM_UP = (
    np.array([18, 14, 16, 12, 15, 10.0, 9]),
    np.array([9, 12, 7, 10, 8, 11.0, 9]),
)  # [K], [s], of each joint
VISCOUS_SHARE, COULOMB_SHARE = -0.025, 0.012  # relative change of friction per kelvin, from 25 deg C
EFFECTS = ("stribeck", "cogging", "torque_offset", "quadratic_drag", "load_dependent_friction", "spring")


@dataclass(frozen=True)
class Load:
    """Body at the flange, in the frame of the flange."""

    mass: float  # [kg]
    center: tuple[float, float, float]  # [m]
    inertia: tuple[float, float, float]  # about its centre [kg m^2]


def urdf(load: Load | None = None, joints: Sequence[str] = JOINTS) -> str:
    """Return the arm as URDF, perhaps with a load at its last link."""
    text = [f'<robot name="{len(joints)}-joint"><link name="ground"/>']
    for k, joint in enumerate(joints):
        a, b, c = INERTIAS[k]
        text.append(
            f'<link name="link{k}"><inertial><origin xyz="{CENTERS[k]}"/><mass value="{MASSES[k]}"/>'
            f'<inertia ixx="{a}" ixy="0" ixz="0" iyy="{b}" iyz="0" izz="{c}"/></inertial></link>'
            f'<joint name="{joint}" type="revolute"><parent link="{f"link{k - 1}" if k else "ground"}"/>'
            f'<child link="link{k}"/><origin xyz="{OFFSETS[k]}"/><axis xyz="{AXES[k]}"/>'
            f'<limit lower="-3" upper="3" effort="120" velocity="6"/></joint>'
        )
    if load is not None:
        (x, y, z), (a, b, c) = load.center, load.inertia
        text.append(
            f'<link name="load"><inertial><origin xyz="{x} {y} {z}"/><mass value="{load.mass}"/>'
            f'<inertia ixx="{a}" ixy="0" ixz="0" iyy="{b}" iyz="0" izz="{c}"/></inertial></link>'
            f'<joint name="held" type="fixed"><parent link="link{len(joints) - 1}"/><child link="load"/></joint>'
        )
    return "".join([*text, "</robot>"])


@dataclass(frozen=True)
class Hidden:
    """Effect at a joint, or motor coupled to it and the next joint; `share`: size over the dry friction."""

    effect: str
    joint: int
    share: float = 0.35

    @property
    def name(self) -> str:
        """Return the name of the effect in a verdict."""
        count = 2 if self.effect == "coupling" else 1
        return f"{self.effect}@{','.join(SEVEN[self.joint : self.joint + count])}"

    def tie(self, spec: Any) -> None:
        """Add a motor coupled to two joints as a MuJoCo tendon, with the sum of both angles as its length."""
        if self.effect == "coupling":
            motor, j = spec.add_tendon(name="motor"), self.joint
            for joint in SEVEN[j : j + 2]:
                motor.wrap_joint(joint, 1.0)
            motor.damping[0], motor.frictionloss = 0.5 * VISCOUS[j], self.share * COULOMB[j]
            motor.armature = 0.3 * ROTORS[j + 1]

    def forces(self, rubs: float = 1.0) -> Callable[[float, float, float, float], tuple[float, float]]:
        """Return acting torque and dry friction from position, velocity, motor torque and temperature [K]."""
        dry, viscous = rubs * COULOMB[self.joint], rubs * VISCOUS[self.joint]
        size = self.share * dry

        def law(q: float, v: float, torque: float, warmer: float) -> tuple[float, float]:
            match self.effect:
                case "stribeck":
                    return 0.0, dry + 1.5 * size * float(np.exp(-((v / 0.2) ** 2)))
                case "cogging":
                    return -size * float(np.sin(14 * q + 0.4)), dry
                case "torque_offset":
                    return -size, dry
                case "quadratic_drag":
                    return -size * v * abs(v), dry
                case "load_dependent_friction":
                    return 0.0, dry + 0.08 * abs(torque)
                case "temperature_dependent_friction":
                    return -VISCOUS_SHARE * viscous * warmer * v, dry * (1.0 + COULOMB_SHARE * warmer)
                case "spring":
                    return -size * (q - 0.3), dry
                case "cable":  # local torque, outside the library
                    return -2.0 * size * float(np.exp(-(((q - MIDDLE[self.joint] - 0.1) / 0.15) ** 2))), dry
                case "coupling":
                    return 0.0, dry
            raise ValueError(self.effect)

        return law


def draw_reference(
    rng: np.random.Generator, sweep: np.ndarray, middle: np.ndarray
) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
    """Return a multisine of six harmonics (angles, speeds) with amplitudes `sweep` (n,) about `middle` (n,) [rad]."""
    harmonics = np.arange(1, 7)
    amplitude = rng.normal(size=(len(sweep), 6)) / harmonics**0.5
    amplitude *= (sweep / np.abs(amplitude).sum(axis=1))[:, None]
    phase, w = rng.uniform(0, 2 * np.pi, amplitude.shape), 2 * np.pi * harmonics / 7.3

    def reference(t: float) -> tuple[np.ndarray, np.ndarray]:
        inside = w * t + phase
        return middle + (amplitude * np.sin(inside)).sum(1), (amplitude * w * np.cos(inside)).sum(1)

    return reference


def simulate(
    seed: int,
    hidden: Hidden | Sequence[Hidden] = (),
    seconds: float = 20.0,
    load: Load | None = None,
    thermometers: bool = False,
    rubs: Sequence[float] = (1.0,) * len(JOINTS),
    rate: float = RATE,
    noise: Sequence[float] = NOISE,
) -> ArmRecording:
    """Record the arm in MuJoCo, perhaps with joint temperatures.

    `rubs`: factors of the friction, one for each joint; `rate`: of the log [Hz]; `noise`: of the torque [N m].
    """
    import mujoco

    rng, n = np.random.default_rng(seed), len(rubs)
    hidden = (hidden,) if isinstance(hidden, Hidden) else hidden
    spec = mujoco.MjSpec.from_string(urdf(load, SEVEN[:n]))
    for own in hidden:
        own.tie(spec)
    model = spec.compile()
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.dof_damping[:], model.dof_frictionloss[:] = rubs * VISCOUS[:n], rubs * COULOMB[:n]
    model.dof_armature[:] = ROTORS[:n]
    model.dof_solref[:], model.dof_solimp[:, :3] = (2 * STEP, 1.0), (0.95, 0.999, 1e-4)
    model.tendon_solref_fri[:], model.tendon_solimp_fri[:, :3] = model.dof_solref[:1], model.dof_solimp[:1, :3]
    data = mujoco.MjData(model)
    laws = [(own.joint, own.forces(rubs[own.joint])) for own in hidden]
    reference = draw_reference(rng, SWEEP[:n], MIDDLE[:n])

    data.qpos[:], data.qvel[:] = reference(0.0)
    substeps = round(1 / rate / STEP)
    time = np.arange(round(seconds / STEP / substeps)) * substeps * STEP
    positions, torques = np.empty((2, len(time), n))
    warmer = (WARMER * (1.0 - np.exp(-time[:, None] / WARM_UP)))[:, :n]  # (steps, n)
    for k, t in enumerate(time.tolist()):
        q, v = reference(t)
        mujoco.mj_forward(model, data)
        torque = data.qfrc_bias + STIFFNESS[:n] * (q - data.qpos) + DAMPING[:n] * (v - data.qvel)
        positions[k], torques[k] = data.qpos, torque
        for _ in range(substeps):
            data.qfrc_applied[:] = torque
            for j, law in laws:
                force, dry = law(float(data.qpos[j]), float(data.qvel[j]), float(torque[j]), float(warmer[k, j]))
                data.qfrc_applied[j] += force
                model.dof_frictionloss[j] = dry
            mujoco.mj_step(model, data)
    count = 2 * np.pi / COUNTS
    positions = np.round(positions / count) * count
    torques = torques + np.asarray(noise)[:n] * rng.normal(size=torques.shape)
    name = " ".join(own.name for own in hidden) or f"null {seed}"
    recording = ArmRecording.from_arrays(name, SEVEN[:n], time, positions, torques)
    return replace(recording, temperature=25.0 + warmer) if thermometers else recording


def body(joints: Sequence[str] = JOINTS) -> Body:
    """Return the links of the arm's file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(urdf(joints=joints))
        return read_body(path, rotors=True)


def draw_friction_factors(run: int, joints: int = 6) -> list[float]:
    """Draw the factors of friction of each joint for a run."""
    return np.random.default_rng(run).uniform(0.5, 1.6, joints).tolist()


def main(arguments: Sequence[str] = ()) -> int:
    runs, n = (int(given) for given in (*arguments, *("30", "6")[len(arguments) :]))
    if not 2 <= n <= len(SEVEN):
        raise SystemExit(f"the arm has 2 to {len(SEVEN)} joints")
    arm = body(SEVEN[:n])
    fitted, unseen = (simulate(seed, rubs=[1.0] * n) for seed in (1, 2))
    began = time.process_time()
    found = identify(fitted, arm_base(arm), [scheme("filtered_dynamic")])
    errors = compare(found["filtered_dynamic"].model, unseen).joint.errors
    print(
        f"{len(arm.base)} base parameters in {time.process_time() - began:.1f} s; held-out torque error of RMS torque:"
    )
    print("  " + ", ".join(f"{joint} {100 * share:.2f} %" for joint, share in errors.shares.items()))
    right = alarms = 0
    longest = 0.0
    hidden_ones = [Hidden(EFFECTS[run % 6], (run % 6 + run // 6) % n) for run in range(runs)]
    hidden_ones += [Hidden("coupling", run % (n - 1)) for run in range(runs // 6)]
    for run, hidden in enumerate(hidden_ones):
        recording = simulate(100 + run, hidden, rubs=draw_friction_factors(run, n))
        began = time.process_time()
        diagnosis = diagnose(recording, (), arm_base(arm))
        longest = max(longest, time.process_time() - began)
        right += diagnosis.selected == (recording.name,)
        print(f"{recording.name:32s} {', '.join(diagnosis.selected) or 'nothing'}", flush=True)
    for run in range(runs // 3):
        diagnosis = diagnose(simulate(200 + run, rubs=draw_friction_factors(100 + run, n)), (), arm_base(arm))
        alarms += bool(diagnosis.selected)
        print(f"{'nothing':32s} {', '.join(diagnosis.selected) or 'nothing'}", flush=True)
    print(f"named right: {right} of {len(hidden_ones)}; false alarms: {alarms} of {runs // 3}")
    print(f"longest diagnosis: {longest:.1f} s of one core")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
