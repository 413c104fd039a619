"""Policies from excitation signals, and rollouts that return recordings."""

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
    """Interface of policies, as of stable-baselines3 models."""

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, State]:
        """Return the actions and the next state, of one pendulum or of a batch (B, ...)."""


@runtime_checkable
class Controller(Protocol):
    """Interface of controllers, which compute the torque from the measurements in `info`."""

    def torque(self, info: Mapping[str, Any]) -> float | Array:
        """Return the torque of the next period [N m], of n joints (n,), from the environment's `info`."""


class OpenLoop:
    """Policy that plays a signal without feedback, from its start in each episode."""

    def __init__(self, excitation: Excitation, rate: float) -> None:
        """Set the signal and the rate of the environment [Hz]."""
        self.excitation, self.rate = excitation, rate

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[NDArray[np.float32], State]:
        """Return the torque of the step [N m], (1,) or (B, 1), and the state: steps since the episode's start."""
        batch = np.shape(observation)[:-1]
        steps = np.zeros(batch) if state is None else np.asarray(state[0])
        if episode_start is not None:
            steps = np.where(np.reshape(episode_start, batch), 0, steps)
        torque = self.excitation.signal(steps / self.rate)
        return np.asarray(torque, dtype=np.float32)[..., None], (steps + 1,)


def iterate_steps(
    env: gym.Env[Any, Any], policy: Policy | Controller, seed: int | None = None, options: dict[str, Any] | None = None
) -> Iterator[tuple[tuple[float, Any, Any] | None, dict[str, Any]]]:
    """Run a policy or a controller until the episode ends.

    Raises:
        ValueError: if policy and environment have different rates.

    Yields:
        Sample of each step and its `info`. The sample is the time [s] and position [rad] before the step and the torque
        [N m] from that time on, or None after a fault.
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
    """Run a policy or a controller in an environment and return the recording.

    Returns:
        Recording with one sample per step; its torque acts from its time on.
    """
    samples = collect_samples(islice(iterate_steps(env, policy, seed), steps), watch)
    return Recording(*samples, name=name, is_checked=True)


def collect_samples(
    run: Iterable[tuple[tuple[float, Any, Any] | None, dict[str, Any]]],
    watch: Callable[[dict[str, Any]], None] | None = None,
) -> tuple[Array, Array, Array]:
    """Collect time [s] (N,), position [rad] and torque [N m], each (N,) or (N, n), of `iterate_steps`."""
    rows: list[tuple[float, Any, Any]] = []
    for row, info in run:
        if row is not None:
            rows.append(row)
        if watch is not None:
            watch(info)
    time, position, torque = (np.array([row[k] for row in rows]) for k in range(3))
    return time, position, torque
