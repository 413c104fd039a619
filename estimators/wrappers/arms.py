"""What the wrappers ask of an arm: its links, the model of it, and effects that its joints may have."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym

from estimators.arguments import chosen_terms
from estimators.wrappers.options import AnyEnv, is_arm
from pendulum_env.arms.body import Body, read_body
from pendulum_env.arms.joints import Coupling, Links, arm_base, joint_effects, kinds_at
from pendulum_env.physics import Term
from pendulum_env.physics.library import effect


def terms_of(body: Body | None, terms: Sequence[str | Term] | None) -> tuple[Term, ...]:
    """Model of an arm, its links and terms at joints, viscous and Coulomb friction by default; or of a pendulum.

    Raises:
        ValueError: if a term is unknown or at no joint.
    """
    if body is None:
        return chosen_terms(terms)
    return arm_base(body) if terms is None else chosen_terms((Links(body), *terms))


def effects_of(body: Body | None, names: Sequence[str] | None) -> dict[str, type[Term]] | None:
    """Effects that may be missing, by id; `stribeck` is at each joint of an arm. None are all of a pendulum.

    Raises:
        ValueError: if there is no such effect or joint.
    """
    if body is None:
        return None if names is None else {id: effect(id) for id in names}
    known = [id for id in joint_effects() if id != Coupling.id] if names is None else names
    return {kind.id: kind for kind in kinds_at(known, body)}


def arm_of(env: AnyEnv, robot: str | None) -> Body | None:
    """Links of a file, or of an environment that can write them; None of a pendulum.

    Raises:
        ValueError: if the environment is a vector of arms, or as `body_of`.
    """
    if robot is None and not is_arm(env):
        return None
    if not isinstance(env, gym.Env):
        raise ValueError("arms are watched and diagnosed one by one: wrap each environment of the vector")
    return body_of(env, robot)


def body_of(env: gym.Env[Any, Any], robot: str | None = None) -> Body:
    """Links of a file, or of an environment that can write them.

    Raises:
        ValueError: if there is no file, and the environment does not tell, or the file has more joints or fewer.
    """
    if robot is not None:
        body = read_body(robot)
        joints = tuple(getattr(env.unwrapped, "joints", body.joints))
        if len(joints) != len(body.joints):
            raise ValueError(f"the environment has joints {', '.join(joints)}, and {robot} {', '.join(body.joints)}")
        return body
    text = getattr(env.unwrapped, "urdf", None)
    if text is None:
        raise ValueError("the environment does not tell its links: pass robot=, a file in URDF or MJCF")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return read_body(path)
