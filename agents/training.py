"""Training of excitation policies with PPO of stable-baselines3 on batched pendulums."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from agents.config import Config
from agents.design_env import ExcitationDesignVector
from agents.network import Network
from agents.observer import ARM, mirror_observation
from agents.vec_env import BatchedVecEnv
from estimators.progress import Progress
from pendulum_env import ARM_DESIGN
from pendulum_env.errors import UserError

CHECKPOINT = "training.zip"  # model of stable-baselines3, in the folder of a training


class DiscreteActions(gym.vector.VectorWrapper):
    """Wrapper with discrete actions: indices of the levels of the configuration (B, n)."""

    def __init__(self, env: Any, config: Config) -> None:
        """Wrap an environment."""
        super().__init__(env)
        self._levels = np.array(config.levels)
        self.single_action_space = gym.spaces.MultiDiscrete([len(config.levels)] * env.single_action_space.shape[0])
        self.action_space = gym.vector.utils.batch_space(self.single_action_space, env.num_envs)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Apply levels (B, n); the end of an episode is reported as a termination, since no reward follows it."""
        observation, reward, _, ends, info = self.env.step(self._levels[actions])
        return observation, reward, ends, np.zeros_like(ends), info


class TrainingTask(DiscreteActions):
    """Wrapper for training: discrete torques, mirrored observations, and weighted rewards.

    The weight of a reward grows with t: log det grows like log t, so a weighted row is worth its share of the final log
    det. With a torque budget, the square of the command has a price, which rises until the mean command keeps the
    budget. The environment enforces the budget anyway; the price prevents spending it in the first steps.
    """

    env: ExcitationDesignVector
    scale = 100.0  # decisions, divisor of the weight

    def __init__(self, env: ExcitationDesignVector, config: Config) -> None:
        """Wrap an environment."""
        super().__init__(env, config)
        self._head_start, self._tick = config.head_start, 0
        peak, rms = env.constraint.peak, env.constraint.rms
        self._per_rms, self._rate = (0.0, 0.0) if rms is None else (peak / rms, config.price_rate)
        self.price = 0.0  # [nat] of the RMS torque of the budget over one decision

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, and mirror the observation."""
        observation, info = self.env.reset(**arguments)
        return self._mirror(observation), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Apply levels (B, 1), weight the reward, subtract the price of the command, and adjust the price."""
        share = self._sign[:, None] * self._levels[actions]
        observation, reward, terminated, truncated, info = self.env.step(share)
        excess = (self._per_rms * share[:, 0]) ** 2 - 1.0
        reward = reward * (self._head_start + self._tick) / self.scale - self.price * excess
        self._tick = 0 if truncated.all() else self._tick + 1
        self.price = max(0.0, self.price + self._rate * float(excess.mean()))
        if "final_obs" in info:
            info["final_obs"] = mirror_observation(info["final_obs"])[0].astype(np.float32)
        return self._mirror(observation), reward, terminated, truncated, info

    def _mirror(self, observation: Any) -> Any:
        mirrored, self._sign = mirror_observation(observation)
        return mirrored.astype(np.float32)


def train(config: Config, progress: Progress | None = None, folder: Path | None = None) -> Network:
    """Train a policy; the same configuration gives the same policy on the same machine.

    `progress` is called with the progress as text and share. A folder gets intermediate policies `steps-N.npz` and, if
    TensorBoard is installed, its log. An interrupted training continues from the model in its folder with new plants.
    Raises OSError if the folder is not writable, and UserError if it holds a training with other settings.
    """
    torch.set_num_threads(1)  # reproducible, and fast enough for small networks
    model = make_model(config)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / CHECKPOINT).exists():
            model = _read_checkpoint(folder, config)
        model.tensorboard_log = str(folder / "tensorboard") if find_spec("tensorboard") else None
    if (steps_left := config.total - model.num_timesteps) > 0:
        callback = _TrainingCallback(config, progress, folder)
        model.learn(steps_left, callback, tb_log_name="training", reset_num_timesteps=model.num_timesteps == 0)
    return export_network(model, config)


def make_model(config: Config) -> PPO:
    """Make an untrained model of stable-baselines3."""
    env = BatchedVecEnv(make_task(config))
    model = PPO(
        policy="MlpPolicy",
        env=env,
        seed=config.seed,
        device="cpu",
        n_steps=config.rollout,
        n_epochs=config.epochs,
        batch_size=config.batch,
        learning_rate=lambda share_left: config.learning_rate * share_left,
        gamma=config.gamma,
        ent_coef=config.entropy,
        policy_kwargs={"net_arch": [config.hidden, config.hidden], "activation_fn": torch.nn.Tanh},
    )
    env.seed(config.seed)
    model.settings = repr(config)  # type: ignore[attr-defined]  # a checkpoint keeps all attributes
    return model


def _read_checkpoint(folder: Path, config: Config) -> PPO:
    """Read the model in a folder, and seed it for new plants."""
    model = PPO.load(folder / CHECKPOINT, device="cpu")
    if getattr(model, "settings", None) != repr(config):
        raise UserError(f"{folder}: holds a training with other settings: choose another folder")
    model.set_env(BatchedVecEnv(make_task(config)))
    model.set_random_seed(config.seed + model.num_timesteps)
    return model


def make_task(config: Config) -> DiscreteActions:
    """Make the environment of a training."""
    options: dict[str, Any] = {"num_envs": config.pendulums, "autoreset_mode": "SameStep"}
    if config.constraint == ARM:
        mode = gym.VectorizeMode.VECTOR_ENTRY_POINT
        task = gym.make_vec(ARM_DESIGN, vectorization_mode=mode, robot=config.robot or None, draw=True, **options)
        return DiscreteActions(task, config)
    return TrainingTask(ExcitationDesignVector(constraint=config.constraint, start="rest", **options), config)


def export_network(model: PPO, config: Config) -> Network:
    """Export the policy of a model as a `Network`."""
    modules = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    layers = [layer for layer in modules if isinstance(layer, torch.nn.Linear)]
    weights, biases = zip(
        *((layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in layers), strict=True
    )
    return Network(weights, biases, np.array(config.levels), config.constraint)


class _TrainingCallback(BaseCallback):
    """Callback that reports progress and writes intermediate policies."""

    def __init__(self, config: Config, progress: Progress | None, folder: Path | None) -> None:
        super().__init__()
        self._config, self._progress, self._folder = config, progress, folder
        self._gained: list[float] = []

    def _on_training_start(self) -> None:
        self._kept = self.num_timesteps

    def _on_step(self) -> bool:
        self._gained.append(float(self.locals["rewards"].mean()))
        return True

    def _on_rollout_start(self) -> None:  # the model has learnt from the last rollout
        if self._gained:
            self._report()

    def _on_training_end(self) -> None:
        self._report(at_end=True)

    def _report(self, at_end: bool = False) -> None:
        steps, config, mean = self.num_timesteps, self._config, float(np.mean(self._gained))
        self._gained = []
        self.logger.record("rollout/reward", mean)
        if self._progress is not None:
            self._progress(f"{steps:,} decisions, reward {mean:.4f} each", steps / config.total)
        if self._folder is not None and (at_end or steps // config.checkpoint > self._kept // config.checkpoint):
            assert isinstance(self.model, PPO)
            self._kept = steps
            export_network(self.model, config).save(self._folder / f"steps-{steps}.npz")
            self.model.save(self._folder / "written.zip")
            (self._folder / "written.zip").replace(self._folder / CHECKPOINT)
