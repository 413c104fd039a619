"""Parameters of an arm that recordings do not tell, by the pendulum's definition (`checks.identifiability.is_told`)."""

from __future__ import annotations

import numpy as np

from estimators.checks.identifiability import TELLING, is_told
from pendulum_env._typing import Array
from pendulum_env.arms.joints import DRAWS, links_of
from pendulum_env.physics import Model

PLACES = 50  # instants at which the joints' inertia is looked at


def untold_of_arm(model: Model, position: Array, velocity: Array, torque: Array) -> frozenset[str]:
    """Base parameters, and friction of joints, that a model fitted to N samples of n joints (N, n) does not tell.

    An error is large if at some joint it is more torque, at the speeds that were seen and at any angle, than was
    recorded; or as much of the inertia, which cannot be nothing, as leaves that open.
    """
    body = links_of(model.terms)
    base = len(body.base)
    largest, fastest = np.abs(torque).max(axis=0), np.abs(velocity).max(axis=0)
    largest = np.where(largest > 0, largest, largest.max())  # of a joint without a motor
    seen = position[:: max(1, len(position) // PLACES)]
    units = np.eye(len(body.joints))
    masses = [body.momentum(seen, np.broadcast_to(unit, seen.shape))[:, k] for k, unit in enumerate(units)]
    inertia = np.abs([np.mean(own @ model.theta[:base]) for own in masses])  # of each joint (n,)
    felt = np.sqrt(np.mean(np.square(masses), axis=1))  # (n, P)
    anywhere = np.random.default_rng(0).uniform(-np.pi, np.pi, (DRAWS, len(body.joints)))
    weight = np.abs(body.torque(anywhere, 0 * anywhere, 0 * anywhere)).max(axis=0)  # (n, P)
    with np.errstate(divide="ignore"):
        links = np.minimum(inertia[:, None] / TELLING.sure / felt, largest[:, None] / weight).min(axis=0)
    large = dict(zip(body.names, links.tolist(), strict=True))
    for joint, most, fast in zip(body.joints, largest.tolist(), fastest.tolist(), strict=True):
        large |= {f"viscous@{joint}": most / max(fast, 1e-300), f"coulomb@{joint}": most}
    return frozenset(name for name, own in model.estimates.items() if not is_told(own, large.get(name, np.inf)))
