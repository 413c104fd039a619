"""Choosing an excitation as a task: hold a torque for 20 ms, be paid for what it taught, on a plant unknown to 30 %.

The agent sees what an online estimator on the rig would: measured angle, velocity by differences, and what follows from
them. It never sees the plant.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from agents.observer import CONSTRAINTS, EPISODE, TICK, Observer, log_det
from agents.task import Seen, Task, TaskVector
from pendulum_env._typing import Array
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.lookup import find, with_known_arguments
from pendulum_env.plant import Effects, make_plant
from pendulum_env.rendering import MODES, Renderer
from pendulum_env.vector_env import DirectDrivePendulumVector
from pendulum_env.wrappers.randomize_plant import Spread

RATE = 1000.0  # [Hz], of the measurement and of the physics


class ExcitationDesignVector(TaskVector):
    """B pendulums whose parameters are to be learnt, each drawn anew at every episode; made by `gymnasium.make_vec`.

    Action (B, 1): torque as a share of the peak, in [-1, 1], held for 20 ms. Observation (B, 20): sin q, cos q,
    q' / 10; log information of inertia, gravity, viscous and dry friction, their six correlations, deviation of the
    estimates from nominal; share of time left, of budget left, and whether the joint is stuck; under a limit on turns
    also the share of the way to it, signed. Reward: growth of log det information [nat], none of
    a tick in which |q'| falls below 0.2 rad/s. All episodes last equally long and end together.

    `info`: `torque` that acted [N m] (B,), `positions` [rad] and `torques` [N m] as measured at 1 kHz since the last
    observation (B, 20), `information` (B, 4, 4) and `estimates` (B, 4) in nominal units; `plant`, the true parameters
    (B,) by name, as of `DirectDrivePendulumVector`. The option `theta` of a reset gives some of these, by name, or all
    linear ones (P, B).
    """

    options = ("theta",)

    @with_known_arguments
    def __init__(
        self,
        num_envs: int = 1,
        *,
        constraint: str = "peak",
        max_speed: float | None = None,
        max_turns: float | None = None,
        seconds: float = EPISODE,
        spread: float = 0.3,
        effects: Effects = (),
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
            effects: hidden in the plants, as `stribeck=0.4` or `{"stribeck": 0.4}`; the estimator does not
                know of them.
            counts: of the encoder per turn; 0 measures the angle exactly.
            torque_noise: standard deviation of the measured torque [N m].
            autoreset_mode: as of the pendulums.

        Raises:
            ValueError: if an argument is unknown or out of its range.
        """
        self.constraint = find("constraint", constraint, CONSTRAINTS)
        self.observer = Observer(self.constraint, seconds, RATE, max_speed, max_turns)
        super().__init__(num_envs, self.observer.inputs, 1, autoreset_mode)
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

    def _begin(self, options: dict[str, Any]) -> Seen:
        given = options.get("theta", {})
        if isinstance(given, Mapping):
            given = {**self._spread.draw_by_name(self.np_random, self.num_envs), **given}
        elif np.ndim(given) == 1 and self.num_envs == 1:
            given = np.asarray(given)[:, None]  # of a single pendulum
        _, info = self.pendulums.reset(seed=int(self.np_random.integers(2**31)), options={"theta": given})
        self._left, self._plant = self.observer.ticks, info["plant"]
        self.observer.start(info["position"], info["velocity"])
        none = np.zeros((self.observer.held, self.num_envs))
        return self._seen(np.zeros(self.num_envs), none + info["position"], none)

    def _go(self, shares: Array) -> Seen:
        torque = self.observer.allow(shares[:, 0])
        positions, torques = self._hold(torque)
        self.observer.take(positions, torques)
        return self._seen(torque, positions, torques)

    def _hold(self, torque: Array) -> tuple[Array, Array]:
        """Measured positions and torques (held, B) while a torque is held."""
        positions, torques = np.empty((2, self.observer.held, self.num_envs))
        action = torque[:, None]
        for k in range(self.observer.held):
            info = self.pendulums.step(action)[-1]  # type: ignore[arg-type]  # without rounding to float32
            positions[k], torques[k] = info["position"], info["torque"]
        return positions, torques

    def _seen(self, torque: Array, positions: Array, torques: Array) -> Seen:
        observer = self.observer
        info = {"torque": torque, "positions": positions.T, "torques": torques.T, "plant": dict(self._plant)}
        info |= {"information": observer.information, "estimates": observer.estimates}
        return observer.observe(), log_det(observer.information), info


class ExcitationDesign(Task):
    """One pendulum whose parameters are to be learnt: `ExcitationDesignVector` with a batch of one.

    Action (1,), observation (20,), reward and `info` are those of the batch, without its first axis. An episode is
    truncated after `seconds`, 10 s or 500 steps by default; none terminates.
    """

    _batch: ExcitationDesignVector
    metadata = {"render_modes": list(MODES), "render_fps": round(1 / TICK)}  # noqa: RUF012  (Gymnasium's own interface)

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:
        """Make it; the arguments are those of `ExcitationDesignVector` but for the number of pendulums.

        Args:
            render_mode: "rgb_array" or "human".
            arguments: of the batch.
        """
        self.render_mode, self._renderer = render_mode, Renderer(render_mode)
        super().__init__(ExcitationDesignVector(1, **arguments))

    def render(self) -> NDArray[np.uint8] | None:
        """Picture (H, W, 3) of the arm, its torque and the reward of the episode so far; None in mode human."""
        observer, seen = self._batch.observer, self._last
        measurement = {"time": TICK * observer.tick, "position": seen["positions"][-1], "torque": seen["torques"][-1]}
        return self._renderer.draw(measurement, observer.constraint.peak, (f"reward {self._paid:.1f} so far",))

    def close(self) -> None:
        """Let go of the window."""
        self._renderer.close()
