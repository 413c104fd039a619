"""Gymnasium environments of simulated arms: planar arms by pymunk, other arms by MuJoCo."""

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array, Mask
from pendulum_env.backends.sensing import COUNTS, Sensor
from pendulum_env.formatting import join_words
from pendulum_env.lookup import find, refuse_unknown_arguments
from pendulum_env.plant import PAPER, Effects
from pendulum_env.rendering import FRAMES, MODES, Renderer
from pendulum_env.spaces import MAX_TORQUE, MAX_VELOCITY, VELOCITIES, check_positive, is_beyond, make_spaces
from robots.arms.body import Body
from robots.arms.planar import TWO_LINK, Link, PlanarBodies, make_joint_models, name_joints, write_urdf
from robots.arms.plane import get_friction
from robots.arms.world import SpatialBodies

RESET_OPTIONS = dict.fromkeys(("position", "velocity"))

Observation = NDArray[np.float32]
Action = NDArray[np.floating[Any]]


class SimulatedArm(gym.Env[Observation, Action]):
    """Arm of n joints with torque inputs and encoders, without a task.

    Action: torques [N m], held for one period and limited to +-max_torque, shape (n,). Observation: cosines, sines and
    velocities [rad/s] of the joints, shape (3 n,).

    `info` holds the measurement, as that of the pendulum but with arrays (n,): `time` [s], `position` [rad] unwrapped,
    `velocity` [rad/s], `torque` [N m] applied over the period that ends at `time`, `clipped` and `follows`. The reward
    is always 0, and episodes do not end. To train an agent, wrap the arm in a custom reward and give `gymnasium.make` a
    `max_episode_steps`.

    Attributes:
        joints: names of the joints.
        rate: samples per second [Hz].
        counts: encoder counts per turn.
    """

    metadata = {"render_modes": list(MODES), "render_fps": FRAMES}  # noqa: RUF012  (Gymnasium's own interface)

    def __init__(
        self,
        joints: Sequence[str],
        bodies: PlanarBodies | SpatialBodies,
        sensor: Sensor,
        *,
        rate: float,
        max_torque: float,
    ) -> None:
        """Set joints, simulated bodies, sensor, sample rate [Hz] and bound of the actions [N m]."""
        self.joints, self.sensor, self._bodies = tuple(joints), sensor, bodies
        self.rate, self.counts, self.max_torque = float(rate), sensor.counts, float(max_torque)
        self.metadata = {**self.metadata, "render_fps": min(self.rate, FRAMES)}
        self.observation_space, self.action_space = make_spaces(self.max_torque, len(self.joints))
        self._is_running = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode at `position` [rad] and `velocity` [rad/s] of `options`, (n,) each; default 0."""
        super().reset(seed=seed)
        options_by_name = dict(options or {})
        for name in options_by_name:
            find("option of reset", name, RESET_OPTIONS)
        zeros = np.zeros(len(self.joints))
        position, velocity = (self._check_numbers(name, options_by_name.get(name, zeros)) for name in RESET_OPTIONS)
        self._bodies.start(position, velocity)
        self._count, self._is_running = 0, True
        self._previous_position = self.sensor.position(position - velocity / self.rate)
        return self._make_observation(zeros, zeros > 0)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold torques for one period."""
        if not self._is_running:
            raise gym.error.ResetNeeded("the arm has not been started: call reset before step")
        command = self._check_numbers("action", action)
        torque = np.clip(command, -self.max_torque, self.max_torque)
        self._bodies.advance(torque)
        self._count += 1
        measured = self.sensor.torque(torque, self.np_random)
        observation, info = self._make_observation(measured, is_beyond(command, self.max_torque))
        return observation, 0.0, False, False, info

    def _check_numbers(self, name: str, values: Any) -> Array:
        try:
            array = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != (len(self.joints),) or not np.isfinite(array).all():
            raise ValueError(f"{name} of an arm with {len(self.joints)} joints needs as many numbers, got {values}")
        return array

    def _make_observation(self, torque: Any, clipped: Mask) -> tuple[Observation, dict[str, Any]]:
        bodies = self._bodies
        position, velocity = self.sensor.measure(bodies.position, bodies.velocity, self._previous_position, self.rate)
        self._previous_position = position
        bounded = np.clip(velocity, -MAX_VELOCITY, MAX_VELOCITY)
        observation = np.concatenate([np.cos(position), np.sin(position), bounded]).astype(np.float32)
        self._last_info = {
            "time": self._count / self.rate,
            "position": position,
            "velocity": velocity,
            "torque": torque,
            "clipped": clipped,
            "follows": True,
        }
        if self.render_mode == "human":
            self.render()
        return observation, self._last_info


class PlanarArm(SimulatedArm):
    """Arm of n links in a vertical plane, simulated by pymunk.

    Joint angles are relative to the previous link, and zero when the arm hangs down.
    """

    @refuse_unknown_arguments
    def __init__(
        self,
        links: Sequence[Link] = TWO_LINK,
        *,
        joints: Sequence[str] | None = None,
        effects: Effects = (),
        rate: float = 1000.0,
        substeps: int = 1,
        max_torque: float = MAX_TORQUE,
        counts: int = COUNTS,
        torque_noise: float = 0.0,
        velocity: str = "difference",
        render_mode: str | None = None,
    ) -> None:
        """Make the arm.

        Args:
            links: links from the base on, with the friction of their joints.
            joints: names of the joints; by default `shoulder`, `elbow`, `wrist`, `joint4`, ...
            effects: hidden effects at joints, such as `stribeck@elbow=0.4` or `{"stribeck@elbow": 0.4}`.
            rate: samples and actions per second [Hz].
            substeps: integration steps per sample.
            max_torque: bound of each joint's action [N m].
            counts: encoder counts per turn; 0 measures angles exactly.
            torque_noise: standard deviation of the white noise on the measured torques [N m].
            velocity: "difference", the backward difference of the encoder, or "ideal".
            render_mode: "rgb_array" or "human".
        """
        check_positive("an arm", rate=rate, substeps=substeps, max_torque=max_torque)
        self._renderer = Renderer(render_mode)
        self.links = tuple(links)
        joints = name_joints(len(links)) if joints is None else tuple(joints)
        if len(set(joints)) != len(self.links):
            raise ValueError(
                f"an arm of {len(self.links)} links needs as many joints of different names, not {join_words(joints)}"
            )
        sensor = Sensor(counts, torque_noise, find("velocity", velocity, VELOCITIES))
        self.models = make_joint_models([(link.viscous, link.coulomb) for link in self.links], joints, effects)
        bodies = PlanarBodies(self.links, self.models, 1.0 / rate, int(substeps))
        super().__init__(joints, bodies, sensor, rate=rate, max_torque=max_torque)
        self.render_mode = render_mode
        self.overlay: Callable[[], Sequence[str]] = tuple

    @property
    def urdf(self) -> str:
        """Return the arm as the text of a URDF file."""
        return write_urdf(self.links, self.joints)

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the arm and its torques; return the picture (H, W, 3), or None in mode human."""
        lengths = [link.length for link in self.links]
        angles = [link.angle for link in self.links]
        return self._renderer.draw(self._last_info, self.max_torque, self.overlay(), lengths, angles)

    def close(self) -> None:
        """Close the window."""
        self._is_running = False
        self._renderer.close()


class SpatialArm(SimulatedArm):
    """Arm from a robot file, with its links and friction, simulated by MuJoCo.

    A joint without friction in the file has that of the paper, reduced in proportion if its inertia is smaller.
    """

    def __init__(
        self,
        body: Body,
        *,
        effects: Effects = (),
        rate: float = 1000.0,
        max_torque: float = MAX_TORQUE,
        counts: int = COUNTS,
        torque_noise: float = 0.0,
    ) -> None:
        """Make the arm of a body, with ideal velocities. Other arguments are those of `PlanarArm`."""
        body.refuse_impossible_links()
        (mass,) = body.mass_matrix(np.zeros((1, len(body.joints))), body.values)
        shares = np.minimum(1.0, np.diag(mass) / PAPER["inertia"])
        models = make_joint_models(get_friction(body, shares), body.joints, effects, body.prismatic_joints)
        sensor = Sensor(counts, torque_noise, ideal_velocity=True)
        super().__init__(body.joints, SpatialBodies(body, models, 1.0 / rate), sensor, rate=rate, max_torque=max_torque)
