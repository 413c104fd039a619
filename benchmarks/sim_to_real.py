"""What it is worth to name effects before training: policies from four simulators, on a joint that none of them is.

python -m benchmarks.sim_to_real      # needs the extra rl

The joint is simulated by code that shares nothing with the packages: the paper's pendulum behind a gear and a bus,
with Stribeck friction, friction that grows with the torque, and torque that comes a period of the policy late. It is
recorded, and `diagnose` names what it can. PPO learns to bring the joint to an angle, in the base model fitted to the
same recordings and in the diagnosed one, each as it is and with parameters drawn anew for every episode. All policies
are tried on the joint.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from scipy.stats import sem
from scipy.stats import t as students_t

from benchmarks.independent_plant import Experiment, Plant, simulate, steer
from benchmarks.parallel import each
from estimators import diagnose
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.plant import PAPER
from pendulum_env.recording import Recording
from pendulum_env.registration import PENDULUM
from pendulum_env.wrappers import RandomizePlantVector
from workbench.terminal import Terminal

STRIBECK = {"strib_d": 0.45, "strib_v": 0.5}  # [N m], [rad/s]: breaks loose at half as much again as it slides with
LOSS = 0.2  # of the motor's torque, in a gear with an efficiency of 80 %
DELAY = 0.02  # [s], a period of the policy
EXCITATIONS = ("two_tone", "steps")  # the paper's, and one that jumps as a reach does
LOGGED, LENGTH = 500.0, 10.0  # [Hz], [s] of each of two recordings of a kind, the second held out

SPREAD = 0.3  # of the four base parameters, where nothing better is known
STEPS = 200_000  # of a training
RATE, SECONDS = 50.0, 2.0  # of the policy [Hz], of an episode [s]
TORQUE = 5.0  # [N m], bound
FURTHEST = 1.0  # [rad], of a target
TRIALS = 256  # targets of an evaluation
SETTLED = 0.5  # [s] at the end of an episode, over which the error counts
REACHED = np.deg2rad(1.0)  # error [rad] that is not exceeded then

Act = Callable[[Array], Array]  # positions (B,) [rad] to torques (B,) [N m]


class Reach(VectorWrapper):  # type: ignore[misc, type-arg]
    """Bring each joint to an angle of its own and keep it there; it starts at rest, hanging down.

    Action (1,): torque over its bound. Reward of a step: minus the error, and less of its root, so that the last
    milliradians count as well. For observations see `observed`.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        super().__init__(env)
        self.single_observation_space = gym.spaces.Box(-np.inf, np.inf, (6,), np.float32)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Draw new targets."""
        self.rng = np.random.default_rng(seed)
        self.target = self.rng.uniform(-FURTHEST, FURTHEST, self.num_envs)
        _, info = self.env.reset(seed=seed, options=options)
        return observed(self.target, info["position"], info["velocity"], np.zeros(self.num_envs)), info

    def step(self, actions: Array) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Hold the torques for a period; a joint whose episode has ended gets a new target."""
        _, _, terminated, truncated, info = self.env.step(TORQUE * actions)
        before, last = actions[:, 0], info.get("final_info", info)
        self.error = np.abs(last["position"] - self.target)  # (B,)
        if truncated.any():
            info["final_obs"] = observed(self.target, last["position"], last["velocity"], before)
            self.target = np.where(truncated, self.rng.uniform(-FURTHEST, FURTHEST, self.num_envs), self.target)
        reward = -self.error - 0.3 * np.sqrt(self.error)
        seen = observed(self.target, info["position"], info["velocity"], np.where(truncated, 0.0, before))
        return seen, reward, terminated, truncated, info


def observed(target: Array, position: Array, velocity: Array, action: Array) -> np.ndarray:
    """What a policy is told (B, 6): error [rad], sin q, cos q, q' [rad/s], target [rad], and its last action."""
    told = (target - position, np.sin(position), np.cos(position), velocity, target, action)
    return np.column_stack(told).astype(np.float32)


def joint(rate: float) -> Plant:
    """The joint, to be given torques at a rate [Hz]."""
    late = {"dead_n": DELAY * rate}
    hidden = {"stribeck": STRIBECK, "load_dependent_friction": {"load_mu": LOSS}, "dead_time": late}
    return Plant(**PAPER, effects=hidden)


def models(seed: int, terminal: Terminal) -> tuple[Model, Model]:
    """The base model fitted to recordings of the joint, and what the diagnosis makes of them."""
    kinds = [kind for _ in range(2) for kind in EXCITATIONS]
    cases = [(joint(LOGGED), Experiment(LOGGED, LENGTH, kind, seed=10 * seed + k)) for k, kind in enumerate(kinds)]
    recordings = [Recording(f"{k}", run.time, run.position, run.torque) for k, run in enumerate(simulate(cases))]
    found = diagnose(recordings[: len(EXCITATIONS)], recordings[len(EXCITATIONS) :])
    base = found.steps[0].model
    terminal.say(found.headline)
    rows = [
        (name, base.estimates[name].text if name in base.estimates else "", estimate.text, estimate.unit)
        for name, estimate in found.model.estimates.items()
    ]
    terminal.table(("parameter", "base model", "diagnosed model", "unit"), rows)
    return base, found.model


def joints(model: Model, count: int, episode: int | None = None) -> VectorEnv[Any, Any, Any]:
    """As many joints as a model has them, and for a training the periods of an episode."""
    return gym.make_vec(
        PENDULUM, count, vectorization_mode="vector_entry_point", model=model, rate=RATE, substeps=10,
        max_torque=TORQUE, max_episode_steps=episode, autoreset_mode="SameStep",
    )  # fmt: skip


def train(model: Model, seed: int, spread: float | str = 0.0, steps: int = STEPS) -> Any:
    """A policy for the joint as the model has it, or as the spread allows (see `RandomizePlant`)."""
    import torch
    from stable_baselines3 import PPO

    from agents.vec_env import BatchedVecEnv

    torch.set_num_threads(1)
    env = joints(model, 64, round(SECONDS * RATE))
    env = BatchedVecEnv(Reach(RandomizePlantVector(env, spread) if spread else env))
    policy = PPO(
        "MlpPolicy", env, n_steps=50, batch_size=800, n_epochs=8, gamma=0.97, gae_lambda=0.9, learning_rate=1e-3,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0}, seed=seed, device="cpu",
    )  # fmt: skip
    return policy.learn(steps)


def controller(policy: Any, target: Array) -> Act:
    """A policy as what is asked once a period, from rest, hanging down."""
    before, action = np.zeros((2, len(target)))

    def act(position: Array) -> Array:
        nonlocal before, action
        seen = observed(target, position, (position - before) * RATE, action)
        before, action = position, policy.predict(seen, deterministic=True)[0][:, 0]
        return TORQUE * action

    return act


def in_simulator(model: Model, count: int, act: Act) -> Array:
    """Positions (N, B) of joints as the model has them."""
    env = joints(model, count)
    positions = [env.reset()[1]["position"]]
    while len(positions) < round(SECONDS * RATE):
        positions.append(env.step(act(positions[-1])[:, None])[-1]["position"])
    return np.array(positions)


def on_joint(count: int, act: Act) -> Array:
    """Positions (N, B) of the joint itself."""
    return np.column_stack([run.position for run in steer([(joint(RATE), Experiment(RATE, SECONDS))] * count, act)])


class Tried(NamedTuple):
    """Mean error [mrad] and share [%] of targets reached."""

    error: float
    reached: float

    @classmethod
    def of(cls, run: Callable[[int, Act], Array], policy: Any, target: Array) -> Tried:
        end = run(len(target), controller(policy, target))[-round(SETTLED * RATE) :]
        errors = np.abs(end - target)
        return cls(1e3 * float(errors.mean()), 100 * float(np.mean(errors.max(axis=0) < REACHED)))


class Work(NamedTuple):
    """A training, and what came of it in its simulator and on the joint."""

    name: str
    model: Model
    spread: float | str
    seed: int
    at_home: Tried | None = None
    on_joint: Tried | None = None


def tried(work: Work) -> Work:
    """Train, and try the policy."""
    policy = train(work.model, work.seed, work.spread)
    target = np.random.default_rng(1000 + work.seed).uniform(-FURTHEST, FURTHEST, TRIALS)
    home = Tried.of(partial(in_simulator, work.model), policy, target)
    return work._replace(at_home=home, on_joint=Tried.of(on_joint, policy, target))


def main(argv: Sequence[str] | None = None) -> int:
    """Print what the joint is taken for, and a row for each simulator: means over seeds with 95 % intervals."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sim_to_real", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5, help="trainings in each simulator (default 5)")
    parser.add_argument("--seed", type=int, default=0, help="of the recordings")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args(argv)
    if args.seeds < 2:
        parser.error("--seeds should be 2 or more: the intervals are over them")
    terminal = Terminal()
    base, found = models(args.seed, terminal)
    share = f"{SPREAD:.0%}".replace("%", " %")
    kinds: list[tuple[str, Model, float | str]] = [
        ("base model", base, 0.0),
        (f"base model, drawn within {share}", base, SPREAD),
        ("diagnosed model", found, 0.0),
        ("diagnosed model, drawn by its covariance", found, "covariance"),
    ]
    jobs = [Work(*kind, seed) for seed in range(args.seeds) for kind in kinds]
    done = each(tried, jobs, workers=args.workers, title="training", terminal=terminal)
    rows = []
    for name, *_ in kinds:
        cells = []
        for quantity in Tried._fields:
            for where in ("at_home", "on_joint"):
                values = [getattr(getattr(work, where), quantity) for work in done if work.name == name]
                cells.append(f"{np.mean(values):.1f} ± {students_t.ppf(0.975, len(values) - 1) * sem(values):.1f}")
        rows.append((name, *cells))
    terminal.heading("Errors at the end, and targets reached, in the simulator of the training and on the joint")
    terminal.table(("trained in", "error [mrad]", "on the joint", "reached [%]", "on the joint"), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
