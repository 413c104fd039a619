"""Batch of pendulums in NumPy, with the physics of the pymunk backend."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from pendulum_env import spaces
from pendulum_env._typing import Array, Mask
from pendulum_env.backends.sensing import COUNTS, Sensor
from pendulum_env.lookup import find, refuse_unknown_arguments
from pendulum_env.parameters import PlantParameters, PlantProperties, Values
from pendulum_env.physics import Model, Samples, simulation
from pendulum_env.plant import Effects, make_plant

Batch = NDArray[np.float32]
Bools = NDArray[np.bool_]
AT_REST = np.array([1.0, 0.0, 0.0], dtype=np.float32)  # observation of a pendulum hanging down


class DirectDrivePendulumVector(PlantProperties, VectorEnv[Batch, Batch, Array]):
    """Batch of B direct-drive pendulums, made by `gymnasium.make_vec`.

    Actions (B, 1) and observations (B, 3) are those of `DirectDrivePendulum`. `info` has the layout of Gymnasium's
    `SyncVectorEnv`: arrays (B,), each with a mask; `info["plant"]` holds an array (B,) for each parameter. The
    pendulums start at rest, hanging down, and each is truncated after max_episode_steps. Rewards are 0 without a
    wrapper such as `InformationRewardVector`. Rendering is not supported.
    """

    @refuse_unknown_arguments
    def __init__(
        self,
        num_envs: int = 1,
        *,
        effects: Effects = (),
        theta: Mapping[str, float] | None = None,
        model: Model | str | Path | None = None,
        rate: float = 1000.0,
        substeps: int = 1,
        max_torque: float = spaces.MAX_TORQUE,
        counts: int = COUNTS,
        torque_noise: float = 0.0,
        velocity: str = "difference",
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Make the pendulums. Other arguments are those of `DirectDrivePendulum`.

        Args:
            num_envs: number B of pendulums.
            max_episode_steps: steps until an episode is truncated; None or -1: never.
            autoreset_mode: when a pendulum restarts after the end of its episode: with the next step, as Gymnasium's
                own environments do, or within the same step, with the last observation in `info["final_obs"]`.

        Raises:
            ValueError: if an argument is unknown or out of its range.
        """
        spaces.check_positive("pendulums", max_torque=max_torque, rate=rate, substeps=substeps, num_envs=num_envs)
        self.autoreset = AutoresetMode(autoreset_mode)
        if self.autoreset is AutoresetMode.DISABLED:
            raise ValueError("pendulums restart by themselves: choose autoreset_mode NextStep or SameStep")
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset}
        ideal = find("velocity", velocity, spaces.VELOCITIES)
        self.sensor, self.counts = Sensor(counts, torque_noise, ideal), counts
        self.num_envs, self.rate, self.substeps, self.max_torque = num_envs, float(rate), int(substeps), max_torque
        self.max_episode_steps = np.inf if max_episode_steps in (None, -1) else max_episode_steps
        self.render_mode = None
        self.single_observation_space, self.single_action_space = spaces.make_spaces(max_torque)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all_plants, self._no_plants = np.ones(num_envs, dtype=bool), np.zeros(num_envs, dtype=bool)
        self._set_plant(make_plant(theta, effects, model))

    def _set_plant(self, model: Model) -> None:
        """Set the plant of all pendulums, which wait for a reset."""
        self.plant = PlantParameters(model, (self.num_envs,))
        self._x: Samples | None = None
        self._update_plant()

    def add_effects(self, effects: Effects) -> None:
        """Hide further effects in all plants, in the form of the argument `effects`; a reset must follow.

        Raises:
            ValueError: if an effect is unknown, impossible or already in the plants.
        """
        self._set_plant(make_plant(effects=effects, model=self.model))

    def set_parameters(self, parameters: Values, which: Mask | None = None) -> None:
        """Change parameters by name, scalars or (B,), of all pendulums or of the mask `which`, until their next reset.

        Raises:
            ValueError: if a parameter is unknown or impossible.
        """
        self.plant.change(parameters, which)
        self._update_plant()

    def _update_plant(self) -> None:
        """Pass changed parameters to the torque balance."""
        self._balance = simulation.TorqueBalance(self.plant.terms, self.plant.theta)
        if self._x is not None:
            self._command.set_delay(self._balance.terms)
        self._parameters = self.plant.info

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Batch, dict[str, Any]]:
        """Begin an episode of all pendulums.

        Args:
            seed: seed of the one generator of measurement noise of all pendulums, or a list of seeds.
            options: `position` [rad] and `velocity` [rad/s], scalars or (B,); `theta`, parameters by name for this and
                later episodes, scalars or (B,).

        Raises:
            ValueError: if an option is unknown or impossible.
        """
        super().reset(seed=spaces.merge_seeds(seed, self.num_envs))
        options = options or {}
        for name in options:
            find("option of reset", name, spaces.RESET_OPTIONS)
        position, velocity = spaces.read_start(options, (self.num_envs,))
        self.steps = np.zeros(self.num_envs, dtype=np.int64)
        self._ended = self._no_plants
        self.plant.reset(options.get("theta"))
        self._command = simulation.CommandDelay(self.plant.terms, 1.0 / self.rate, self.substeps)
        self._update_plant()
        self._x = simulation.make_start_samples(self._balance, position, velocity)
        self._previous_position = self.sensor.position(position - velocity / self.rate)
        observation, info = self._make_observation(np.zeros(self.num_envs), clipped=self._no_plants.copy())
        return observation, {**info, "torque": np.zeros(self.num_envs)}

    def step(  # type: ignore[override]  # Gymnasium gives flags the type of rewards
        self, actions: Batch
    ) -> tuple[Batch, Array, Bools, Bools, dict[str, Any]]:
        """Hold the torques (B, 1) for one period.

        Raises:
            ValueError: if an action is NaN or the shape is not (B, 1).
        """
        if self._x is None:
            raise gym.error.ResetNeeded("the pendulums have not been started: call reset before step")
        if np.shape(actions) != (self.num_envs, 1):
            raise ValueError(f"the actions have shape {np.shape(actions)}, {self.num_envs} pendulums need one each")
        unclipped = np.asarray(actions, dtype=float)[:, 0]
        torque = np.clip(unclipped, -self.max_torque, self.max_torque)
        if np.isnan(torque).any():
            raise ValueError(f"the action of pendulum {int(np.isnan(torque).argmax())} is NaN: a torque is needed")
        is_reset = self._ended if self.autoreset is AutoresetMode.NEXT_STEP else self._no_plants
        x, h = self._x, 1.0 / self.rate / self.substeps
        for command in self._command.delay_command(torque):
            x = simulation.step(self._balance, replace(x, torque=command), h)
        self.steps = self.steps + 1
        self._x = replace(x, time=self.steps / self.rate)
        if is_reset.any():
            torque = np.where(is_reset, 0.0, torque)
            self._restart(is_reset)
        observation, info = self._make_observation(
            torque, clipped=spaces.is_beyond(unclipped, self.max_torque) & ~is_reset
        )
        truncated = self._ended = self.steps >= self.max_episode_steps
        if self.autoreset is AutoresetMode.SAME_STEP and truncated.any():
            info = {"final_obs": observation, "_final_obs": truncated, "final_info": info, "_final_info": truncated}
            self._restart(truncated)
            observation = np.where(truncated[:, None], AT_REST, observation)
            for name in ("time", "position", "velocity", "torque", "clipped"):
                info[name] = np.where(truncated, np.zeros_like(info["final_info"][name]), info["final_info"][name])
            info["plant"] = dict(self._parameters)
            info |= {name: self._all_plants for name in info["final_info"] if name not in info}
        return observation, np.zeros(self.num_envs), self._no_plants.copy(), truncated, info

    def _restart(self, is_reset: Mask) -> None:
        """Reset the pendulums in the mask `is_reset` (B,): at rest, hanging down, with initial parameters."""
        self.plant.restart(is_reset)
        self._update_plant()
        assert self._x is not None
        at_rest = simulation.make_start_samples(self._balance, *np.zeros((2, self.num_envs)))
        rows = [
            np.where(is_reset, *values)
            for values in zip(simulation.stack_rows(at_rest), simulation.stack_rows(self._x), strict=True)
        ]
        self._x = simulation.unstack_rows(rows, self._x)
        self._previous_position = np.where(is_reset, 0.0, self._previous_position)
        self._command.clear(is_reset)
        self.steps = np.where(is_reset, 0, self.steps)

    def _make_observation(self, torque: Array, clipped: Bools) -> tuple[Batch, dict[str, Any]]:
        """Return observations (B, 3) and info after `torque` (B,), with the mask of clipped actions (B,)."""
        assert self._x is not None
        position, velocity = self.sensor.measure(self._x.position, self._x.velocity, self._previous_position, self.rate)
        self._previous_position = position
        bounded = np.clip(velocity, -spaces.MAX_VELOCITY, spaces.MAX_VELOCITY)
        observation = np.stack([np.cos(position), np.sin(position), bounded], axis=1, dtype=np.float32)
        measurement = {
            "time": self._x.time,
            "position": position,
            "velocity": velocity,
            "torque": np.asarray(self.sensor.torque(torque, self.np_random)),
            "clipped": clipped,
            "follows": self._all_plants,
            "plant": dict(self._parameters),
        }
        return observation, measurement | {f"_{name}": self._all_plants for name in measurement}
