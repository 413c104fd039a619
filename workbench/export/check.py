"""An exported model in MuJoCo, against a recording and beside this project's own simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.selection.data import Evidence
from estimators.simulation.free_running import Flights, fly_all, start_memory
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.physics.term import Memory
from pendulum_env.recording import Recording
from workbench.export.extra import needed
from workbench.export.request import Exported, ExportError


@dataclass(frozen=True)
class Check:
    """Free-running position errors over windows of one second, each started from the measured state [rad].

    Attributes:
        own: of this project's simulation, RMS against the recording.
        mujoco: of MuJoCo with the exported model, RMS against the recording.
        between: RMS of one simulation against the other.
        motion: RMS of the measured position about its mean in each window.
    """

    own: float
    mujoco: float
    between: float
    motion: float


def check(model: Model, exported: Exported, recordings: Sequence[Recording]) -> Check:
    """Run the exported XML in MuJoCo against recordings.

    Raises:
        ExportError: if a known load hung on the joint, which no exported model has.
        IdentificationError: if a recording holds too little motion.
        InputError: if the extra `export` is not installed.
    """
    for recording in recordings:
        if recording.load is not None and (recording.load.inertia or recording.load.gravity):
            raise ExportError(f"{recording.name}: a known load hung on the joint: check with a recording without one")
    flights = Evidence.of(recordings).watching(model).flights
    own = [path[:, 0] for path in fly_all(flights, [(model.terms, model.theta)])]
    theirs = [_fly(model, exported, flight) for flight in flights]
    measured = [flight.position for flight in flights]
    return Check(
        _rms(own, measured), _rms(theirs, measured), _rms(theirs, own), _rms(measured, [q.mean(0) for q in measured])
    )


def _rms(ones: Sequence[Array], others: Sequence[Array]) -> float:
    return float(
        np.sqrt(
            np.mean(np.concatenate([(a - b)[1:].ravel() for a, b in zip(ones, _like(ones, others), strict=True)]) ** 2)
        )
    )


def _like(ones: Sequence[Array], others: Sequence[Array]) -> list[Array]:
    return [np.broadcast_to(b, a.shape) for a, b in zip(ones, others, strict=True)]


def _fly(model: Model, exported: Exported, flights: Flights) -> Array:
    """Position in every flight, (N + 1, B) [rad]."""
    mujoco = needed("mujoco")
    world = mujoco.MjModel.from_xml_string(exported.content)
    rate = flights.windows.recording.rate
    count = max(1, math.ceil(1.0 / (rate * world.opt.timestep) - 1e-9))
    world.opt.timestep = 1.0 / (rate * count)
    memory: dict[str, Memory] = {}
    for term in model.terms:
        if term.remembers and not term.delay:
            memory |= start_memory([flights], [term])
    path = np.empty_like(flights.position)
    for k in range(path.shape[1]):
        data = mujoco.MjData(world)
        _begin(mujoco, world, data, flights, {id: [part[k] for part in parts] for id, parts in memory.items()}, k)
        path[0, k] = data.qpos[0]
        for n, torque in enumerate(flights.torque[:, k]):
            if world.nu:
                data.ctrl[0] = torque
            else:  # a robot description has no drive
                data.qfrc_applied[0] = torque
            for _ in range(count):
                mujoco.mj_step(world, data)
            path[n + 1, k] = data.qpos[0]
    return path


def _begin(mujoco: Any, world: Any, data: Any, flights: Flights, memory: Mapping[str, Sequence[float]], k: int) -> None:
    """Put the joint, and what it remembers, to the start of a flight."""
    data.qpos[0], data.qvel[0] = flights.position[0, k], flights.velocity[k]
    if world.nq > 1:  # the link's angle is told from the motor's
        position, velocity = memory["joint_flexibility"]
        data.qpos[1], data.qvel[1] = position - data.qpos[0], velocity - data.qvel[0]
    if world.na:
        data.act[0] = memory["actuator_lag"][0]
    if world.nu and world.actuator_delay[0]:
        samples = int(world.actuator_history[0][0])
        times = (np.arange(samples) - samples) * world.opt.timestep
        rate, first = flights.windows.recording.rate, flights.first[k]
        index = first + np.floor(times * rate + 1e-9).astype(int)
        values = np.where(index >= 0, flights.windows.recording.torque[np.maximum(index, 0)], 0.0)
        mujoco.mj_initCtrlHistory(world, data, 0, times[:, None], values[:, None])
