"""What it is worth to name an effect before training: policies from three simulators, on a joint that none of them is.

The joint hides Stribeck friction and cogging. A policy that is to bring it to an angle is trained with PPO on the
paper's model, fitted to a recording, and on what `diagnose` makes of that; on each as it is, and with its parameters
drawn anew for every episode. All are then tried on the joint itself.

python examples/sim_to_real.py [FIGURE.svg]      about five minutes of a processor; needs the extra rl
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass

import gymnasium as gym
import matplotlib.pyplot as plt  # filterpy brings it
import numpy as np
import torch
from gymnasium.vector import VectorEnv, VectorWrapper
from scipy.stats import t as students_t
from stable_baselines3 import PPO

import pendulum_env  # noqa: F401  (makes the environments known)
from agents.vec_env import BatchedVecEnv
from estimators import diagnose
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.physics import Model
from pendulum_env.plant import make_plant
from pendulum_env.wrappers import RandomizePlantVector

HIDDEN = ["stribeck=0.8,0.3", "cogging:order=12,sin=0.35,cos=0.2"]
SPREAD = 0.3  # of the randomised parameters
SEEDS = 5
STEPS = 250_000  # of a training
RATE, SECONDS = 50.0, 2.0  # of the policy [Hz], of an episode [s]
TORQUE = 5.0  # [N m], bound
FURTHEST = 1.0  # [rad], of a target
TRIALS = 256  # targets of an evaluation
SETTLED = 0.5  # [s] at the end of an episode, over which the error counts


class Reach(VectorWrapper):
    """Bring each joint to an angle of its own and keep it there; it starts at rest, hanging down.

    Observation (5,): error [rad], sin q, cos q, q' [rad/s], and target [rad]. Action (1,): torque over its bound.
    Reward of a step: minus the error, and less of its root, so that the last millimetres count as well.
    """

    def __init__(self, env: VectorEnv) -> None:
        super().__init__(env)
        self.single_observation_space = gym.spaces.Box(-np.inf, np.inf, (5,), np.float32)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        """Draw new targets."""
        self.rng = np.random.default_rng(seed)
        self.target = self.rng.uniform(-FURTHEST, FURTHEST, self.num_envs)
        observation, info = self.env.reset(seed=seed, options=options)
        return self._seen(observation, info["position"]), info

    def step(self, actions):
        """Hold the torques for a period; a joint whose episode has ended gets a new target."""
        observation, _, terminated, truncated, info = self.env.step(TORQUE * actions)
        last = info.get("final_info", info)
        self.error = np.abs(last["position"] - self.target)  # (B,)
        if truncated.any():
            info["final_obs"] = self._seen(info["final_obs"], last["position"])
            self.target = np.where(truncated, self.rng.uniform(-FURTHEST, FURTHEST, self.num_envs), self.target)
        reward = -self.error - 0.3 * np.sqrt(self.error)
        return self._seen(observation, info["position"]), reward, terminated, truncated, info

    def _seen(self, observation, position):
        c, s, v = observation.T
        return np.column_stack([self.target - position, s, c, v, self.target]).astype(np.float32)


def joints(model: Model, count: int, spread: float = 0.0) -> Reach:
    """As many joints with a task, their parameters drawn anew for every episode if there is a spread."""
    env = gym.make_vec(
        "pendulum_env/DirectDrivePendulum-v0", count, vectorization_mode="vector_entry_point", model=model, rate=RATE,
        substeps=10, max_torque=TORQUE, velocity="ideal", max_episode_steps=round(SECONDS * RATE),
        autoreset_mode="SameStep",
    )  # fmt: skip
    return Reach(RandomizePlantVector(env, spread) if spread else env)


def train(model: Model, seed: int, spread: float = 0.0) -> PPO:
    """A policy for the joint as the model has it."""
    torch.set_num_threads(1)
    env = BatchedVecEnv(joints(model, 64, spread))
    policy = PPO(
        "MlpPolicy", env, n_steps=50, batch_size=800, n_epochs=8, gamma=0.97, gae_lambda=0.9, learning_rate=1e-3,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0}, seed=seed, device="cpu",
    )  # fmt: skip
    return policy.learn(STEPS)


def evaluate(policy: PPO, plant: Model, seed: int) -> float:
    """Mean error at the end of an episode [rad]."""
    env = joints(plant, TRIALS)
    observation, _ = env.reset(seed=1000 + seed)
    errors = []
    for _ in range(round(SECONDS * RATE)):
        observation, *_ = env.step(policy.predict(observation, deterministic=True)[0])
        errors.append(env.error)
    return float(np.mean(errors[-round(SETTLED * RATE) :]))


@dataclass(frozen=True)
class Result:
    """Errors of the policies of all seeds [mrad]: in the simulator they were trained in, and on the joint."""

    name: str
    at_home: list[float]
    on_joint: list[float]


def interval(values: list[float]) -> tuple[float, float]:
    """Mean, and half width of its 95 % interval."""
    spread = np.std(values, ddof=1) / np.sqrt(len(values))
    return float(np.mean(values)), float(students_t.ppf(0.975, len(values) - 1) * spread)


def compare(say: Callable[[str], None] = print) -> list[Result]:
    """Record the joint, diagnose it, train on each model, and try the policies on the joint."""
    joint = make_plant(effects=HIDDEN)
    recording = record(joint, excitation("paper", np.random.default_rng(0)), 20.0, 500.0, rng=0)
    found = diagnose(recording)
    say(f"found: {', '.join(found.selected)}")
    base = found.steps[0].model
    results = []
    for name, model, spread in (
        ("paper's model, fitted", base, 0.0),
        ("paper's, randomised", base, SPREAD),
        ("diagnosed model", found.model, 0.0),
        ("diagnosed, randomised", found.model, SPREAD),
    ):
        policies = [train(model, seed, spread) for seed in range(SEEDS)]
        errors = [[1e3 * evaluate(policy, plant, k) for k, policy in enumerate(policies)] for plant in (model, joint)]
        results.append(Result(name, *errors))
        (home, more), (real, plus) = map(interval, errors)
        say(f"{name:22} at home {home:5.1f} ± {more:4.1f} mrad, on the joint {real:5.1f} ± {plus:4.1f} mrad")
    return results


def draw(results: list[Result], path: str) -> None:
    """A figure of the results: every seed a dot, means with their 95 % intervals."""
    figure, axes = plt.subplots(figsize=(7.0, 2.6), layout="constrained")
    for row, result in enumerate(results):
        for values, colour, up in ((result.at_home, "tab:grey", 0.14), (result.on_joint, "tab:blue", -0.14)):
            middle, half = interval(values)
            axes.plot(values, [row - up] * len(values), "o", color=colour, alpha=0.35, markersize=5, markeredgewidth=0)
            axes.errorbar(middle, row - up, xerr=half, fmt="|", color=colour, capsize=4, markersize=12)
    axes.set_yticks(range(len(results)), [f"trained on\n{result.name}" for result in results])
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.set_xlabel("error [mrad]: in the simulator (grey), on the joint (blue)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    outcome = compare()
    if len(sys.argv) > 1:
        draw(outcome, sys.argv[1])
