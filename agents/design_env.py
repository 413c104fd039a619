"""Environments in which an agent chooses the torque of a pendulum with unknown parameters, every 20 ms.

The agent sees the measurements of a rig: the angle, the velocity by differences, and the estimates from them. The true
parameters are only in `info`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from agents.observer import CONSTRAINTS, EPISODE, NOMINAL, OBSERVATION_SIZE, TICK, Observer, compute_log_det
from agents.task import Task, TaskState, TaskVector
from pendulum_env._typing import Array
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.lookup import find, refuse_unknown_arguments
from pendulum_env.plant import PAPER, Effects, make_plant
from pendulum_env.rendering import MODES, Renderer
from pendulum_env.vector_env import DirectDrivePendulumVector
from pendulum_env.wrappers.drawing import replace_drawn
from pendulum_env.wrappers.randomize_plant import Spread

RATE = 1000.0  # [Hz] of measurement and physics
STARTS = {"swing": (np.pi / 3, 2 * np.pi / 3), "rest": (0.0, 0.0)}  # range of the initial angle, to either side [rad]


class ExcitationDesignVector(TaskVector):
    """B pendulums with unknown parameters, drawn at random for each episode; made by `gymnasium.make_vec`.

    Action (B, 1): torque as a share of the peak, in [-1, 1], held for 20 ms. Observation (B, 20): sin q, cos q,
    q' / 10; log information of inertia, gravity, viscous and dry friction, their six correlations, deviation of the
    estimates from nominal; shares of time and budget left; 1 if the joint is stuck. Reward: gain of log det information
    [nat], 0 in a tick in which |q'| falls below 0.2 rad/s. All episodes have the same length and end together.

    `info` has `torque`, the applied torque [N m] (B,). It has `positions` [rad] and `torques` [N m], measured at 1 kHz
    since the last observation (B, 20). It has `estimates` (B,) by name, and `plant`, the true parameters (B,) by name,
    as in `DirectDrivePendulumVector`. `information` (B, 4, 4) has the order of the estimates, in nominal units. The
    option `theta` of a reset sets some of the true parameters by name.
    """

    options = ("theta",)

    @refuse_unknown_arguments
    def __init__(
        self,
        num_envs: int = 1,
        *,
        constraint: str = "peak",
        seconds: float = EPISODE,
        spread: float = 0.3,
        effects: Effects = (),
        counts: int = COUNTS,
        torque_noise: float = TORQUE_NOISE,
        start: str = "swing",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Make the environments.

        Args:
            num_envs: number B of pendulums.
            constraint: "peak", 6 N m, or "rms", 3 N m root mean square and 15 N m at most.
            seconds: duration of an episode [s].
            spread: relative half width of the distribution of the four parameters.
            effects: hidden in the plants, as `stribeck=0.4` or `{"stribeck": 0.4}`; the estimator does not
                model them.
            counts: encoder counts per turn; 0 measures the angle exactly.
            torque_noise: standard deviation of the measured torque [N m].
            start: "swing", released at 60 to 120 degrees to either side, where gravity exceeds dry friction; or "rest",
                hanging down, as the rig. From rest, a policy of small torques learns nothing: the joint is stuck.
            autoreset_mode: when the next episodes begin, as in `DirectDrivePendulumVector`.

        Raises:
            ValueError: if an argument is unknown or out of its range.
        """
        self.constraint = find("constraint", constraint, CONSTRAINTS)
        self.observer = Observer(self.constraint, seconds, RATE)
        super().__init__(num_envs, OBSERVATION_SIZE, 1, autoreset_mode)
        self.pendulums = DirectDrivePendulumVector(
            num_envs,
            model=make_plant(effects=effects),
            rate=RATE,
            max_torque=self.constraint.peak,
            counts=counts,
            torque_noise=torque_noise,
            autoreset_mode=autoreset_mode,
        )
        self._spread, self._start = Spread(self.pendulums.model, spread), find("start", start, STARTS)

    def _begin_episodes(self, options: dict[str, Any]) -> TaskState:
        options = replace_drawn(self._spread.draw(self.np_random, self.num_envs), options)
        low, high = self._start
        if high > 0:
            side = self.np_random.choice([-1.0, 1.0], self.num_envs)
            options["position"] = side * self.np_random.uniform(low, high, self.num_envs)
        _, info = self.pendulums.reset(seed=int(self.np_random.integers(2**31)), options=options)
        self._steps_left, self._plant = self.observer.ticks, info["plant"]
        self.observer.start(info["position"], info["velocity"])
        none = np.zeros((self.observer.samples_per_tick, self.num_envs))
        return self._make_state(np.zeros(self.num_envs), none + info["position"], none)

    def _apply_actions(self, shares: Array) -> TaskState:
        torque = self.observer.limit_torque(shares[:, 0])
        positions, torques = self._hold_torque(torque)
        self.observer.add_tick(positions, torques)
        return self._make_state(torque, positions, torques)

    def _hold_torque(self, torque: Array) -> tuple[Array, Array]:
        """Hold a torque for a tick, and return the measured positions and torques (samples_per_tick, B)."""
        positions, torques = np.empty((2, self.observer.samples_per_tick, self.num_envs))
        action = torque[:, None]
        for k in range(self.observer.samples_per_tick):
            info = self.pendulums.step(action)[-1]  # type: ignore[arg-type]  # without rounding to float32
            positions[k], torques[k] = info["position"], info["torque"]
        return positions, torques

    def _make_state(self, torque: Array, positions: Array, torques: Array) -> TaskState:
        observer = self.observer
        info = {"torque": torque, "positions": positions.T, "torques": torques.T, "plant": dict(self._plant)}
        info |= {"information": observer.information, "estimates": self._name_estimates()}
        return observer.observe(), compute_log_det(observer.information), info

    def _name_estimates(self) -> dict[str, Any]:
        """Return the estimates (B,) in SI units by name, with Gymnasium's masks."""
        estimates = dict(zip(PAPER, (self.observer.estimates * NOMINAL).T, strict=True))
        return estimates | {f"_{name}": np.ones(self.num_envs, dtype=bool) for name in estimates}


class ExcitationDesign(Task):
    """One pendulum with unknown parameters: `ExcitationDesignVector` with a batch of one.

    Action (1,), observation (20,), reward and `info` are those of the batch, without the first axis. An episode is
    truncated after `seconds`, by default after 10 s or 500 steps.
    """

    _batch: ExcitationDesignVector
    metadata = {"render_modes": list(MODES), "render_fps": round(1 / TICK)}  # noqa: RUF012  (Gymnasium's own interface)

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:
        """Make the environment.

        Args:
            render_mode: "rgb_array" or "human".
            arguments: of `ExcitationDesignVector`, without `num_envs`.
        """
        self.render_mode, self._renderer = render_mode, Renderer(render_mode)
        super().__init__(ExcitationDesignVector(1, **arguments))

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the pendulum, its torque and the reward of the episode (H, W, 3); return None in mode human."""
        observer, info = self._batch.observer, self._last_info
        measurement = {"time": TICK * observer.tick, "position": info["positions"][-1], "torque": info["torques"][-1]}
        return self._renderer.draw(measurement, observer.constraint.peak, (f"reward {self._episode_reward:.1f}",))

    def close(self) -> None:
        """Close the window."""
        self._renderer.close()
