"""Regressor models of an arm that run along with an environment."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym

from estimators.arguments import chosen_schemes
from estimators.arms.identification import for_arms
from estimators.arms.online import ArmEstimator
from estimators.online.clock import Clock
from estimators.wrappers.measuring import measured
from estimators.wrappers.options import rate_of
from pendulum_env.arms.body import Body, read_body
from pendulum_env.arms.joints import Coupling, Links, at_joints, check_places, friction, joint_effects, kind_at, placed
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.lookup import find
from pendulum_env.physics import Term
from pendulum_env.physics.library import term


class EstimateArmParameters(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Estimate an arm's base parameters and friction online, by recursive least squares, from what `info` measures.

    Adds to `info`:

    - `estimates`: by scheme, each with `theta` (P,), `P` (P, P), its covariance for unit noise, and `prediction_error`,
      that of the last equation, a priori. They lag behind as those of `ArmEstimator` do.
    - `parameters`: their names in order, base parameters first.

    Examples:
        >>> import gymnasium as gym
        >>> from estimators.arms import EstimateArmParameters
        >>> env = EstimateArmParameters(gym.make("pendulum_env/PlanarArm-v0"))
        >>> _, info = env.reset(seed=0)
        >>> info["parameters"][-2:]
        ('viscous@elbow', 'coulomb@elbow')
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        schemes: str | Sequence[str] = "filtered_dynamic",
        terms: Sequence[Term] | None = None,
        *,
        robot: str | None = None,
        rate: float | None = None,
    ) -> None:
        """Wrap an environment whose `info` carries `time`, and `position` and `torque` (n,).

        Args:
            env: the environment.
            schemes: ids of schemes; "all" are the six.
            terms: at joints; viscous and Coulomb friction by default.
            robot: file of its links, URDF or MJCF, of which lengths and axes are used; None asks the environment.
            rate: samples per second [Hz]; None asks the environment, as for its encoders, whose steps are smoothed.

        Raises:
            ValueError: if a scheme is unknown, or the environment lacks what was not given; when running, if samples
                do not come at the rate.
            BodyError: if the file cannot be read, or without the extra `arms`.
        """
        gym.utils.RecordConstructorArgs.__init__(self, schemes=schemes, terms=terms, robot=robot, rate=rate)
        gym.Wrapper.__init__(self, env)
        rate, body = rate_of(env, rate), body_of(env, robot)
        counts = getattr(env.unwrapped, "counts", COUNTS)
        self.estimators = {
            scheme.id: ArmEstimator(body, rate, terms, scheme, counts=counts)
            for scheme in for_arms(chosen_schemes(schemes))
        }
        self.parameters = tuple(column.name for column in next(iter(self.estimators.values())).model.columns)
        self._clock = Clock(rate)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and forget what was estimated."""
        observation, info = self.env.reset(seed=seed, options=options)
        for estimator in self.estimators.values():
            estimator.reset()
        self._clock.restart()
        self._last = measured(info)
        self._clock.tick(self._last[0])
        return observation, self._add(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment and take in its measurement."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        time, position, _ = self._last
        self._last = measured(info)
        self._clock.tick(self._last[0])
        for estimator in self.estimators.values():
            estimator.update(time, position, self._last[2])  # the torque that was held since
        return observation, reward, terminated, truncated, self._add(info)

    def _add(self, info: dict[str, Any]) -> dict[str, Any]:
        info["parameters"] = self.parameters
        info["estimates"] = {
            id: {"theta": state.theta, "P": state.P, "prediction_error": state.error}
            for id, state in ((id, estimator.state) for id, estimator in self.estimators.items())
        }
        if self.env.render_mode is not None:
            self.env.unwrapped.overlay = self._lines  # type: ignore[attr-defined]
        return info

    def _lines(self) -> tuple[str, ...]:
        """What the picture says: estimates of the first scheme, three in a row."""
        id, estimator = next(iter(self.estimators.items()))
        told = [f"{name:<16}{v:7.3f}" for name, v in zip(self.parameters, estimator.state.theta.tolist(), strict=True)]
        return (id, *(" ".join(told[k : k + 3]) for k in range(0, len(told), 3)))


def terms_of(env: gym.Env[Any, Any], terms: Sequence[str | Term] | None) -> tuple[Term, ...]:
    """Model of an environment's arm: its links and terms at joints, viscous and Coulomb friction by default.

    Raises:
        ValueError: if the environment does not tell its links, or a term is unknown or at no joint.
    """
    body = body_of(env)
    if terms is None:
        return (Links(body), *friction(body))
    slides = dict(zip(body.joints, body.slides, strict=True))
    chosen = []
    for own in terms:
        if isinstance(own, str):
            id, _, joint = own.partition("@")
            own = placed(term(id)(), joint, slides.get(joint, False))
        chosen.append(own)
    check_places(chosen, body.joints)
    return (Links(body), *chosen)


def effects_of(env: gym.Env[Any, Any], names: Sequence[str] | None) -> dict[str, type[Term]]:
    """Effects that the joints of an environment's arm may have, by id; of names, `stribeck` is at each joint.

    Raises:
        ValueError: if the environment does not tell its links, or there is no such effect or joint.
    """
    body = body_of(env)
    alone = {id: kind for id, kind in joint_effects().items() if kind is not Coupling}
    if names is None:
        return {kind.id: kind for kind in at_joints(alone.values(), body)}
    found = [
        own
        for name in names
        for own in ([kind_at(name, body)] if "@" in name else at_joints([find("effect", name, alone)], body))
    ]
    return {kind.id: kind for kind in found}


def body_of(env: gym.Env[Any, Any], robot: str | None = None) -> Body:
    """Links of a file, or of an environment that can write them.

    Raises:
        ValueError: if there is no file, and the environment does not tell.
    """
    if robot is not None:
        return read_body(robot)
    text = getattr(env.unwrapped, "urdf", None)
    if text is None:
        raise ValueError("the environment does not tell its links: pass robot=, a file in URDF or MJCF")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return read_body(path)
