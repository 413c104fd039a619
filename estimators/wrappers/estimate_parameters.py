"""Six regressor models that run along with an environment, or with many."""

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
from estimators.wrappers.measuring import Measuring, MeasuringVector, repeated
from estimators.wrappers.options import EstimatorOptions, Names, make
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Term

BOUND = 1e6  # of what is put into an observation
WIDE = 6  # parameters, more than which a picture has no table of


class EstimateParameters(Measuring):
    """Estimate the parameters online, by recursive least squares, from the measurement in `info`.

    Adds to `info`:

    - `estimates`: by scheme, each with `theta` (P,), `covariance` (P, P), honest under correlated errors,
      `prediction_error`, a priori and 0 where the sample was not used, as in stick, and `P` (P, P), the covariance for
      unit noise. A notebook shows them as a table.
    - `estimates_time`: time of the newest sample used [s]: smoothing and stick need to see both sides of a sample.
    - `regressor`: (P,), the torque balance's row at that sample, 0 in stick.
    - `parameters`: their names in order.

    Of an arm, base parameters come first, estimates are renewed every 50 ms, and there is no regressor. It needs the
    extra `arms`.

    Examples:
        >>> import gymnasium as gym
        >>> from estimators.wrappers import EstimateParameters
        >>> env = EstimateParameters(gym.make("pendulum_env/DirectDrivePendulum-v0"), schemes=["dynamic"])
        >>> _, info = env.reset(seed=0)
        >>> info["estimates"]["dynamic"]["theta"]
        array([0., 0., 0., 0.])
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
        """Wrap an environment whose `info` carries `time`, `position` and `torque`.

        Args:
            env: the environment.
            schemes: ids of schemes, or schemes; "all" are the six. `joint_state_ukf`, a seventh, is told after the
                others: position, velocity and parameters in one state, without a delay, see `JointState`.
            terms: all terms of the model, by id or, with nonlinear parameters of their own, as they are, such as
                `(*BASE, Stribeck(stribeck_velocity=0.4))`; None are the paper's four. A term without linear parameters,
                such as `dead_time`, is taken to be known. Of an arm, terms at joints, `viscous@elbow`; None are viscous
                and Coulomb friction at each.
            rate: samples per second [Hz]; None asks the environment. The encoder's resolution is asked for, too; if the
                environment does not tell it, the first samples of motion teach it, unless `counts` is given.
            in_observation: whether theta and the standard errors of all schemes are appended to a Box observation.
            robot: file of an arm's links, URDF or MJCF, of which lengths and axes are used; None asks the environment.
            options: of `estimators.online.OnlineEstimator`: `forgetting` (factor for every equation, 1 forgets none),
                `random_walk` (by which parameters may wander, as a share of their value [1/sqrt(s)]), `prior` (P(0)
                on the diagonal), `counts` (of the encoder per turn), `smoothing`, and `recursion` ("KalmanFilter" for
                filterpy's in the place of ours).

        Raises:
            ValueError: if a name is unknown or an option is out of its range; when running, if samples do not come at
                the rate.
        """
        arguments: dict[str, Any] = {"schemes": schemes, "terms": terms, "rate": rate, **options}
        self.estimator, self._in_observation = make(env, schemes, terms, rate, options, robot), in_observation
        super().__init__(env, self.estimator, in_observation=in_observation, robot=robot, **arguments)
        if in_observation:
            self.observation_space = widened(env.observation_space, self.estimator)

    @property
    def schemes(self) -> tuple[Scheme | JointState, ...]:
        """The schemes that run."""
        return tuple(self.estimator.schemes)

    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        tell(info, self._known, self.estimator, 0)
        if self.env.render_mode is not None:
            self.env.unwrapped.overlay = functools.partial(self._lines, self._known)  # type: ignore[attr-defined]
        if not self._in_observation:
            return observation
        return np.concatenate([observation, told(self._known)[0]], dtype=np.float32)

    def _lines(self, now: Estimates) -> tuple[str, ...]:
        """What the picture says: of many parameters, estimates of the first scheme, three in a row."""
        if len(self.estimator.names) > WIDE:
            told = [f"{name:<16}{v:7.3f}" for name, v in zip(self.estimator.names, now.theta[0, 0], strict=True)]
            return (self.schemes[0].id, *(" ".join(told[k : k + 3]) for k in range(0, len(told), 3)))
        names = "  ".join(f"{name[:9]:>9}" for name in self.estimator.names)
        each = enumerate(self.schemes)
        rows = (f"{one.id:<21}" + "  ".join(f"{v:9.4f}" for v in now.theta[0, s]) for s, one in each)
        return (f"{'':21}{names}", *rows)


class EstimateParametersVector(MeasuringVector):
    """`EstimateParameters` for a vector environment; the entries of `info` have a first axis over its environments.

    The layout of `info` is that of `gymnasium.make_vec(..., vectorization_mode="sync", wrappers=[EstimateParameters])`:
    each entry has a mask, as `_regressor`, and `parameters` holds the names once for each environment. A pendulum whose
    time starts anew has been reset: its estimates start anew with it.
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
        self.estimator = make(env, schemes, terms, rate, options)
        super().__init__(env, self.estimator)
        self._in_observation = in_observation
        if in_observation:
            self.single_observation_space = widened(env.single_observation_space, self.estimator)
            self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def _restart(self, ended: Mask, time: Array) -> None:
        super()._restart(ended, time)
        self._known = self.estimator.after_reset(self._known, ended, time)

    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        tell(info, self._known, self.estimator, slice(None))
        if not self._in_observation:
            return observation
        return np.concatenate([observation, told(self._known)], axis=1, dtype=np.float32)


def tell(info: dict[str, Any], now: Estimates, estimator: OnlineEstimator, pendulum: int | slice) -> None:
    """Put what is known of one pendulum, or of several, into an info, beside what a wrapper inside has found.

    Of several, the layout is that of Gymnasium's vector environments: arrays with a first axis over them, and masks.
    """
    found: dict[str, Any] = {
        scheme.id: SchemeEstimate(now, s, pendulum, estimator.units) for s, scheme in enumerate(estimator.schemes)
    }
    known: dict[str, Any] = {"estimates_time": now.time[pendulum], "parameters": estimator.names}
    if now.regressor is not None:
        known["regressor"] = now.regressor[pendulum]
    if isinstance(pendulum, slice):
        known["parameters"] = repeated(estimator.names, len(now.time))
        everyone = np.ones(len(now.time), dtype=bool)
        found |= {f"_{name}": everyone for name in found}
        known |= {f"_{name}": everyone for name in ("estimates", *known)}
    info |= {"estimates": SchemeEstimates(info.get("estimates", ()), **found), **known}


def told(now: Estimates) -> Array:
    """What an observation tells of the estimates: theta and standard errors of all schemes (B, 2 S P)."""
    std = np.sqrt(np.maximum(np.einsum("bsii->bsi", now.covariance), 0.0))
    both = np.concatenate([now.theta, std], axis=2).reshape(len(now.theta), -1)
    return np.clip(both, -BOUND, BOUND)


def widened(space: gym.Space[Any], estimator: OnlineEstimator) -> gym.spaces.Box:
    """Observation space with theta and standard errors appended.

    Raises:
        ValueError: if the space is not a one-dimensional Box.
    """
    if not isinstance(space, gym.spaces.Box) or len(space.shape) != 1:
        raise ValueError(f"estimates can be put into a Box of one dimension, not into {space}: flatten it first")
    more = np.full(2 * len(estimator.schemes) * len(estimator.names), BOUND, dtype=np.float32)
    return gym.spaces.Box(np.concatenate([space.low, -more]), np.concatenate([space.high, more]), dtype=np.float32)
