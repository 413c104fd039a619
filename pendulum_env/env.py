"""Gymnasium environment of the pendulum: simulated by pymunk or MuJoCo, replayed, or measured on the rig."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pendulum_env import spaces
from pendulum_env.backends import BACKENDS, Sample, Sensor, Setup, Start, Status
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulator import Simulator
from pendulum_env.lookup import find, refuse_unknown_arguments
from pendulum_env.parameters import PlantParameters, PlantProperties, Values
from pendulum_env.physics import Model
from pendulum_env.plant import Effects, make_plant
from pendulum_env.rendering import FRAMES, MODES, Renderer

OWN_PLANT = {"replay": "a replay plays the plant it was recorded with", "dm1015b": "the rig is the plant"}

Observation = NDArray[np.float32]
Action = NDArray[np.float32]


class DirectDrivePendulum(PlantProperties, gym.Env[Observation, Action]):
    """Direct-drive pendulum with a torque input and an encoder, without a task.

    The reward is always 0. An episode ends at the end of a replayed recording (truncated) or at a fault of the
    rig (terminated). To train an agent, make `pendulum_env/ExcitationDesign-v0`: its reward is the information of
    the motion. Or wrap this environment in `EstimateParameters` and `InformationReward`, or in a custom reward, and
    give `gymnasium.make` a `max_episode_steps`.

    q = 0 hangs down, positive counter-clockwise. Action: torque [N m], held for one period and limited to
    +-max_torque, shape (1,). Observation: cos q, sin q, q' [rad/s] of the measured angle, shape (3,); q' is clipped to
    +-100 rad/s.

    `info` holds the measurement: `time` [s] since the reset, `position` [rad] of the encoder, unwrapped, `velocity`
    [rad/s], `torque` [N m] applied over the period that ends at `time` (0 after a reset), `clipped`: True if the action
    exceeded max_torque and was limited, and `follows`: False if the plant ignores the action, as in a replay. A
    simulated plant adds `plant`, its true parameters by name from `time` on, including those of its effects. A rig adds
    `jitter` [s], the delay of the sample after its tick, `overruns`, the number of ticks missed since the reset, and
    after a fault `fault`, its description and remedy.
    """

    metadata = {"render_modes": list(MODES), "render_fps": FRAMES}  # noqa: RUF012  (Gymnasium's own interface)

    @refuse_unknown_arguments
    def __init__(
        self,
        backend: str = "pymunk",
        *,
        effects: Effects = (),
        theta: Mapping[str, float] | None = None,
        model: Model | str | Path | None = None,
        rate: float | None = None,
        substeps: int = 1,
        max_torque: float = spaces.MAX_TORQUE,
        counts: int = COUNTS,
        torque_noise: float = 0.0,
        velocity: str = "difference",
        recording: str | Path | None = None,
        config: str | Path | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Make the pendulum.

        Args:
            backend: "pymunk", "mujoco" (extra `export`), "replay" or "dm1015b", the rig.
            effects: hidden effects of the simulated plant, such as `stribeck=0.4` or `{"stribeck": 0.4}`;
                `pendulum-ident effects` lists them.
            theta: parameters of the plant that differ from the paper's, by name.
            model: identified model, or its file, to simulate as the plant.
            rate: samples and actions per second [Hz], 1000 by default; a replay has the rate of its recording.
            substeps: integration steps per sample. The error is of second order in the step: 4e-6 rad RMS over 30 s of
                the paper's excitation with steps of 1 ms.
            max_torque: bound of the action [N m].
            counts: encoder counts per turn; 0 measures the angle exactly.
            torque_noise: standard deviation of the white noise on the measured torque [N m].
            velocity: "difference", the paper's backward difference of the encoder, or "ideal".
            recording: file to replay; it determines plant, rate and sensor.
            config: file of the rig, rig.toml; it determines rate, sensor and limits.
            render_mode: "rgb_array" or "human".

        Raises:
            ValueError: if an argument is unknown or out of its range; the message names it and the remedy.
            RecordingError: if the recording cannot be read.
            ModelError: if the model cannot be read.
            DriveError: if the rig cannot be reached or is in use.
            ModuleNotFoundError: if a backend needs an extra that is not installed.
        """
        has_plant = bool(effects) or any(value is not None for value in (theta, model, rate))
        _check_arguments(backend, recording, config, has_plant)
        rate = 1000.0 if rate is None else rate
        spaces.check_positive("a pendulum", rate=rate, substeps=substeps, max_torque=max_torque)
        self._renderer = Renderer(render_mode)
        sensor = Sensor(counts, torque_noise, find("velocity", velocity, spaces.VELOCITIES))
        files = [None if file is None else str(file) for file in (recording, config)]
        self._make_backend = find("backend", backend, BACKENDS)
        self._open_plant(Setup(make_plant(theta, effects, model), float(rate), int(substeps), sensor, *files))
        self.render_mode = render_mode
        self.overlay: Callable[[], Sequence[str]] = tuple  # returns the text lines that a wrapper adds to the picture
        self.traits = self.backend.traits
        self.recording, self.rate, self.counts = self.traits.recording, self.traits.rate, self.traits.counts
        self.max_torque = min(float(max_torque), self.traits.max_torque)
        self.metadata = {**self.metadata, "render_fps": min(self.rate, FRAMES)}
        self.observation_space, self.action_space = spaces.make_spaces(self.max_torque)

    def _open_plant(self, setup: Setup) -> None:
        """Open the backend with a plant, which waits for a reset."""
        self._setup, self.plant, self._is_running = setup, PlantParameters(setup.model), False
        self._parameters = self.plant.info  # parameters of the backend
        self.backend = self._make_backend(setup)
        self.backend.open()

    @property
    def simulated(self) -> bool:
        """Return whether the plant is simulated, with initial state and parameters that can be set."""
        return self.traits.simulated

    def add_effects(self, effects: Effects) -> None:
        """Hide further effects in the simulated plant, in the form of the argument `effects`; a reset must follow.

        Raises:
            ValueError: if an effect is unknown, impossible or already in the plant, or the backend simulates no plant.
        """
        if not self.simulated:
            raise ValueError(f"the {type(self.backend).__name__} backend simulates no plant to hide an effect in")
        model = make_plant(effects=effects, model=self._setup.model)
        self.backend.close()
        self._open_plant(replace(self._setup, model=model))

    def set_parameters(self, parameters: Values) -> None:
        """Change parameters of the simulated plant by name, until the next reset.

        Raises:
            ValueError: if a parameter is unknown or impossible, or the backend simulates no plant.
        """
        if not self.simulated:
            raise ValueError(f"the {type(self.backend).__name__} backend simulates no plant with parameters to set")
        self.plant.change(parameters)
        self._update_plant()

    def _update_plant(self) -> None:
        """Pass changed parameters to the backend."""
        previous, self._parameters = self._parameters, self.plant.info
        if isinstance(self.backend, Simulator) and self._parameters != previous:
            self.backend.set_parameters(self.plant.terms, self.plant.theta)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode, by default at rest and hanging down.

        Args:
            seed: seed of the measurement noise.
            options: of a simulated plant: `position` [rad], `velocity` [rad/s], and `theta`, parameters of the plant
                and its effects by name, for this and later episodes. Of a rig: `clear_fault`, True to enable the motor
                again after the cause of a fault is removed.

        Raises:
            ValueError: if the option is unknown, or the backend does not support it.
            DriveError: if the rig keeps a fault, cannot be reached, or does not come to rest.
        """
        super().reset(seed=seed)
        options = dict(options or {})
        for name in options:
            find("option of reset", name, spaces.RESET_OPTIONS)
        clear_fault = bool(options.pop("clear_fault", False))
        if options and not self.simulated:
            raise ValueError(f"the {type(self.backend).__name__} backend starts as it is: reset it without options")
        if self._is_running:
            self.backend.disable()
        position, velocity = map(float, spaces.read_start(options, ()))
        self.plant.reset(options.get("theta"))
        self._update_plant()
        start = Start(position, velocity, self.np_random, clear_fault)
        sample = self.backend.enable(start)
        self._is_running = True
        # the backward difference starts with the angle one period earlier
        self._previous_position, self._previous_time = sample.position, sample.time
        if self.simulated:
            self._previous_position = float(self._setup.sensor.position(position - velocity / self.rate))
        return self._make_observation(sample)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold a torque for one period.

        Raises:
            ValueError: if the action is not a finite number.
        """
        if not self._is_running:
            raise gym.error.ResetNeeded("the pendulum has not been started: call reset before step")
        try:
            (torque,) = map(float, action)
        except (TypeError, ValueError):
            torque = math.nan
        if not math.isfinite(torque):
            self.backend.disable()  # no torque between runs
            raise ValueError(f"the action is {action}, of shape {np.shape(action)}: it needs (1,), a torque in N m")
        sample = self.backend.exchange(min(max(torque, -self.max_torque), self.max_torque))
        # a torque within the limit is also within it in single precision, which is slower to compare
        clipped = abs(torque) > self.max_torque and bool(spaces.is_beyond(torque, self.max_torque))
        observation, info = self._make_observation(sample, clipped=clipped)
        return observation, 0.0, sample.status is Status.FAULT, sample.status is Status.ENDED, info

    def _make_observation(self, sample: Sample, clipped: bool = False) -> tuple[Observation, dict[str, Any]]:
        """Return observation and info of a sample, and show it in a window in mode human."""
        position, velocity = sample.position, sample.velocity
        if velocity is None:
            periods = max(1, round((sample.time - self._previous_time) * self.rate))  # a recording may have gaps
            velocity = (position - self._previous_position) * self.rate / periods
        self._previous_position, self._previous_time = position, sample.time
        bounded = min(max(velocity, -spaces.MAX_VELOCITY), spaces.MAX_VELOCITY)
        observation = np.array([math.cos(position), math.sin(position), bounded], dtype=np.float32)
        info: dict[str, Any] = {
            "time": sample.time,
            "position": position,
            "velocity": velocity,
            "torque": sample.torque,
            "clipped": clipped,
            "follows": self.traits.follows,
        }
        if self.simulated:
            info["plant"] = dict(self._parameters)
        if sample.timing is not None:
            info |= sample.timing._asdict()
        if sample.fault is not None:
            info["fault"] = sample.fault
        self._last_info = info
        if self.render_mode == "human":
            self.render()
        return observation, info

    def render(self) -> NDArray[np.uint8] | None:
        """Draw pendulum, torque and estimates; return the picture (H, W, 3), or None in mode human."""
        return self._renderer.draw(self._last_info, self.max_torque, self.overlay())

    def close(self) -> None:
        """Close the backend and the window."""
        if self._is_running:
            self.backend.disable()
            self._is_running = False
        self.backend.close()
        self._renderer.close()


def _check_arguments(backend: str, recording: str | Path | None, config: str | Path | None, has_plant: bool) -> None:
    """Refuse arguments of another backend."""
    if backend != "replay" and recording is not None:
        raise ValueError(f"a recording is played by backend='replay', not by '{backend}'")
    if backend != "dm1015b" and config is not None:
        raise ValueError(f"a configuration is for backend='dm1015b', not for '{backend}'")
    if backend in OWN_PLANT and has_plant:
        raise ValueError(f"{OWN_PLANT[backend]}: leave out effects, theta, model and rate")
