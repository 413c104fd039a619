"""Simulation of an exported model in MuJoCo, over the segments of recordings."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from estimators.simulation.free_running import Segments, start_memory
from pendulum_env._typing import Array
from pendulum_env.backends.constrained_body import import_mujoco
from pendulum_env.export.actuators import find_lag
from pendulum_env.export.request import Exported
from pendulum_env.physics import Model, find_link


def simulate_segments(model: Model, exported: Exported, segments: Segments) -> Array:
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
            mujoco, world, data, segments, {id: [part[k] for part in parts] for id, parts in memory.items()}, model, k
        )
        path[0, k] = data.qpos[0]
        for n, torque in enumerate(segments.torque[:, k]):
            data.ctrl[0] = torque
            for _ in range(count):
                mujoco.mj_step(world, data)
            path[n + 1, k] = data.qpos[0]
    return path


def _set_initial_state(
    mujoco: Any, world: Any, data: Any, segments: Segments, memory: Mapping[str, Sequence[float]], model: Model, k: int
) -> None:
    """Set the joint and its internal states to the start of segment `k`."""
    data.qpos[0], data.qvel[0] = segments.position[0, k], segments.velocity[k]
    if world.nq > 1:  # the link's angle is relative to the motor's
        position, velocity = memory[find_link(model.terms).id]
        data.qpos[1], data.qvel[1] = position - data.qpos[0], velocity - data.qvel[0]
    if (lag := find_lag(model.terms)) is not None and world.na:
        data.act[0] = memory[lag.id][0]
    if world.actuator_delay[0]:
        samples = int(world.actuator_history[0][0])
        times = (np.arange(samples) - samples) * world.opt.timestep
        rate, first = segments.windows.recording.rate, segments.first[k]
        index = first + np.floor(times * rate + 1e-9).astype(int)
        values = np.where(index >= 0, segments.windows.recording.torque[np.maximum(index, 0)], 0.0)
        mujoco.mj_initCtrlHistory(world, data, 0, times[:, None], values[:, None])
