"""Check of an exported servo: MuJoCo and this project's simulation in the loop against recordings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.weak_form.point import Point
from pendulum_env._typing import Array
from pendulum_env.backends.constrained_body import import_mujoco
from pendulum_env.export import mjcf
from pendulum_env.export.exporter import CheckResult
from pendulum_env.export.request import ExportError, Request
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from robots.servos.exported_servo import Servo
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.servos import are_driven
from robots.servos.in_loop.settings import LOOP
from robots.servos.loop import Servos


def check_in_loop(model: Model, request: Request, recordings: Sequence[Recording]) -> CheckResult:
    """Compare whole recordings of servos, each simulated with its recorded drive.

    Raises ExportError if a recording has no goal, or the grain is not a multiple of the step.
    """
    if not are_driven(recordings):
        raise ExportError(f"{recordings[0].name}: has no goal: a servo is checked in the loop alone")
    grain = LOOP.simulation.grain
    steps = round(grain / request.step)
    if abs(steps * request.step - grain) > 1e-9:
        raise ExportError(f"positions are compared every {grain:g} s: --step should be a whole part of it, as 0.001")
    # MuJoCo's controller reads the exact position
    rollouts = Rollouts(tuple(recordings), steps, grain=grain).without_counts
    simulated = rollouts.compute_position_errors([Point(model.terms, model.theta)])
    theirs = rollouts.positions.compare_paths(simulate_servos(model, request, rollouts.servos, steps))
    errors = {
        "this project's simulation": _compute_mean_size(simulated),
        "MuJoCo with what is exported": _compute_mean_size(theirs),
    }
    measured = rollouts.positions.measured
    motion = _compute_mean_size(measured - measured.mean())
    return CheckResult("In the loop, whole recordings from their goals alone, mean error", errors, motion)


def simulate_servos(model: Model, request: Request, servos: Servos, interval: int) -> Array:
    """Simulate B servos in MuJoCo over N steps; return each `interval`-th position, (N / interval + 1, 1, B) [rad]."""
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


def _compute_mean_size(values: Array) -> float:
    return float(np.mean(np.abs(values)))
