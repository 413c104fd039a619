"""Check of an exported model: MuJoCo and this project's simulation against recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.in_loop.rollouts import GRAIN, Rollouts
from estimators.in_loop.servos import are_driven
from estimators.signals.motion import get_load_in_newton_metres
from estimators.simulation.free_running import Segments, simulate_all, start_memory
from estimators.weak_form.point import Point
from pendulum_env._typing import Array
from pendulum_env.backends.constrained_body import import_mujoco
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from pendulum_env.servo.loop import Servos
from workbench.export import mjcf
from workbench.export.request import Exported, ExportError, Request
from workbench.export.servo import Motor, Servo, choose_actuator


@dataclass(frozen=True)
class CheckResult:
    """Deviations of simulations from recordings [rad]."""

    title: str  # definition of the deviations
    errors: Mapping[str, float]  # by pair of compared motions
    motion: float  # the same measure of the recorded position about its mean


def check(model: Model, exported: Exported, request: Request, recordings: Sequence[Recording]) -> CheckResult:
    """Compare the exported model in MuJoCo with recordings; a servo is simulated from their goals.

    Raises ExportError if a recording has a known load, IdentificationError if it has too little motion, and
    ModuleNotFoundError if the extra `export` is not installed.
    """
    for recording in recordings:
        if get_load_in_newton_metres(recording):
            raise ExportError(f"{recording.name}: a known load acted on the joint: check with a recording without one")
    return CHECKS[type(choose_actuator(model, request))](model, exported, request, recordings)


def _check_free_runs(
    model: Model, exported: Exported, request: Request, recordings: Sequence[Recording]
) -> CheckResult:
    """Compare free motion over windows that start from the measured state."""
    segments = RegressionData.from_recordings(recordings).with_link_states(model).segments
    simulated = [path[:, 0] for path in simulate_all(segments, [Point.from_model(model)])]
    theirs = [_simulate(model, exported, segment) for segment in segments]
    measured = [segment.position for segment in segments]
    errors = {
        "this project's simulation against the recording": _compute_rms(simulated, measured),
        "MuJoCo with the exported model against the recording": _compute_rms(theirs, measured),
        "one against the other": _compute_rms(theirs, simulated),
    }
    motion = _compute_rms(measured, [q.mean(0) for q in measured])
    return CheckResult("Free run over windows of one second, RMS", errors, motion)


def _check_in_loop(model: Model, exported: Exported, request: Request, recordings: Sequence[Recording]) -> CheckResult:
    """Compare whole recordings of servos, each simulated with its recorded drive.

    Raises ExportError if a recording has no goal, or `GRAIN` is not a multiple of the step.
    """
    if not are_driven(recordings):
        raise ExportError(f"{recordings[0].name}: has no goal: a servo is checked in the loop alone")
    steps = round(GRAIN / request.step)
    if abs(steps * request.step - GRAIN) > 1e-9:
        raise ExportError(f"positions are compared every {GRAIN:g} s: --step should be a whole part of it, as 0.001")
    # MuJoCo's controller reads the exact position
    rollouts = Rollouts(tuple(recordings), steps, grain=GRAIN).without_counts
    simulated = rollouts.compute_position_errors([Point(model.terms, model.theta)])
    theirs = rollouts.compare_paths(_simulate_servos(model, request, rollouts.servos, steps))
    errors = {
        "this project's simulation": _compute_mean_size(simulated),
        "MuJoCo with what is exported": _compute_mean_size(theirs),
    }
    motion = _compute_mean_size(rollouts.position - rollouts.position.mean())
    return CheckResult("In the loop, whole recordings from their goals alone, mean error", errors, motion)


CHECKS = {Motor: _check_free_runs, Servo: _check_in_loop}


def _compute_mean_size(values: Array) -> float:
    return float(np.mean(np.abs(values)))


def _simulate_servos(model: Model, request: Request, servos: Servos, interval: int) -> Array:
    """Simulate B servos over N steps in MuJoCo; return every `every`-th position, (N / every + 1, 1, B) [rad]."""
    mujoco = import_mujoco()
    drives = [  # default supply: the first recorded value
        drive if drive.supply or drive.output != "duty" else replace(drive, supply=float(servos.supply[0, lane]))
        for lane, drive in enumerate(servos.drives)
    ]
    models = {drive: mjcf.export(model, request, Servo(drive)) for drive in dict.fromkeys(drives)}
    paths = np.empty((len(servos.goal) // interval + 1, 1, len(drives)))
    for lane, drive in enumerate(drives):
        world = mujoco.MjModel.from_xml_string(models[drive].content)
        data = mujoco.MjData(world)
        data.qpos[0], data.qvel[0] = servos.position[lane], servos.velocity[lane]
        paths[0, 0, lane] = data.qpos[0]
        for k, (goal, on) in enumerate(zip(servos.goal[:, lane].tolist(), servos.is_on[:, lane].tolist(), strict=True)):
            data.ctrl[0] = goal
            world.opt.disableactuator = int(not on)  # bit 0: default group of actuators
            mujoco.mj_step(world, data)
            if (k + 1) % interval == 0:
                paths[(k + 1) // interval, 0, lane] = data.qpos[0]
    return paths


def _compute_rms(first: Sequence[Array], second: Sequence[Array]) -> float:
    """Compute the root mean square of the differences of paths (N + 1, B) without their start."""
    differences = [(a - b)[1:].ravel() for a, b in zip(first, second, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))


def _simulate(model: Model, exported: Exported, segments: Segments) -> Array:
    """Simulate every segment in MuJoCo; return positions (N + 1, B) [rad]."""
    mujoco = import_mujoco()
    world = mujoco.MjModel.from_xml_string(exported.content)
    rate = segments.windows.recording.rate
    count = max(1, int(np.ceil(1.0 / (rate * world.opt.timestep) - 1e-9)))
    world.opt.timestep = 1.0 / (rate * count)
    traced_terms = [term for term in model.terms if term.has_memory and not term.delay]
    memory = {id: states for term in traced_terms for id, states in start_memory([segments], [term]).items()}
    path = np.empty_like(segments.position)
    for k in range(path.shape[1]):
        data = mujoco.MjData(world)
        _set_initial_state(
            mujoco, world, data, segments, {id: [part[k] for part in parts] for id, parts in memory.items()}, k
        )
        path[0, k] = data.qpos[0]
        for n, torque in enumerate(segments.torque[:, k]):
            data.ctrl[0] = torque
            for _ in range(count):
                mujoco.mj_step(world, data)
            path[n + 1, k] = data.qpos[0]
    return path


def _set_initial_state(
    mujoco: Any, world: Any, data: Any, segments: Segments, memory: Mapping[str, Sequence[float]], k: int
) -> None:
    """Set the joint and its internal states to the start of segment `k`."""
    data.qpos[0], data.qvel[0] = segments.position[0, k], segments.velocity[k]
    if world.nq > 1:  # the link's angle is relative to the motor's
        position, velocity = memory["joint_flexibility"]
        data.qpos[1], data.qvel[1] = position - data.qpos[0], velocity - data.qvel[0]
    if world.na:
        data.act[0] = memory["actuator_lag"][0]
    if world.actuator_delay[0]:
        samples = int(world.actuator_history[0][0])
        times = (np.arange(samples) - samples) * world.opt.timestep
        rate, first = segments.windows.recording.rate, segments.first[k]
        index = first + np.floor(times * rate + 1e-9).astype(int)
        values = np.where(index >= 0, segments.windows.recording.torque[np.maximum(index, 0)], 0.0)
        mujoco.mj_initCtrlHistory(world, data, 0, times[:, None], values[:, None])
