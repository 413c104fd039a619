"""Training a policy that chooses excitations: PPO of stable-baselines3 on batched pendulums."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from agents.config import Config
from agents.design_env import ExcitationDesignVector
from agents.knowledge import CRITERIA
from agents.network import Network
from agents.observer import CONSTRAINTS, Constraint, mirrored
from agents.vec_env import BatchedVecEnv

TUNING = 2**21  # added to seeds, for plants that neither training nor evaluation draws
STRETCHES = (0.8, 0.9, 1.0, 1.1, 1.2, 1.3)
SCALE = 100.0  # decisions; keeps rewards as large as they were
Tell = Callable[[str, float], None]


def make_env(config: Config) -> BatchedVecEnv:
    """Pendulums to learn on, their torque in levels."""
    design = ExcitationDesignVector(
        config.pendulums, constraint=config.constraint, criterion=config.criterion, autoreset_mode="SameStep"
    )
    env: VectorEnv[Any, Any, Any] = FinalWorth(design, config.head_start)
    if design.constraint.rms is not None:
        env = PriceTorque(env, design.constraint, config.price_rate)
    return BatchedVecEnv(Levels(env, config.levels))


def train(config: Config, tell: Tell | None = None, checkpoints: Path | None = None) -> Network:
    """Train a policy; the same configuration gives the same policy on the same machine.

    Args:
        config: what to do.
        tell: called with the progress, as text and as a share.
        checkpoints: folder for policies on the way, `steps-N.npz`.
    """
    torch.set_num_threads(1)  # small networks gain nothing from more, and results then repeat
    env = make_env(config)
    model = PPO(
        "MlpPolicy",
        env,
        seed=config.seed,
        device="cpu",
        n_steps=config.rollout,
        batch_size=config.batch,
        n_epochs=config.epochs,
        learning_rate=lambda left: config.learning_rate * left,
        gamma=config.gamma,
        ent_coef=config.entropy,
        policy_kwargs={"net_arch": [config.hidden, config.hidden]},
    )
    env.seed(config.seed)
    model.learn(config.steps, callback=_Watch(config, tell, checkpoints))
    network = export(model, config)
    return network if CONSTRAINTS[config.constraint].rms is None else stretched(network, config)


def stretched(network: Network, config: Config) -> Network:
    """Policy with its levels as far apart as it learns most with: without chance, it may not spend the whole budget."""
    stretches = [replace(network, levels=network.levels * factor) for factor in STRETCHES]
    return max(stretches, key=lambda candidate: learnt(candidate, config))


def learnt(network: Network, config: Config, count: int = 64) -> float:
    """Mean of what the criterion counts at the end of an episode, on plants of no training and no evaluation [nat]."""
    env = ExcitationDesignVector(count, constraint=network.constraint)
    observation, _ = env.reset(seed=TUNING + config.seed)
    for _ in range(env.steps_per_episode):
        observation = env.step(network.predict(observation)[0])[0]
    return float(CRITERIA[config.criterion](env.knowledge.information).mean())


def export(model: PPO, config: Config) -> Network:
    """What a policy needs to act, without what it needs to learn."""
    policy = model.policy
    modules = [*policy.mlp_extractor.policy_net, policy.action_net]
    layers = [layer for layer in modules if isinstance(layer, torch.nn.Linear)]
    weights, biases = zip(
        *((layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in layers), strict=True
    )
    return Network(weights, biases, np.array(config.levels), config.constraint)


class Levels(VectorWrapper):
    """Torque in levels instead of a share, seen and commanded as if the arm turned forwards, as a `Network` does."""

    def __init__(self, env: VectorEnv[Any, Any, Any], levels: Sequence[float]) -> None:
        """Take the environment and the levels."""
        super().__init__(env)
        self._levels = np.array(levels)
        self.single_action_space = gym.spaces.Discrete(len(self._levels))
        self.action_space = batch_space(self.single_action_space, env.num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset, and see it forwards."""
        observation, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]  # lists are passed on
        return self._see(observation), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Play levels (B,)."""
        torque = self._sign * self._levels[actions]
        observation, reward, terminated, truncated, info = self.env.step(torque[:, None])
        if "final_obs" in info:
            info["final_obs"] = mirrored(info["final_obs"])[0].astype(np.float32)
        return self._see(observation), reward, terminated, truncated, info

    def _see(self, observation: Any) -> Any:
        turned, self._sign = mirrored(observation)
        return turned.astype(np.float32)


class FinalWorth(VectorWrapper):
    """Rewards that grow with t: as log det grows like log t, a row is then worth what it adds to log det in the end."""

    def __init__(self, env: VectorEnv[Any, Any, Any], head_start: int) -> None:
        """Take the environment, and what is added to t [decisions]."""
        super().__init__(env)
        self._head_start, self._tick = head_start, 0

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step, and weigh the reward."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        reward = reward * (self._head_start + self._tick) / SCALE
        self._tick = 0 if truncated.all() else self._tick + 1
        return observation, reward, terminated, truncated, info


class PriceTorque(VectorWrapper):
    """A price on the square of the commanded torque, that rises until the mean command keeps the budget.

    The environment enforces the budget anyway, but an agent that spends it at once learns little of what came later.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], constraint: Constraint, rate: float) -> None:
        """Take the environment, its constraint, and by how much the price follows a relative excess, per decision."""
        super().__init__(env)
        assert constraint.rms is not None, "only a budget needs a price"
        self._scale, self._rate = constraint.peak / constraint.rms, rate
        self.price = 0.0  # [nat], of a torque of the budget's size over a decision

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step, charge for the command, and adjust the price."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        excess = (self._scale * np.asarray(actions)[:, 0]) ** 2 - 1.0
        reward = reward - self.price * excess
        self.price = max(0.0, self.price + self._rate * float(excess.mean()))
        return observation, reward, terminated, truncated, info


class _Watch(BaseCallback):
    """Tells the progress and keeps policies on the way."""

    def __init__(self, config: Config, tell: Tell | None, checkpoints: Path | None) -> None:
        super().__init__()
        self._config, self._tell, self._folder = config, tell, checkpoints
        self._gained: list[float] = []
        self._saved = 0

    def _on_step(self) -> bool:
        self._gained.append(float(self.locals["rewards"].mean()))
        return True

    def _on_rollout_end(self) -> None:
        done = self.num_timesteps
        if self._tell is not None:
            self._tell(f"{done:,} decisions, reward {np.mean(self._gained):.4f} each", done / self._config.steps)
        self._gained.clear()
        if self._folder is not None and done // self._config.checkpoint > self._saved:
            self._saved = done // self._config.checkpoint
            assert isinstance(self.model, PPO)
            export(self.model, self._config).save(self._folder / f"steps-{done}.npz")
