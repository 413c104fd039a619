"""Regressor models of an arm that run along with an environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym

from estimators.arguments import chosen_schemes
from estimators.arms.online import ArmEstimator
from estimators.schemes.balance import for_arms
from estimators.wrappers.arms import body_of, terms_of
from estimators.wrappers.measuring import Measuring
from estimators.wrappers.options import rate_of
from pendulum_env._typing import Array, Mask
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.physics import Term


class ArmEstimators:
    """Several schemes beside each other, as the wrappers feed them."""

    def __init__(self, rate: float, each: dict[str, ArmEstimator]) -> None:
        """Take the samples per second [Hz], and estimators by scheme."""
        self.rate, self.each = rate, each
        self._last: tuple[float, Array] | None = None  # time and positions of the sample before

    def reset(self, which: Mask | None = None) -> None:
        """Forget what was estimated."""
        self._last = None
        for estimator in self.each.values():
            estimator.reset()

    def take(self, time: Array, position: Array, torque: Array) -> None:
        """Take in a sample: time (1,), positions and torques (1, n), those over the period that ends with it."""
        if self._last is not None:
            for estimator in self.each.values():
                estimator.update(*self._last, torque[0])
        self._last = float(time[0]), position[0]


class EstimateArmParameters(Measuring):
    """Estimate an arm's base parameters and friction online, by recursive least squares, from what `info` measures.

    Adds to `info`:

    - `estimates`: by scheme, each with `theta` (P,), `P` (P, P), its covariance for unit noise, and `prediction_error`,
      that of the last equation, a priori. They lag behind as those of `ArmEstimator` do.
    - `parameters`: their names in order, base parameters first.

    Examples:
        >>> import gymnasium as gym
        >>> from estimators.wrappers import EstimateArmParameters
        >>> env = EstimateArmParameters(gym.make("pendulum_env/PlanarArm-v0"))
        >>> _, info = env.reset(seed=0)
        >>> info["parameters"][-2:]
        ('viscous@elbow', 'coulomb@elbow')
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        schemes: str | Sequence[str] = "filtered_dynamic",
        terms: Sequence[str | Term] | None = None,
        *,
        robot: str | None = None,
        rate: float | None = None,
    ) -> None:
        """Wrap an environment whose `info` carries `time`, and `position` and `torque` (n,).

        Args:
            env: the environment.
            schemes: ids of schemes; "all" are the six.
            terms: at joints, by id (`viscous@elbow`) or as they are; viscous and Coulomb friction by default.
            robot: file of its links, URDF or MJCF, of which lengths and axes are used; None asks the environment.
            rate: samples per second [Hz]; None asks the environment, as for its encoders, whose steps are smoothed.

        Raises:
            ValueError: if a scheme is unknown, or the environment lacks what was not given; when running, if samples
                do not come at the rate.
            BodyError: if the file cannot be read, or without the extra `arms`.
        """
        rate, body = rate_of(env, rate), body_of(env, robot)
        counts = getattr(env.unwrapped, "counts", COUNTS)
        _, *at_joints = terms_of(body, terms)
        self.estimators = {
            scheme.id: ArmEstimator(body, rate, at_joints, scheme, counts=counts)
            for scheme in for_arms(chosen_schemes(schemes))
        }
        self.parameters = tuple(column.name for column in next(iter(self.estimators.values())).model.columns)
        learner = ArmEstimators(rate, self.estimators)
        super().__init__(env, learner, schemes=schemes, terms=terms, robot=robot, rate=rate)

    def _tell(self, observation: Any, info: dict[str, Any]) -> Any:
        info["parameters"] = self.parameters
        info["estimates"] = {
            id: {"theta": state.theta, "P": state.P, "prediction_error": state.error}
            for id, state in ((id, estimator.state) for id, estimator in self.estimators.items())
        }
        if self.env.render_mode is not None:
            self.env.unwrapped.overlay = self._lines  # type: ignore[attr-defined]
        return observation

    def _lines(self) -> tuple[str, ...]:
        """What the picture says: estimates of the first scheme, three in a row."""
        id, estimator = next(iter(self.estimators.items()))
        told = [f"{name:<16}{v:7.3f}" for name, v in zip(self.parameters, estimator.state.theta.tolist(), strict=True)]
        return (id, *(" ".join(told[k : k + 3]) for k in range(0, len(told), 3)))
