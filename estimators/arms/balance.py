"""The balance of an arm on the three views that the six schemes take: n rows a sample, or one of power.

    torque   at an instant                  Y(q, q', q'') theta + f = tau
    impulse  mean over a sample             (M q')' + dU/dq - dK/dq + f = tau, momentum by its increments
    energy   mean over a sample             (K + U)' + q' f = q' tau, stored energy by its increments

Measurements of an arm are those of its joints, at the same instants. The rigid body's columns come from `Body`, those
of a joint's terms from the pendulum's views, on the row of its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.regression.equations import Equations
from estimators.schemes import six
from estimators.schemes.six import View, increments, means
from estimators.signals.measurements import Measurements, measure_joints, remember
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Links
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Term
from pendulum_env.physics.term import loads

Joints = tuple[Measurements, ...]  # of n joints


@dataclass(frozen=True)
class ArmView:
    """One of the three views.

    Attributes:
        of_body: regressor of base parameters (N, n, P), or (N, 1, P) where joints add up.
        of_column: the pendulum's view of a column at a joint.
        supplied: what the motor of a joint brings (N,).
        adds_up: whether the rows of all joints make one.
    """

    of_body: Callable[[Joints, Body], Array]
    of_column: View
    supplied: Callable[[Measurements], Array]
    adds_up: bool = False


def measure_arm(recording: ArmRecording) -> list[Joints]:
    """Measurements of each segment of a recording, see `measure_joints`; raises RecordingError for a current."""
    recording.refuse_currents()
    return measure_joints(recording.joints)


def series(joints: Joints, *names: str) -> tuple[Array, ...]:
    """Some of what was measured of all joints, (N, n) each."""
    return tuple(np.column_stack([getattr(m, name) for m in joints]) for name in names)


def motion(joints: Joints) -> tuple[Array, ...]:
    """Smoothed position, velocity and acceleration of all joints, (N, n) each."""
    return series(joints, "position", "velocity", "acceleration")


def _impulse(joints: Joints, body: Body) -> Array:
    q, v, _ = motion(joints)
    return increments(body.momentum(q, v)) / joints[0].period + means(body.exchange(q, v))


def _power(joints: Joints, body: Body) -> Array:
    q, v, _ = motion(joints)
    return increments(body.stored(q, v))[:, None] / joints[0].period


VIEWS = {  # as of one joint, with the regressor of the links
    "torque": ArmView(lambda joints, body: body.torque(*motion(joints)), *six.VIEWS["torque"]),
    "impulse": ArmView(_impulse, *six.VIEWS["impulse"]),
    "energy": ArmView(_power, *six.VIEWS["energy"], adds_up=True),
}


def rows(joints: Joints, terms: Sequence[Term], view: ArmView) -> list[Equations]:
    """Balances of N samples in the parameters of terms, the links first: one of each joint, or one of all."""
    links, *others = terms
    assert isinstance(links, Links)
    names = links.body.joints
    joints = tuple(
        remember(m, [own for own in others if own.at == name]) for name, m in zip(names, joints, strict=True)
    )
    of_body = view.of_body(joints, links.body)  # (N, n or 1, P)
    first = of_body.shape[2]
    phi = np.zeros((*of_body.shape[:2], first + sum(len(own.columns) for own in others)))
    phi[:, :, :first] = of_body
    y = np.column_stack([view.supplied(m) for m in joints])
    for own in others:
        factors = {names.index(joint): factor for joint, factor in loads(own.at).items()}
        m, place = _along(joints, factors), next(iter(factors))
        for column in own.columns:
            values = view.of_column(m, column)
            for row, factor in ({0: 1.0} if view.adds_up else factors).items():
                phi[:, row, first] = factor * values
            first += 1
        for column in own.fixed:
            y[:, place] -= view.of_column(m, column)
    if view.adds_up:
        y = y.sum(axis=1, keepdims=True)
    return [Equations(phi[:, k], y[:, k]) for k in range(y.shape[1])]


def _along(joints: Joints, factors: Mapping[int, float]) -> Measurements:
    """Measurements of what turns with some joints, each by its factor; with one, those of the joint."""
    first = joints[next(iter(factors))]
    if len(factors) == 1:
        return first
    turns = np.array(list(factors.values()))
    position, velocity, acceleration = (part[:, list(factors)] @ turns for part in motion(joints))
    return replace(first, position=position, velocity=velocity, acceleration=acceleration)
