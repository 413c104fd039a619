"""Choosing an excitation as a task: hold a torque for 20 ms, be paid for what it taught, on a plant unknown to 30 %.

The agent sees what an online estimator on the rig would: measured angle, velocity by differences, and what follows from
them. It never sees the plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from agents.knowledge import log_det
from agents.observer import BOUND, CONSTRAINTS, EPISODE, TICK, Batch, Observer
from pendulum_env._typing import Array
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.lookup import find
from pendulum_env.plant import make_plant
from pendulum_env.rendering import MODES, Renderer
from pendulum_env.vector_env import DirectDrivePendulumVector
from pendulum_env.wrappers.randomize_plant import Spread

RATE = 1000.0  # [Hz], of the measurement and of the physics

Bools = NDArray[np.bool_]


class ExcitationDesignVector(VectorEnv[Batch, Batch, Array]):
    """B pendulums whose parameters are to be learnt, each drawn anew at every episode; made by `gymnasium.make_vec`.

    Action (B, 1): torque as a share of the peak, in [-1, 1], held for 20 ms. Observation (B, 20): sin q, cos q,
    q' / 10; log information of inertia, gravity, viscous and dry friction, their six correlations, deviation of the
    estimates from nominal; share of time left, of budget left, and whether the joint is stuck; under a limit on turns
    also the share of the way to it, signed. Reward: growth of log det information [nat], none of
    a tick in which |q'| falls below 0.2 rad/s. All episodes last equally long and end together.

    `info`: `torque` that acted [N m] (B,), `positions` [rad] and `torques` [N m] as measured at 1 kHz since the last
    observation (B, 20), `information` (B, 4, 4) and `estimates` (B, 4) in nominal units; after a reset also `plant`,
    the true parameters (B, P).
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        constraint: str = "peak",
        max_speed: float | None = None,
        max_turns: float | None = None,
        seconds: float = EPISODE,
        spread: float = 0.3,
        effects: Sequence[str] = (),
        counts: int = COUNTS,
        torque_noise: float = TORQUE_NOISE,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Make the environments.

        Args:
            num_envs: number B of pendulums.
            constraint: "peak", 6 N m, or "rms", 3 N m root mean square and 15 N m at most.
            max_speed: beyond which no torque acts that drives the arm on [rad/s]; None for no limit.
            max_turns: to either side, beyond which likewise no torque acts that drives it outwards.
            seconds: length of an episode.
            spread: relative half width within which the four parameters are drawn.
            effects: hidden in the plants, as `stribeck=0.4`; the estimator does not know of them.
            counts: of the encoder per turn; 0 measures the angle exactly.
            torque_noise: standard deviation of the measured torque [N m].
            autoreset_mode: as of the pendulums.

        Raises:
            ValueError: if an argument is unknown or out of its range.
        """
        self.constraint = find("constraint", constraint, CONSTRAINTS)
        self.observer = Observer(self.constraint, seconds, RATE, max_speed, max_turns)
        self.autoreset = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset}
        self.num_envs, self.render_mode = num_envs, None
        self.pendulums = DirectDrivePendulumVector(
            num_envs,
            model=make_plant(effects=effects),
            rate=RATE,
            max_torque=self.constraint.peak,
            counts=counts,
            torque_noise=torque_noise,
            autoreset_mode=autoreset_mode,
        )
        self._spread = Spread(self.pendulums.model, spread)
        self.single_observation_space = gym.spaces.Box(-BOUND, BOUND, (self.observer.inputs,), dtype=np.float32)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (1,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._everyone = np.ones(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Batch, dict[str, Any]]:
        """Begin an episode with new plants, at rest and hanging down; the same seed draws the same plants and noise.

        Args:
            seed: of plants and noise, one for all; of a list, the first.
            options: `plant`, true parameters (P, B) in the place of those drawn.

        Raises:
            ValueError: if an option is unknown, or a plant impossible.
        """
        super().reset(seed=seed[0] if isinstance(seed, list) else seed)
        for name in options or {}:
            find("option of reset", name, {"plant": 0})
        return self._begin((options or {}).get("plant"))

    def _begin(self, plant: Array | None = None) -> tuple[Batch, dict[str, Any]]:
        plant = self._spread.draw(self.np_random, self.num_envs) if plant is None else plant
        _, info = self.pendulums.reset(seed=int(self.np_random.integers(2**31)), options={"theta": plant})
        self._ended = False
        self.observer.start(info["position"], info["velocity"])
        self._known = log_det(self.observer.knowledge.information)
        none = np.zeros((self.num_envs, self.observer.held))
        start = none + info["position"][:, None]
        return self.observer.observe(), self._info(np.zeros(self.num_envs), start, none, plant.T)

    def step(  # type: ignore[override]  # Gymnasium types the flags like the rewards
        self, actions: Batch
    ) -> tuple[Batch, Array, Bools, Bools, dict[str, Any]]:
        """Hold torques (B, 1), shares of the peak, for 20 ms.

        Raises:
            ValueError: if an action is no number.
        """
        if np.shape(actions) != (self.num_envs, 1):
            raise ValueError(f"the actions have shape {np.shape(actions)}, {self.num_envs} pendulums need one each")
        nobody = ~self._everyone
        if self._ended and self.autoreset is AutoresetMode.NEXT_STEP:
            observation, info = self._begin()
            return observation, np.zeros(self.num_envs), nobody, nobody.copy(), info
        torque = self.observer.allow(np.asarray(actions, dtype=float)[:, 0])
        positions, torques = self._hold(torque)
        self.observer.take(positions, torques)
        before, self._known = self._known, log_det(self.observer.knowledge.information)
        reward = self._known - before
        self._ended = self.observer.tick >= self.observer.ticks
        observation, info = self.observer.observe(), self._info(torque, positions.T, torques.T)
        truncated = np.full(self.num_envs, self._ended)
        if self._ended and self.autoreset is AutoresetMode.SAME_STEP:
            final = {"final_obs": observation, "_final_obs": truncated, "final_info": info, "_final_info": truncated}
            observation, info = self._begin()
            info |= final
        return observation, reward, nobody, truncated, info

    def _hold(self, torque: Array) -> tuple[Array, Array]:
        """Measured positions and torques (held, B) while a torque is held."""
        positions, torques = np.empty((2, self.observer.held, self.num_envs))
        action = torque[:, None]
        for k in range(self.observer.held):
            info = self.pendulums.step(action)[-1]  # type: ignore[arg-type]  # without rounding to float32
            positions[k], torques[k] = info["position"], info["torque"]
        return positions, torques

    def _info(self, torque: Array, positions: Array, torques: Array, plant: Array | None = None) -> dict[str, Any]:
        knowledge = self.observer.knowledge
        seen: dict[str, Any] = {"torque": torque, "positions": positions, "torques": torques}
        seen |= {"information": knowledge.information, "estimates": knowledge.estimates}
        seen |= {} if plant is None else {"plant": plant}
        return seen | {f"_{name}": self._everyone for name in seen}


class ExcitationDesign(gym.Env[Batch, Batch]):
    """One pendulum whose parameters are to be learnt: `ExcitationDesignVector` with a batch of one.

    Action (1,), observation (20,), reward and `info` are those of the batch, without its first axis. An episode is
    truncated after `seconds`, 10 s or 500 steps by default; none terminates.
    """

    metadata = {"render_modes": list(MODES), "render_fps": round(1 / TICK)}  # noqa: RUF012  (Gymnasium's own interface)

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:
        """Make it; the arguments are those of `ExcitationDesignVector` but for the number of pendulums.

        Args:
            render_mode: "rgb_array" or "human".
            arguments: of the batch.
        """
        self.render_mode, self._renderer = render_mode, Renderer(render_mode)
        self._batch = ExcitationDesignVector(1, **arguments)
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Batch, dict[str, Any]]:
        """Begin an episode with a new plant; `options["plant"]` (P,) is taken in its place."""
        super().reset(seed=seed)
        if options and "plant" in options:
            options = {**options, "plant": np.reshape(options["plant"], (-1, 1))}
        observation, info = self._batch.reset(seed=seed, options=options)
        self._paid = 0.0
        return observation[0], self._show(info)

    def step(self, action: Batch) -> tuple[Batch, float, bool, bool, dict[str, Any]]:
        """Hold a torque, a share of the peak, for 20 ms."""
        observation, reward, _, truncated, info = self._batch.step(np.reshape(action, (1, 1)))
        self._paid += float(reward[0])
        return observation[0], float(reward[0]), False, bool(truncated[0]), self._show(info)

    def _show(self, info: dict[str, Any]) -> dict[str, Any]:
        """Info of the only pendulum of a batch."""
        self._last = single(info)
        if self.render_mode == "human":
            self.render()
        return self._last

    def render(self) -> NDArray[np.uint8] | None:
        """Picture (H, W, 3) of the arm, its torque and the reward of the episode so far; None in mode human."""
        observer, seen = self._batch.observer, self._last
        measurement = {"time": TICK * observer.tick, "position": seen["positions"][-1], "torque": seen["torques"][-1]}
        return self._renderer.draw(measurement, observer.constraint.peak, (f"reward {self._paid:.1f} so far",))

    def close(self) -> None:
        """Let go of the window."""
        self._renderer.close()


def single(info: dict[str, Any]) -> dict[str, Any]:
    """Info of the only one of a batch."""
    return {name: value[0] for name, value in info.items() if not name.startswith("_")}
