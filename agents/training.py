"""Training a policy that chooses excitations: PPO of stable-baselines3 on batched pendulums.

A training that was killed goes on where it last wrote a checkpoint and ends with the same policy: the checkpoint holds
everything that the rest depends on, pendulums and random numbers included.
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
from agents.observer import ARM, mirrored
from agents.vec_env import BatchedVecEnv
from estimators.progress import Progress
from pendulum_env.files import write_whole
from pendulum_env.mistake import Mistake
from pendulum_env.reading import Unreadable, read_own

CHECKPOINT = "training.pkl"  # in the folder of a training, beside policies `steps-N.npz` and `tensorboard`


class CheckpointError(Mistake):
    """A folder that holds another training than the one asked for, or one that was not to be resumed."""


class InLevels(VectorWrapper):
    """Actions in levels, as a `Network` chooses them: places among those of the configuration (B, n)."""

    def __init__(self, env: Any, config: Config) -> None:
        """Take the environment; the configuration has the levels."""
        super().__init__(env)
        self._levels = np.array(config.levels)
        self.single_action_space = gym.spaces.MultiDiscrete([len(config.levels)] * env.single_action_space.shape[0])
        self.action_space = batch_space(self.single_action_space, env.num_envs)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Play levels (B, n); what is known in the end counts, and nothing is to be expected after it."""
        observation, reward, _, ends, info = self.env.step(self._levels[actions])
        return observation, reward, ends, np.zeros_like(ends), info


class LearntOn(InLevels):
    """Torque in levels, seen as if the arm turned forwards, as a `Network` sees it, and paid by its worth in the end.

    Rewards grow with t: as log det grows like log t, a row is then worth what it adds to log det in the end. Under a
    budget of torque, the square of the command has a price, that rises until the mean command keeps the budget: the
    environment enforces it anyway, but an agent that spends it at once learns little of what came later.
    """

    env: ExcitationDesignVector
    scale = 100.0  # decisions; keeps rewards as large as they were

    def __init__(self, env: ExcitationDesignVector, config: Config) -> None:
        """Take the environment; the configuration has levels, head start and the rate of the price."""
        super().__init__(env, config)
        self._head_start, self._tick = config.head_start, 0
        peak, rms = env.constraint.peak, env.constraint.rms
        self._per_rms, self._rate = (0.0, 0.0) if rms is None else (peak / rms, config.price_rate)
        self.price = 0.0  # [nat], of a torque of the budget's size over a decision

    def reset(self, **given: Any) -> tuple[Any, dict[str, Any]]:
        """Reset, and see it forwards."""
        observation, info = self.env.reset(**given)
        return self._see(observation), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Play levels (B, 1), weigh the reward, charge for the command, and adjust the price."""
        share = self._sign[:, None] * self._levels[actions]
        observation, reward, terminated, truncated, info = self.env.step(share)
        excess = (self._per_rms * share[:, 0]) ** 2 - 1.0
        reward = reward * (self._head_start + self._tick) / self.scale - self.price * excess
        self._tick = 0 if truncated.all() else self._tick + 1
        self.price = max(0.0, self.price + self._rate * float(excess.mean()))
        if "final_obs" in info:
            info["final_obs"] = mirrored(info["final_obs"])[0].astype(np.float32)
        return self._see(observation), reward, terminated, truncated, info

    def _see(self, observation: Any) -> Any:
        turned, self._sign = mirrored(observation)
        return turned.astype(np.float32)


def train(config: Config, tell: Progress | None = None, folder: Path | None = None, resume: bool = False) -> Network:
    """Train a policy; the same configuration gives the same policy on the same machine.

    Args:
        config: what to do.
        tell: called with the progress, as text and as a share.
        folder: for what is kept on the way: the last checkpoint, policies `steps-N.npz`, and a log for TensorBoard if
            that is installed.
        resume: whether to go on from the checkpoint in the folder; without one, it begins.

    Raises:
        CheckpointError: if the folder holds a training that is not to be resumed, or one of another configuration.
        OSError: if the folder cannot be written to.
    """
    torch.set_num_threads(1)  # small networks gain nothing from more, and results then repeat
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    if folder is None or not (folder / CHECKPOINT).exists():
        model = make_model(config)
    elif resume:
        model = _restore(folder / CHECKPOINT, config)
    else:
        raise CheckpointError(f"{folder}: holds a training already: resume it (--resume), or name another folder")
    if model.num_timesteps < config.steps:
        log = None if folder is None or find_spec("tensorboard") is None else str(folder / "tensorboard")
        model.tensorboard_log = log
        callback, left = _Watch(config, tell, folder), config.steps - model.num_timesteps
        model.learn(left, callback, reset_num_timesteps=model.num_timesteps == 0, tb_log_name="training")
    return export(model, config)


def make_model(config: Config) -> PPO:
    """What learns, before it has."""
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


def make_task(config: Config) -> InLevels:
    """What is learnt on."""
    many: dict[str, Any] = {"num_envs": config.pendulums, "autoreset_mode": "SameStep"}
    if config.constraint == ARM:
        return InLevels(ArmExcitationDesignVector(robot=config.robot or None, draw=True, **many), config)
    return LearntOn(ExcitationDesignVector(constraint=config.constraint, **many), config)


def export(model: PPO, config: Config) -> Network:
    """What a policy needs to act, without what it needs to learn."""
    modules = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    layers = [layer for layer in modules if isinstance(layer, torch.nn.Linear)]
    weights, biases = zip(
        *((layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in layers), strict=True
    )
    return Network(weights, biases, np.array(config.levels), config.constraint)


def _keep(path: Path, model: PPO, config: Config) -> None:
    """Write a checkpoint, whole or not at all."""
    bare = copy(model)
    bare._logger = None  # type: ignore[assignment]  # open files, opened anew when resumed
    state = {
        "config": asdict(config),
        "model": bare,  # with its pendulums
        "random": (random.getstate(), np.random.get_state(), torch.get_rng_state()),  # noqa: NPY002  (of SB3)
    }
    write_whole(path, cloudpickle.dumps(state), private=True)


def _restore(path: Path, config: Config) -> PPO:
    """What `_keep` wrote. Reading a pickle runs what is in it, so it has to be this user's own."""
    try:
        packed = read_own(path)
    except Unreadable as error:
        raise CheckpointError(str(error)) from None
    try:
        state = cloudpickle.loads(packed)
        before, model, (python, numpy, torched) = state["config"], state["model"], state["random"]
    except Exception as error:  # whatever a broken or foreign pickle may raise
        raise CheckpointError(f"{path}: is no checkpoint of this version ({type(error).__name__})") from None
    for name, value in asdict(config).items():
        if (begun := before.get(name)) != value:
            raise CheckpointError(f"{path}: was begun with {name} = {begun}, not {value}: a resumed training keeps it")
    random.setstate(python)
    np.random.set_state(numpy)  # noqa: NPY002
    torch.set_rng_state(torched)
    return model


class _Watch(BaseCallback):
    """Reports the progress and keeps checkpoints and policies on the way."""

    def __init__(self, config: Config, tell: Progress | None, folder: Path | None) -> None:
        super().__init__()
        self._config, self._tell, self._folder = config, tell, folder
        self._gained: list[float] = []

    def _on_training_start(self) -> None:
        self._kept = self.num_timesteps

    def _on_step(self) -> bool:
        self._gained.append(float(self.locals["rewards"].mean()))
        return True

    def _on_rollout_start(self) -> None:  # what was learnt from the rollout before is in the model now
        if self._gained:
            self._look()

    def _on_training_end(self) -> None:
        self._look(at_end=True)

    def _look(self, at_end: bool = False) -> None:
        done, config, mean = self.num_timesteps, self._config, float(np.mean(self._gained))
        self._gained = []
        self.logger.record("rollout/reward", mean)
        if self._tell is not None:
            self._tell(f"{done:,} decisions, reward {mean:.4f} each", min(1.0, done / config.steps))
        if self._folder is not None and (at_end or done // config.checkpoint > self._kept // config.checkpoint):
            assert isinstance(self.model, PPO)
            self._kept = done
            export(self.model, config).save(self._folder / f"steps-{done}.npz")
            _keep(self._folder / CHECKPOINT, self.model, config)
