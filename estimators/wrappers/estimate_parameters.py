"""Wrappers for online estimation by the six regressor models."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, Unpack

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from estimators.online import Estimates, JointState, OnlineEstimator, SchemeEstimate, SchemeEstimates
from estimators.schemes.six import Scheme
from estimators.wrappers.measuring import MeasurementVectorWrapper, MeasurementWrapper
from estimators.wrappers.options import EstimatorOptions, Names, make_estimator
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Term

OBSERVATION_BOUND = 1e6  # largest absolute value of an estimate in an observation
MAX_TABLE_PARAMETERS = 6  # in the table of a picture


class EstimateParameters(MeasurementWrapper):
    """Estimate the parameters online, by recursive least squares, from the measurement in `info`.

    The wrapper adds to `info`:

    - `estimates`, by scheme: `theta` and standard errors `std`, by name of the parameter as in `info["plant"]`;
      `covariance` (P, P) under correlated errors; `prediction_error`, a priori, and 0 for unused samples, as in stick;
      and `P` (P, P), the covariance for unit noise. A notebook shows a table.
    - `estimates_time`: time of the newest used sample [s], which is delayed by smoothing and guards around stick.
    - `regressor`: row of the torque balance at this sample (P,), 0 in stick.
    - `parameters`: names in the order of the arrays.

    With links, base parameters come first, estimates change every 50 ms, and `regressor` is absent. Links need the
    extra `arms`.

    Examples:
        >>> import gymnasium as gym
        >>> from estimators.wrappers import EstimateParameters
        >>> env = EstimateParameters(gym.make("pendulum_env/DirectDrivePendulum-v0"), schemes=["dynamic"])
        >>> _, info = env.reset(seed=0)
        >>> info["estimates"]["dynamic"]["theta"]
        {'inertia': 0.0, 'gravity': 0.0, 'viscous': 0.0, 'coulomb': 0.0}
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        schemes: Names = "all",
        terms: Sequence[str | Term] | None = None,
        *,
        rate: float | None = None,
        in_observation: bool = False,
        robot: str | None = None,
        **options: Unpack[EstimatorOptions],
    ) -> None:
        """Wrap an environment with `time`, `position` and `torque` in `info`.

        Args:
            env: the environment.
            schemes: ids of schemes, or schemes; "all" for the six. `joint_state_ukf`, with position, velocity and
                parameters in one state, is the last in the estimates and has no delay, see `JointState`.
            terms: all terms of the model, ids or `Term` objects, such as `(*BASE, Stribeck(stribeck_velocity=0.4))`;
                None for the four of the paper. A term without linear parameters, such as `dead_time`, is known. With
                links, terms at joints, such as `viscous@elbow`; None for viscous and Coulomb friction at each joint.
            rate: sampling rate [Hz]; None reads it from the environment. The resolution of the encoder is `counts`, or
                that of the environment, or estimated from the first samples of motion.
            in_observation: append theta and the standard errors of all schemes to a Box observation.
            robot: URDF or MJCF file of the links, for lengths and axes; None reads it from the environment.
            options: of `estimators.online.OnlineEstimator`: `forgetting` (factor per equation, 1 for no forgetting),
                `prior` (P(0) on the diagonal), `counts` (encoder counts per turn), `smoothing`, and `recursion`
                ("KalmanFilter" for filterpy).

        Raises:
            ValueError: if a name is unknown or an option is out of its range; while running, if samples are off the
                rate.
        """
        arguments: dict[str, Any] = {"schemes": schemes, "terms": terms, "rate": rate, "robot": robot, **options}
        self.estimator, self._in_observation = make_estimator(env, **arguments), in_observation
        super().__init__(env, self.estimator, in_observation=in_observation, **arguments)
        if in_observation:
            self.observation_space = extend_space(env.observation_space, self.estimator)

    @property
    def schemes(self) -> tuple[Scheme | JointState, ...]:
        """Return the running schemes."""
        return tuple(self.estimator.schemes)

    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        write_estimates(info, self._known, self.estimator, 0)
        if self.env.render_mode is not None:
            self.env.unwrapped.overlay = functools.partial(self._format_lines, self._known)
        if not self._in_observation:
            return observation
        return np.concatenate([observation, observe_estimates(self._known)[0]], dtype=np.float32)

    def _format_lines(self, estimates: Estimates) -> tuple[str, ...]:
        """Format the text of a picture; with many parameters, estimates of the first scheme, three per line."""
        if len(self.estimator.names) > MAX_TABLE_PARAMETERS:
            cells = [f"{name:<16}{v:7.3f}" for name, v in zip(self.estimator.names, estimates.theta[0, 0], strict=True)]
            return (self.schemes[0].id, *(" ".join(cells[k : k + 3]) for k in range(0, len(cells), 3)))
        names = "  ".join(f"{name[:9]:>9}" for name in self.estimator.names)
        schemes = enumerate(self.schemes)
        rows = (f"{scheme.id:<21}" + "  ".join(f"{v:9.4f}" for v in estimates.theta[0, s]) for s, scheme in schemes)
        return (f"{'':21}{names}", *rows)


class EstimateParametersVector(MeasurementVectorWrapper):
    """`EstimateParameters` for a vector environment; the entries of `info` have a first axis over its environments.

    The layout of `info` is that of `gymnasium.make_vec(..., vectorization_mode="sync", wrappers=[EstimateParameters])`:
    each entry has a mask, such as `_regressor`, and `parameters` holds the names once for each environment. The
    estimates of an environment restart when its time restarts.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        schemes: Names = "all",
        terms: Sequence[str | Term] | None = None,
        *,
        rate: float | None = None,
        in_observation: bool = False,
        **options: Unpack[EstimatorOptions],
    ) -> None:
        """Wrap a vector environment; the arguments are those of `EstimateParameters`."""
        self.estimator = make_estimator(env, schemes, terms, rate, **options)
        super().__init__(env, self.estimator)
        self._in_observation = in_observation
        if in_observation:
            self.single_observation_space = extend_space(env.single_observation_space, self.estimator)
            self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def _restart(self, which: Mask, time: Array) -> None:
        """Restart plants (B,); their estimates lose the sample, see `OnlineEstimator.restart_estimates`."""
        super()._restart(which, time)
        self._known = self.estimator.restart_estimates(self._known, which, time)

    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        write_estimates(info, self._known, self.estimator, slice(None))
        if not self._in_observation:
            return observation
        columns = observe_estimates(self._known)
        if observation.dtype != object:
            return np.concatenate([observation, columns], axis=1, dtype=np.float32)
        extended = observation.copy()  # last observations of ended episodes, as of `SyncVectorEnv`
        for k in np.flatnonzero([row is not None for row in observation]):
            extended[k] = np.concatenate([observation[k], columns[k]], dtype=np.float32)
        return extended


def write_estimates(
    info: dict[str, Any], estimates: Estimates, estimator: OnlineEstimator, pendulum: int | slice
) -> None:
    """Write the estimates of one or several pendulums into `info`; estimates of an inner wrapper are kept.

    Several pendulums have the layout of vector environments of Gymnasium: arrays with a first axis, and masks.
    """
    by_scheme: dict[str, Any] = {
        scheme.id: SchemeEstimate(estimates, s, pendulum, estimator.units) for s, scheme in enumerate(estimator.schemes)
    }
    entries: dict[str, Any] = {"estimates_time": estimates.time[pendulum], "parameters": estimator.names}
    if estimates.regressor is not None:
        entries["regressor"] = estimates.regressor[pendulum]
    if isinstance(pendulum, slice):
        entries["parameters"] = np.full(len(estimates.time), None)  # objects
        entries["parameters"].fill(estimator.names)
        mask = np.ones(len(estimates.time), dtype=bool)
        by_scheme |= {f"_{name}": mask for name in by_scheme}
        entries |= {f"_{name}": mask for name in ("estimates", *entries)}
    info |= {"estimates": SchemeEstimates(info.get("estimates", ()), **by_scheme), **entries}


def observe_estimates(estimates: Estimates) -> Array:
    """Return theta and standard errors of each scheme for an observation (B, 2 S P), clipped to `OBSERVATION_BOUND`."""
    columns = np.concatenate([estimates.theta, estimates.std], axis=2).reshape(len(estimates.theta), -1)
    return np.clip(columns, -OBSERVATION_BOUND, OBSERVATION_BOUND)


def extend_space(space: gym.Space[Any], estimator: OnlineEstimator) -> gym.spaces.Box:
    """Extend an observation space by theta and standard errors."""
    if not isinstance(space, gym.spaces.Box) or len(space.shape) != 1:
        raise ValueError(f"in_observation needs a Box of one dimension, not {space}: flatten the observation first")
    bound = np.full(2 * len(estimator.schemes) * len(estimator.names), OBSERVATION_BOUND, dtype=np.float32)
    return gym.spaces.Box(np.concatenate([space.low, -bound]), np.concatenate([space.high, bound]), dtype=np.float32)
