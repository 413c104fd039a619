"""Balance of an arm in the three views of the six schemes: n rows per sample, or one row of power.

    torque   at an instant                  Y(q, q', q'') theta + f = tau
    impulse  mean over a sample             (M q')' + dU/dq - dK/dq + f = tau, momentum by its increments
    energy   mean over a sample             (K + U)' + q' f = q' tau, stored energy by its increments

Measurements of an arm are those of its joints, at the same instants. The rigid body's columns come from `Body`, those
of a joint's terms from the pendulum's views, on the row of its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.regression.least_squares import Equations
from estimators.schemes import six
from estimators.schemes.six import SCHEMES, Regression, Regressor, Scheme, average_over_samples, compute_increments
from estimators.signals.measurements import Measurements, add_states
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Links
from pendulum_env.physics import Term, list_loads

Joints = tuple[Measurements, ...]  # of n joints


def stack_series(joints: Joints, *names: str) -> tuple[Array, ...]:
    """Stack measured series of all joints, (N, n) each."""
    return tuple(np.column_stack([getattr(m, name) for m in joints]) for name in names)


def stack_motion(joints: Joints) -> tuple[Array, ...]:
    """Return smoothed position, velocity and acceleration of all joints, (N, n) each."""
    return stack_series(joints, "position", "velocity", "acceleration")


def _compute_impulse(joints: Joints, body: Body) -> Array:
    q, v, _ = stack_motion(joints)
    return compute_increments(body.momentum(q, v)) / joints[0].period + average_over_samples(body.exchange(q, v))


def _compute_power(joints: Joints, body: Body) -> Array:
    q, v, _ = stack_motion(joints)
    return compute_increments(body.energy(q, v))[:, None] / joints[0].period


OF_LINKS: dict[
    str, Callable[[Joints, Body], Array]
] = {  # by view: regressor of base parameters (N, n, P), or (N, 1, P)
    "torque": lambda joints, body: body.torque(*stack_motion(joints)),
    "impulse": _compute_impulse,
    "energy": _compute_power,
}


def adapt_to_arms(schemes: Sequence[Regressor]) -> tuple[Scheme, ...]:
    """Adapt schemes to arms: energy schemes have no guard, since one of many joints is always near a reversal."""
    chosen = []
    for one in schemes:
        if not isinstance(one, Scheme):
            raise TypeError(f"{one.id} is a scheme of one joint: an arm takes the six, perhaps with other options")
        chosen.append(replace(one, guard=None) if one.adds_up else one)
    return tuple(chosen)


ARM_SCHEMES = adapt_to_arms(SCHEMES)


def compute_balances(joints: Joints, terms: Sequence[Term], view: str) -> list[Equations]:
    """Compute the balances of N samples in the parameters of terms, the links first: one per joint, or one of all."""
    links, *others = terms
    assert isinstance(links, Links)
    names = links.body.joints
    joints = tuple(
        add_states(m, [own for own in others if own.at == name]) for name, m in zip(names, joints, strict=True)
    )
    of_column, supplied = six.VIEWS[view]
    of_body = OF_LINKS[view](joints, links.body)  # (N, n or 1, P)
    first = of_body.shape[2]
    phi = np.zeros((*of_body.shape[:2], first + sum(len(own.columns) for own in others)))
    phi[:, :, :first] = of_body
    y = np.column_stack([supplied(m) for m in joints])
    for own in others:
        factors = {names.index(joint): factor for joint, factor in list_loads(own.at).items()}
        m, place = _combine_measurements(joints, factors), next(iter(factors))
        for column in own.columns:
            values = of_column(m, column)
            for row, factor in ({0: 1.0} if view == "energy" else factors).items():
                phi[:, row, first] = factor * values
            first += 1
        for column in own.fixed:
            y[:, place] -= of_column(m, column)
    if view == "energy":
        y = y.sum(axis=1, keepdims=True)
    return [Equations(phi[:, k], y[:, k]) for k in range(y.shape[1])]


def apply_scheme(scheme: Scheme, balances: Sequence[Equations], joints: Joints) -> list[Regression]:
    """Apply a scheme to the balance of each joint, or to the balance of all."""
    clear = [m.find_clear(scheme.guard) for m in joints]
    gates = [np.all(clear, axis=0)] if scheme.adds_up else clear
    moving = np.any([m.moving for m in joints], axis=0)
    period = joints[0].period
    return [
        scheme.apply_operator(own, scheme.gate(gate, moving), period) for own, gate in zip(balances, gates, strict=True)
    ]


def _combine_measurements(joints: Joints, factors: Mapping[int, float]) -> Measurements:
    """Combine measurements of joints by factors; for one joint, return its measurements."""
    first = joints[next(iter(factors))]
    if len(factors) == 1:
        return first
    turns = np.array(list(factors.values()))
    position, velocity, acceleration = (part[:, list(factors)] @ turns for part in stack_motion(joints))
    return replace(first, position=position, velocity=velocity, acceleration=acceleration)
