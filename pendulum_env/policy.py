"""Excitation signals as policies, and rollouts that become recordings."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import islice
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.excitation import Excitation
from pendulum_env.recording import Recording

State = tuple[Any, ...] | None


class Policy(Protocol):
    """Interface of policies; models of stable-baselines3 are policies."""

    def predict(
        self,
        observation: Any,
        state: State = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, State]:
        """Return actions for observations, and the next state; of one pendulum, or of a batch (B, ...)."""


@runtime_checkable
class Controller(Protocol):
    """Interface of controllers, which compute the torque of a pendulum or an arm from measurements in `info`."""

    def torque(self, info: Mapping[str, Any]) -> float | Array:
        """Return the torque for the period that begins now [N m], of an arm (n,); `info` is the environment's."""


class OpenLoop:
    """Signal as a policy: the torque of each step, without feedback; it restarts with each episode."""

    def __init__(self, excitation: Excitation, rate: float) -> None:
        """Take the signal and the steps per second [Hz]."""
        self.excitation, self.rate = excitation, rate

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[NDArray[np.float32], State]:
        """Return the torque of the step, (1,) or (B, 1) [N m]; the state counts the steps of each episode."""
        batch = np.shape(observation)[:-1]
        steps = np.zeros(batch) if state is None else np.asarray(state[0])
        if episode_start is not None:
            steps = np.where(np.reshape(episode_start, batch), 0, steps)
        torque = self.excitation.signal(steps / self.rate)
        return np.asarray(torque, dtype=np.float32)[..., None], (steps + 1,)


def iterate_steps(
    env: gym.Env[Any, Any], policy: Policy | Controller, seed: int | None = None, options: dict[str, Any] | None = None
) -> Iterator[tuple[tuple[float, Any, Any] | None, dict[str, Any]]]:
    """Run a policy or a controller until the episode ends or the caller stops asking.

    Raises:
        ValueError: if the policy is laid out for another rate than the environment's.

    Yields:
        Time [s] and position [rad] before each step and the torque from then on [N m], None with a fault, when nothing
        was measured; and the step's `info`.
    """
    rates = [getattr(part, "rate", None) for part in (policy, env.unwrapped)]
    if None not in rates and not math.isclose(*rates):  # type: ignore[arg-type]
        raise ValueError(f"the policy is laid out for {rates[0]:g} Hz, the environment runs at {rates[1]:g} Hz")
    observation, info = env.reset(seed=seed, options=options)
    state: State = None
    terminated = truncated = False
    first = True
    while not (terminated or truncated):
        if isinstance(policy, Controller):
            action: Any = np.atleast_1d(policy.torque(info))
        else:
            action, state = policy.predict(observation, state, np.array(first))
        time, position, first = info["time"], info["position"], False
        observation, _, terminated, truncated, info = env.step(action)
        yield None if "fault" in info else (time, position, info["torque"]), info


def rollout(
    env: gym.Env[Any, Any],
    policy: Policy | Controller,
    steps: int,
    *,
    seed: int | None = None,
    name: str = "rollout",
    watch: Callable[[dict[str, Any]], None] | None = None,
) -> Recording:
    """Run a policy or a controller in an environment and keep the measurement.

    Returns:
        One sample for each step; its torque acts from its time on.
    """
    return Recording(*measure(islice(iterate_steps(env, policy, seed), steps), watch), name=name, is_checked=True)


def measure(
    run: Iterable[tuple[tuple[float, Any, Any] | None, dict[str, Any]]],
    watch: Callable[[dict[str, Any]], None] | None = None,
) -> tuple[Array, Array, Array]:
    """Return time (N,) [s], position [rad] and torque [N m] of a run of `iterate_steps`, (N,) each, or (N, n)."""
    rows: list[tuple[float, Any, Any]] = []
    for row, info in run:
        if row is not None:
            rows.append(row)
        if watch is not None:
            watch(info)
    time, position, torque = (np.array([row[k] for row in rows]) for k in range(3))
    return time, position, torque
