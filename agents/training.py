"""Training of excitation policies with PPO of stable-baselines3 on batched pendulums.

An interrupted training resumes from its last checkpoint and ends with the same policy: the checkpoint includes
pendulums and random number generators.
"""

from __future__ import annotations

import random
from copy import copy
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import VectorWrapper
from gymnasium.vector.utils import batch_space
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from agents.arm_env import ArmExcitationDesignVector
from agents.config import Config
from agents.design_env import ExcitationDesignVector
from agents.network import Network
from agents.observer import ARM, mirror_observation
from agents.vec_env import BatchedVecEnv
from estimators.progress import Progress
from pendulum_env.errors import FileError, UserError
from pendulum_env.files import write_whole
from pendulum_env.reading import read_bytes

CHECKPOINT = "training.pkl"  # in the folder of a training, with policies `steps-N.npz` and `tensorboard`


class CheckpointError(UserError):
    """The folder holds a training with another configuration, or one that must not be resumed."""


class DiscreteActions(VectorWrapper):
    """Wrapper with discrete actions: indices of the levels of the configuration (B, n)."""

    def __init__(self, env: Any, config: Config) -> None:
        """Wrap an environment."""
        super().__init__(env)
        self._levels = np.array(config.levels)
        self.single_action_space = gym.spaces.MultiDiscrete([len(config.levels)] * env.single_action_space.shape[0])
        self.action_space = batch_space(self.single_action_space, env.num_envs)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Apply levels (B, n); the end of an episode is reported as a termination, since nothing follows it."""
        observation, reward, _, ends, info = self.env.step(self._levels[actions])
        return observation, reward, ends, np.zeros_like(ends), info


class TrainingTask(DiscreteActions):
    """Wrapper for training: discrete torques, mirrored observations, and weighted rewards.

    The weight of a reward grows with t: log det grows like log t, so a weighted row is worth its share of the final log
    det. With a torque budget, the square of the command has a price, which rises until the mean command keeps the
    budget. The environment enforces the budget anyway; the price keeps an agent from spending it at once.
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

    def reset(self, **given: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, and mirror the observation."""
        observation, info = self.env.reset(**given)
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


def train(config: Config, tell: Progress | None = None, folder: Path | None = None) -> Network:
    """Train a policy; the same configuration gives the same policy on the same machine.

    Args:
        config: of the training.
        tell: called with the progress, as text and as a share.
        folder: of the last checkpoint, from which the training continues if there is one, policies `steps-N.npz`, and
            a log for TensorBoard if that is installed.

    Raises:
        CheckpointError: if the folder holds a training of another configuration.
        OSError: if the folder is not writable.
    """
    torch.set_num_threads(1)  # one thread: results repeat, and small networks gain nothing from more
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    if folder is None or not (folder / CHECKPOINT).exists():
        model = make_model(config)
    else:
        model = _read_checkpoint(folder / CHECKPOINT, config)
    if model.num_timesteps < config.steps:
        log = None if folder is None or find_spec("tensorboard") is None else str(folder / "tensorboard")
        model.tensorboard_log = log
        callback, left = _TrainingCallback(config, tell, folder), config.steps - model.num_timesteps
        model.learn(left, callback, reset_num_timesteps=model.num_timesteps == 0, tb_log_name="training")
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
        learning_rate=lambda left: config.learning_rate * left,
        gamma=config.gamma,
        ent_coef=config.entropy,
        policy_kwargs={"net_arch": [config.hidden, config.hidden], "activation_fn": torch.nn.Tanh},
    )
    env.seed(config.seed)
    return model


def make_task(config: Config) -> DiscreteActions:
    """Make the environment of a training."""
    many: dict[str, Any] = {"num_envs": config.pendulums, "autoreset_mode": "SameStep"}
    if config.constraint == ARM:
        return DiscreteActions(ArmExcitationDesignVector(robot=config.robot or None, draw=True, **many), config)
    return TrainingTask(ExcitationDesignVector(constraint=config.constraint, **many), config)


def export_network(model: PPO, config: Config) -> Network:
    """Export the policy of a model as a `Network`."""
    modules = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    layers = [layer for layer in modules if isinstance(layer, torch.nn.Linear)]
    weights, biases = zip(
        *((layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in layers), strict=True
    )
    return Network(weights, biases, np.array(config.levels), config.constraint)


def _write_checkpoint(path: Path, model: PPO, config: Config) -> None:
    """Write a checkpoint atomically."""
    bare = copy(model)
    bare._logger = None  # type: ignore[assignment]  # it has open files; resuming opens new ones
    state = {
        "config": asdict(config),
        "model": bare,  # includes the pendulums
        "random": (random.getstate(), np.random.get_state(), torch.get_rng_state()),  # noqa: NPY002  (of SB3)
    }
    write_whole(path, cloudpickle.dumps(state))


def _read_checkpoint(path: Path, config: Config) -> PPO:
    """Read a checkpoint, a pickle, which can run code: read your own only."""
    try:
        packed = read_bytes(path)
    except FileError as error:
        raise CheckpointError(str(error)) from None
    try:
        state = cloudpickle.loads(packed)
        before, model, (python, numpy, torched) = state["config"], state["model"], state["random"]
    except Exception as error:  # a broken or foreign pickle may raise anything
        raise CheckpointError(f"{path}: is no checkpoint of this version ({type(error).__name__})") from None
    for name, value in asdict(config).items():
        if (begun := before.get(name)) != value:
            raise CheckpointError(f"{path}: has {name} = {begun}, not {value}: resume it with the same configuration")
    random.setstate(python)
    np.random.set_state(numpy)  # noqa: NPY002
    torch.set_rng_state(torched)
    return model


class _TrainingCallback(BaseCallback):
    """Callback that reports progress and writes checkpoints and policies."""

    def __init__(self, config: Config, tell: Progress | None, folder: Path | None) -> None:
        super().__init__()
        self._config, self._tell, self._folder = config, tell, folder
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
        done, config, mean = self.num_timesteps, self._config, float(np.mean(self._gained))
        self._gained = []
        self.logger.record("rollout/reward", mean)
        if self._tell is not None:
            self._tell(f"{done:,} decisions, reward {mean:.4f} each", min(1.0, done / config.steps))
        if self._folder is not None and (at_end or done // config.checkpoint > self._kept // config.checkpoint):
            assert isinstance(self.model, PPO)
            self._kept = done
            export_network(self.model, config).save(self._folder / f"steps-{done}.npz")
            _write_checkpoint(self._folder / CHECKPOINT, self.model, config)
