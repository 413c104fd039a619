"""Comparison with MuJoCo's identification toolbox: rotors and friction of six joints from one recording.

    pip install 'mujoco[sysid]'
    python -m benchmarks.sysid [SECONDS]

`mujoco.sysid` fits simulated angles by least squares. It gets the true links, time step, integrator, solver and hold of
the torque, and starts at half of each unknown value. It simulates pieces of 0.5 s from our filtered angles and
velocities, because an arm without its controller soon leaves the recording. Our method fits base parameters and
friction to torque, and computes the rotors by the links of the file. Times are CPU times of all cores.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.six_joint import COULOMB, JOINTS, RATE, ROTORS, STEP, VISCOUS, body, simulate, urdf
from estimators import identify
from estimators.schemes.balance import stack_motion
from estimators.schemes.six import scheme
from estimators.signals.measurements import measure_joints
from robots.arms import arm_base
from robots.arms.recording import ArmRecording

TRUTH = {"armature": np.array(ROTORS), "damping": np.array(VISCOUS), "frictionloss": np.array(COULOMB)}
PIECE = 0.5  # length of one simulation [s]


def fit_base_parameters(recording: ArmRecording) -> dict[str, np.ndarray]:
    """Return each quantity of each joint (6,)."""
    arm = body()
    estimates = identify(recording, arm_base(arm), [scheme("filtered_dynamic")])["filtered_dynamic"].model.estimates
    links = [estimates[name] for name in arm.names]
    weights = 1.0 / np.array([estimate.std for estimate in links])
    off = np.array([estimate.value for estimate in links]) - arm.values
    of_rotors = arm.combine[:, 10 * len(JOINTS) :]
    rotors = np.linalg.lstsq(of_rotors * weights[:, None], off * weights, rcond=None)[0]
    viscous, coulomb = (
        np.array([estimates[f"{name}@{joint}"].value for joint in JOINTS]) for name in ("viscous", "coulomb")
    )
    return {"armature": rotors, "damping": viscous, "frictionloss": coulomb}


def fit_simulation(recording: ArmRecording) -> dict[str, np.ndarray]:
    """Return each quantity of each joint (6,)."""
    import mujoco
    from mujoco import sysid

    spec = mujoco.MjSpec.from_string(urdf())
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    for name in JOINTS:
        joint = spec.joint(name)
        joint.solref_friction, joint.solimp_friction[:3] = (2 * STEP, 1.0), (0.95, 0.999, 1e-4)
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gainprm[0] = 1.0
        sensor, of = mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtObj.mjOBJ_JOINT
        spec.add_sensor(name=f"{name}_angle", type=sensor, objtype=of, objname=name)
    params = sysid.ParameterDict()
    for quantity, values in TRUTH.items():
        for name, value in zip(JOINTS, values.tolist(), strict=True):
            params.add(sysid.Parameter(f"{quantity}@{name}", value / 2, 0.0, 5 * value, modifier=_set))
    model = spec.compile()
    angles = sysid.TimeSeries.compute_all_state_mappings(model)[0]
    (joints,) = measure_joints(recording.joints)
    position, velocity, _ = stack_motion(joints)
    first, length, substeps = len(recording) - len(position) >> 1, round(PIECE * RATE), round(1 / RATE / STEP)
    pieces = []
    for begin in range(0, len(position) - length, length):
        own = slice(first + begin, first + begin + length)
        held = np.repeat(recording.torque[own], substeps, axis=0)
        state = sysid.create_initial_state(model, position[begin], velocity[begin])
        control = sysid.TimeSeries.from_control_names(np.arange(len(held)) * STEP, held, model)
        pieces.append((state, control, sysid.TimeSeries(np.arange(length) / RATE, recording.position[own], angles)))
    states, controls, measured = zip(*pieces, strict=True)
    names = [str(k) for k in range(len(pieces))]
    sequences = sysid.ModelSequences("arm", spec, names, states, controls, measured)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    found, _ = sysid.optimize(params, residual, optimizer="mujoco", verbose=False)
    return {quantity: np.array([found[f"{quantity}@{name}"].value[0] for name in JOINTS]) for quantity in TRUTH}


def _set(spec: Any, parameter: Any) -> None:
    """Write a parameter such as `damping@elbow` into a specification; higher orders of damping are zero."""
    quantity, _, joint = parameter.name.partition("@")
    value = np.zeros_like(np.asarray(getattr(spec.joint(joint), quantity), dtype=float))
    value.flat[0] = parameter.value[0]
    setattr(spec.joint(joint), quantity, value if value.ndim else float(value))


def main(arguments: Sequence[str] = ()) -> int:
    recording = simulate(1, seconds=float(arguments[0]) if arguments else 10.0)
    for name, method in (("robots.arms", fit_base_parameters), ("mujoco.sysid", fit_simulation)):
        began = time.process_time()
        found = method(recording)
        print(f"{name}: {time.process_time() - began:.1f} s, error by joint")
        for quantity, truth in TRUTH.items():
            print(f"  {quantity:13s}" + "".join(f"{100 * e:8.2f} %" for e in found[quantity] / truth - 1))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
