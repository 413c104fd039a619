"""Runs of a simulated pendulum."""

import numpy as np

from agents.observer import Pilot
from pendulum_env.backends.simulated import TORQUE_NOISE, record
from pendulum_env.policy import rollout
from pendulum_env.recording import Recording
from workbench.errors import InputError
from workbench.runs import Plan, make_controller, make_environment
from workbench.terminal import Terminal


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
