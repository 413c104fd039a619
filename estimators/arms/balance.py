"""The balance of an arm on the three views that the six schemes take: n rows a sample, or one of power.

    torque   at an instant                  Y(q, q', q'') theta + f = tau
    impulse  mean over a sample             (M q')' + dU/dq - dK/dq + f = tau, momentum by its increments
    energy   mean over a sample             (K + U)' + q' f = q' tau, stored energy by its increments

The rigid body's columns come from `Body`, those of a joint's terms from the pendulum's views, on the row of its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.arms.measurements import ArmMeasurements
from estimators.regression.equations import Equations
from estimators.schemes.six import View, energy_view, impulse_view, increments, means, supply, torque_view
from estimators.signals.measurements import Measurements
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body
from pendulum_env.physics import Term
from pendulum_env.physics.term import loads


@dataclass(frozen=True)
class ArmView:
    """One of the three views.

    Attributes:
        of_body: regressor of base parameters (N, n, P), or (N, 1, P) where joints add up.
        of_column: the pendulum's view of a column at a joint.
        supplied: what the motor of a joint brings (N,).
        adds_up: whether the rows of all joints make one.
    """

    of_body: Callable[[ArmMeasurements, Body], Array]
    of_column: View
    supplied: Callable[[Measurements], Array]
    adds_up: bool = False


def _torque(m: ArmMeasurements, body: Body) -> Array:
    return body.torque(m.position, m.velocity, m.acceleration)


def _impulse(m: ArmMeasurements, body: Body) -> Array:
    momentum = increments(body.momentum(m.position, m.velocity)) / m.period
    return momentum + means(body.exchange(m.position, m.velocity))


def _power(m: ArmMeasurements, body: Body) -> Array:
    return increments(body.stored(m.position, m.velocity))[:, None] / m.period


VIEWS = {
    "torque": ArmView(_torque, torque_view, lambda m: m.torque),
    "impulse": ArmView(_impulse, impulse_view, lambda m: m.held),
    "energy": ArmView(_power, energy_view, supply, adds_up=True),
}


def rows(m: ArmMeasurements, body: Body, terms: Sequence[Term], view: ArmView) -> list[Equations]:
    """Balances of N samples in base parameters and the terms' parameters: one of each joint, or one of all."""
    m, order = m.remember(terms, body.joints), {joint: k for k, joint in enumerate(body.joints)}
    links = view.of_body(m, body)  # (N, n or 1, P)
    first = links.shape[2]
    phi = np.zeros((*links.shape[:2], first + sum(len(own.columns) for own in terms)))
    phi[:, :, :first] = links
    y = np.column_stack([view.supplied(joint) for joint in m.joints])
    for own in terms:
        factors = {order[joint]: factor for joint, factor in loads(own.at).items()}
        joint, place = _along(m, factors), next(iter(factors))
        for column in own.columns:
            values = view.of_column(joint, column)
            for row, factor in ({0: 1.0} if view.adds_up else factors).items():
                phi[:, row, first] = factor * values
            first += 1
        for column in own.fixed:
            y[:, place] -= view.of_column(joint, column)
    if view.adds_up:
        y = y.sum(axis=1, keepdims=True)
    return [Equations(phi[:, k], y[:, k]) for k in range(y.shape[1])]


def _along(m: ArmMeasurements, factors: Mapping[int, float]) -> Measurements:
    """Measurements of what turns with some joints, each by its factor; with one, those of the joint."""
    first, *others = (m.joints[place] for place in factors)
    if not others:
        return first
    turns = np.array(list(factors.values()))
    motion = (part[:, list(factors)] @ turns for part in (m.position, m.velocity, m.acceleration))
    position, velocity, acceleration = motion
    return replace(first, position=position, velocity=velocity, acceleration=acceleration)
