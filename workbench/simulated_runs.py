"""Runs of a simulated pendulum, and the environment of any run."""

from typing import Any

import gymnasium as gym
import numpy as np

from agents.observer import Pilot
from pendulum_env.backends.hardware import DriveError
from pendulum_env.backends.simulated import TORQUE_NOISE, record
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.recording import Recording
from pendulum_env.registration import PENDULUM
from pendulum_env.spaces import MAX_TORQUE
from workbench.errors import InputError
from workbench.runs import Plan
from workbench.terminal import Terminal


def make_environment(plan: Plan) -> gym.Env[Any, Any]:
    """Create the environment: a simulated plant, a replayed recording, or a rig without power.

    The rig is owned and connected from now on; raises InputError if it is out of reach, or in use.
    """
    asked = plan.arguments
    if plan.rig is not None:
        try:
            return gym.make(PENDULUM, max_episode_steps=-1, backend="dm1015b", config=str(plan.rig.path))
        except DriveError as error:
            raise InputError(str(error)) from None
    return gym.make(
        PENDULUM,
        max_episode_steps=-1,
        backend=asked.backend or "pymunk",
        model=None if asked.replay is not None else plan.plant,
        rate=asked.rate,
        counts=asked.counts,
        torque_noise=TORQUE_NOISE,
        max_torque=max(MAX_TORQUE, plan.command.amplitude),
        recording=asked.replay,
    )


def make_controller(plan: Plan, rate: float) -> OpenLoop | Pilot:
    """Create the controller at a rate [Hz]; a replay has its own torque."""
    return plan.command if isinstance(plan.command, Pilot) else OpenLoop(plan.command, rate)


def simulate(plan: Plan, rng: np.random.Generator, terminal: Terminal) -> Recording:
    """Record with the backend that was asked for."""
    arguments, command, seconds = plan.arguments, plan.command, plan.seconds
    if (arguments.backend == "replay") != (arguments.replay is not None):
        raise InputError("--backend replay and --replay FILE belong together: give both or neither")
    if arguments.replay is not None and plan.plant.effects:
        raise InputError("--effect does not go with a replay: it plays the plant that was recorded")
    if not isinstance(command, Pilot) and arguments.backend in (None, "simulated"):
        with terminal.progress("simulating"):
            sensor = plan.rate, arguments.counts, TORQUE_NOISE
            return record(plan.plant, command, seconds, *sensor, rng=rng, release=plan.release)
    env = make_environment(plan)
    rate = env.unwrapped.rate  # type: ignore[attr-defined]
    steps = round(seconds * rate)
    with terminal.progress("running") as tell:
        return rollout(
            env,
            make_controller(plan, rate),
            steps,
            seed=int(rng.integers(2**31)),
            watch=lambda info: tell(f"{info['time']:.0f} s", info["time"] / seconds),
        )
