"""The pendulum as a Gymnasium environment: simulated by pymunk or MuJoCo, replayed, or the rig itself."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pendulum_env.backends import BACKENDS, Sample, Sensor, Setup, Start, Status
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulator import Simulator
from pendulum_env.lookup import find, refuse_unknown_arguments
from pendulum_env.parameters import PlantParameters, PlantProperties, Values
from pendulum_env.physics import Model
from pendulum_env.plant import Effects, make_plant
from pendulum_env.rendering import MODES, Renderer
from pendulum_env.spaces import (
    MAX_TORQUE,
    MAX_VELOCITY,
    RESET_OPTIONS,
    VELOCITIES,
    check_positive,
    is_beyond,
    make_spaces,
    read_start,
)

OWN_PLANT = {"replay": "a replay plays the plant it was recorded with", "dm1015b": "the rig is the plant"}

Observation = NDArray[np.float32]
Action = NDArray[np.float32]


class DirectDrivePendulum(PlantProperties, gym.Env[Observation, Action]):
    """Direct-drive pendulum with a torque input, seen through its encoder: a plant, no task.

    Its reward is always 0, and an episode ends only with a recording that is replayed (truncated) or a fault of a rig's
    drive (terminated). To train an agent, make `pendulum_env/ExcitationDesign-v0`, whose reward is what a motion
    teaches; or wrap this one in `EstimateParameters` and `InformationReward` or in a reward of your own, and give
    `gymnasium.make` a `max_episode_steps`.

    q = 0 hangs down, positive counter-clockwise. Action: torque [N m], held for one period and limited to
    +-max_torque, shape (1,). Observation: cos q, sin q, q' [rad/s], shape (3,), of the measured angle, the
    last cut at +-100 rad/s.

    `info` carries the measurement that estimators and recordings use: `time` [s] since the reset, `position` [rad]
    unwrapped as the encoder reads it, `velocity` [rad/s], `torque` [N m] as it was applied over the period that ends at
    `time` (0 after a reset), `clipped`: True where the action asked for more than max_torque and got that, and
    `follows`: False where the action is ignored, as in a replay. A simulated plant adds `plant`, its true parameters
    from `time` on, by name, those of its effects included. A rig adds `jitter` [s], how late after its tick a
    sample was taken, `overruns`, how many ticks were missed so far, and on a fault `fault`, what happened and what to
    do.
    """

    metadata = {"render_modes": list(MODES), "render_fps": 50}  # noqa: RUF012  (Gymnasium's own interface)

    @refuse_unknown_arguments
    def __init__(
        self,
        backend: str = "pymunk",
        *,
        effects: Effects = (),
        theta: Mapping[str, float] | None = None,
        model: Model | str | Path | None = None,
        rate: float = 1000.0,
        substeps: int = 1,
        max_torque: float = MAX_TORQUE,
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
            effects: hidden in the simulated plant, as `stribeck=0.4` or `{"stribeck": 0.4}`; `pendulum-ident effects`
                lists them.
            theta: parameters of the plant that differ from the paper's, by name.
            model: an identified model or its file, as the plant.
            rate: samples, and actions, per second [Hz]; a replay has its own.
            substeps: integration steps per sample; the error is of second order in their length, 4e-6 rad RMS over 30 s
                of the paper's excitation for steps of 1 ms.
            max_torque: bound of the action [N m].
            counts: of the encoder per turn; 0 measures the angle exactly.
            torque_noise: standard deviation of the white noise on the measured torque [N m].
            velocity: "difference", the paper's backward difference of the encoder, or "ideal".
            recording: file that "replay" plays; plant, rate and sensor are then those it was recorded with.
            config: rig.toml, that describes the rig; its rate, sensor and limits count then.
            render_mode: "rgb_array" or "human".

        Raises:
            ValueError: if an argument is unknown or out of its range; the message says which and what to do.
            RecordingError: if the recording cannot be read.
            ModelError: if the model cannot be read.
            DriveError: if the rig cannot be reached or is in use.
            ModuleNotFoundError: if a backend needs an extra that is not installed.
        """
        check_positive("a pendulum", rate=rate, substeps=substeps, max_torque=max_torque)
        self._renderer = Renderer(render_mode)
        has_plant = bool(effects) or theta is not None or model is not None
        _check_belongs(backend, recording, config, has_plant)
        sensor = Sensor(counts, torque_noise, find("velocity", velocity, VELOCITIES))
        files = [None if file is None else str(file) for file in (recording, config)]
        self._setup = Setup(make_plant(theta, effects, model), float(rate), int(substeps), sensor, *files)
        self.plant = PlantParameters(self._setup.model)
        self._parameters = self.plant.info  # which the backend has
        self.backend = find("backend", backend, BACKENDS)(self._setup)
        self.backend.open()
        self.render_mode = render_mode
        self.overlay: Callable[[], Sequence[str]] = tuple  # lines that a wrapper wants to have shown
        # what a wrapper may want to know of the measurement
        self.traits = self.backend.traits
        self.recording, self.rate, self.counts = self.traits.recording, self.traits.rate, self.traits.counts
        self.max_torque = min(float(max_torque), self.traits.max_torque)
        self.metadata = {**self.metadata, "render_fps": self.rate}
        self.observation_space, self.action_space = make_spaces(self.max_torque)
        self._running = False

    @property
    def simulated(self) -> bool:
        """Return whether the plant is simulated, so that initial state and parameters can be set."""
        return self.traits.simulated

    def set_parameters(self, parameters: Values) -> None:
        """Change parameters of the simulated plant, by name, from now on until the next reset.

        Raises:
            ValueError: if a parameter is unknown or impossible, or the backend simulates no plant.
        """
        if not self.simulated:
            raise ValueError(f"the {type(self.backend).__name__} backend simulates no plant with parameters to set")
        self.plant.change(parameters)
        self._update_plant()

    def _update_plant(self) -> None:
        """Let the backend go on with the parameters of now."""
        before, self._parameters = self._parameters, self.plant.info
        if isinstance(self.backend, Simulator) and self._parameters != before:
            self.backend.take(self.plant.terms, self.plant.theta)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode, at rest and hanging down unless told otherwise.

        Args:
            seed: of the noise of the measurement.
            options: for a simulated plant: `position` [rad], `velocity` [rad/s], `theta`, parameters of the plant by
                name for this and later episodes, those of effects included. For a rig: `clear_fault`, True once the
                cause of a fault is mended, without which no reset gives it power again.

        Raises:
            ValueError: if an option is unknown, or the backend cannot obey it.
            DriveError: if a rig keeps a fault, cannot be reached, or does not come to rest.
        """
        super().reset(seed=seed)
        options = dict(options or {})
        for name in options:
            find("option of reset", name, RESET_OPTIONS)
        clear = bool(options.pop("clear_fault", False))
        if options and not self.simulated:
            raise ValueError(f"the {type(self.backend).__name__} backend starts as it is: reset it without options")
        if self._running:
            self.backend.disable()
        position, velocity = map(float, read_start(options, ()))
        self.plant.reset(options.get("theta"))
        self._update_plant()
        start = Start(position, velocity, self.np_random, clear)
        first = self.backend.enable(start)
        self._running = True
        # the backward difference starts with the angle one period earlier
        self._before, self._then = first.position, first.time
        if self.simulated:
            self._before = float(self._setup.sensor.position(position - velocity / self.rate))
        observation, info = self._show(first)
        if self.render_mode == "human":
            self.render()
        return observation, info

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold a torque for one period.

        Raises:
            ValueError: if the action is no number.
        """
        if not self._running:
            raise gym.error.ResetNeeded("the pendulum has not been started: call reset before step")
        try:
            (torque,) = map(float, action)
        except (TypeError, ValueError):
            torque = math.nan
        if not math.isfinite(torque):
            self.backend.disable()  # no torque between runs
            raise ValueError(f"the action is {action}, of shape {np.shape(action)}: it needs (1,), a torque in N m")
        sample = self.backend.exchange(min(max(torque, -self.max_torque), self.max_torque))
        observation, info = self._show(sample, clipped=bool(is_beyond(torque, self.max_torque)))
        if self.render_mode == "human":
            self.render()
        return observation, 0.0, sample.status is Status.FAULT, sample.status is Status.ENDED, info

    def _show(self, sample: Sample, clipped: bool = False) -> tuple[Observation, dict[str, Any]]:
        """Return observation and info of a sample."""
        position, velocity = sample.position, sample.velocity
        if velocity is None:
            periods = max(1, round((sample.time - self._then) * self.rate))  # a recording may have gaps
            velocity = (position - self._before) * self.rate / periods
        self._before, self._then = position, sample.time
        bounded = min(max(velocity, -MAX_VELOCITY), MAX_VELOCITY)
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
        self._last = info
        return observation, info

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the arm, its torque and the estimates (H, W, 3); None in mode human."""
        return self._renderer.draw(self._last, self.max_torque, self.overlay())

    def close(self) -> None:
        """Let go of the backend and of the window."""
        if self._running:
            self.backend.disable()
            self._running = False
        self.backend.close()
        self._renderer.close()


def _check_belongs(backend: str, recording: str | Path | None, config: str | Path | None, has_plant: bool) -> None:
    """Refuse what goes with another backend."""
    if backend != "replay" and recording is not None:
        raise ValueError(f"a recording is played by backend='replay', not by '{backend}'")
    if backend != "dm1015b" and config is not None:
        raise ValueError(f"a configuration is for backend='dm1015b', not for '{backend}'")
    if backend in OWN_PLANT and has_plant:
        raise ValueError(f"{OWN_PLANT[backend]}: leave out effects, theta and model")
