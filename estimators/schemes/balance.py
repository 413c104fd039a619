"""Balances of recordings, stacked; of an arm in the three views of the six schemes.

    torque   at an instant                  Y(q, q', q'') theta + f = tau
    impulse  mean over a sample             (M q')' + dU/dq - dK/dq + f = tau, momentum by its increments
    energy   mean over a sample             (K + U)' + q' f = q' tau, stored energy by its increments

In the view of torque or impulse an arm has n rows per sample, in that of energy one row. Its measurements are those of
its joints, at the same instants. The rigid body's columns come from `Body`, those of a joint's terms from the
pendulum's views, on the row of its joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators.regression.least_squares import Equations, give, weigh_joints, weigh_recordings
from estimators.schemes import six
from estimators.schemes.six import SCHEMES, Regression, Regressor, Scheme, average_over_samples, compute_increments
from estimators.signals.measurements import Measurements, add_states, measure_joints
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Links
from pendulum_env.physics import Term, list_loads
from pendulum_env.physics.term import zero
from pendulum_env.recording import Recording

CLUSTER = 0.5  # [s], longer than residuals stay correlated, except those that drift; shorter in short recordings
CLUSTERS = 30  # at least, in all recordings together

Joints = tuple[Measurements, ...]  # of n joints
Segments = Sequence[Sequence[Joints]]  # of each recording, the measurements of the joints in each of its segments


@dataclass(frozen=True, eq=False)
class Stack:
    """Equations of all recordings (R,); those of the joints of an arm at one instant are adjacent.

    Attributes:
        equations: R equations in P unknowns.
        usable: those that are away from stick (R,).
        weights: of the equations (R,).
        joint: number of the joint (R,), 0 where the balances of the joints add up.
        recording: number of the recording (R,).
        clusters: short stretches of time (R,), never across recordings.
        time: seconds of recording taken in (R,) [s].
        starts: where each segment starts.
    """

    equations: Equations
    usable: Mask
    weights: Array
    joint: Index
    recording: Index
    clusters: Index
    time: Array
    starts: tuple[int, ...]


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


def measure_segments(recordings: Sequence[Recording], terms: Sequence[Term]) -> Segments:
    """Measure the joints in each segment of recordings, with the states of the terms along the motion."""
    names = terms[0].mechanism.joints
    own = [[term for term in terms if term.at == name] for name in names]
    return [
        [tuple(map(add_states, joints, own)) for joints in measure_joints(recording.joints)] for recording in recordings
    ]


def make_regressions(terms: Sequence[Term]) -> Callable[[Regressor, Joints], list[Regression]]:
    """Compute the regression of each joint, or of all joints; balances of an arm are memoised."""
    kept: dict[tuple[int, str], list[Equations]] = {}

    def of(scheme: Regressor, joints: Joints) -> list[Regression]:
        if not (isinstance(scheme, Scheme) and isinstance(terms[0], Links)):
            return [scheme.regression(m, terms) for m in joints]
        key = id(joints), scheme.view
        if key not in kept:
            kept[key] = compute_balances(joints, terms, scheme.view)
        return apply_scheme(scheme, kept[key], joints)

    return of


def stack(segments: Segments, of: Callable[[Joints], list[Regression]], terms: Sequence[Term] = ()) -> Stack:
    """Stack the equations of all segments, weighted by the noise of recordings and joints."""
    measured = [joints[0] for own in segments for joints in own]
    parts = [of(joints) for own in segments for joints in own]
    length, count = min(CLUSTER, sum(len(m) * m.period for m in measured) / CLUSTERS), len(parts[0])
    clusters, times, seconds, first = [], [], 0.0, 0
    for m in measured:
        elapsed = np.arange(1, len(m) + 1) * m.period
        cluster = np.minimum((elapsed / length).astype(np.intp), max(0, round(elapsed[-1] / length) - 1))
        clusters.append(first + cluster)
        times.append(seconds + elapsed)
        seconds, first = seconds + float(elapsed[-1]), first + int(cluster[-1]) + 1
    equations = Equations(
        np.concatenate([_interleave_rows([own.equations.phi for own in part]) for part in parts]),
        np.concatenate([_interleave_rows([own.equations.y for own in part]) for part in parts]),
    )
    usable = np.concatenate([_interleave_rows([own.usable for own in part]) for part in parts])
    recording = np.repeat(np.arange(len(segments)), [sum(len(joints[0]) for joints in own) * count for own in segments])
    joint = np.tile(np.arange(count), len(usable) // count)
    weights = np.ones(len(usable))
    if count > 1:
        weights[usable] = weigh_joints(Equations(equations.phi[usable], equations.y[usable]), joint[usable])
    elif len(segments) > 1:
        given = {j: column.least for j, column in enumerate(c for t in terms for c in t.columns) if column.is_known}
        open_to = give(equations, list(given), np.array(list(given.values())))
        theta = np.linalg.lstsq(open_to.phi[usable], open_to.y[usable], rcond=None)[0]
        residual = (open_to.y - open_to.phi @ theta) * usable
        squares = np.asarray(np.bincount(recording, residual**2), dtype=float)
        weights = weigh_recordings(squares, np.bincount(recording, usable), 0.0)[recording]
    clusters_of, time = (np.repeat(np.concatenate(own), count) for own in (clusters, times))
    starts = tuple((count * np.cumsum([0, *(len(m) for m in measured[:-1])])).tolist())
    return Stack(equations, usable, weights, joint, recording, clusters_of, time, starts)


def _interleave_rows(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Interleave the rows of joints (N, ...), so that those of one instant are adjacent (n N, ...)."""
    return parts[0] if len(parts) == 1 else np.stack(parts, axis=1).reshape(-1, *parts[0].shape[1:])


def find_momentum_columns(terms: Sequence[Term]) -> list[int]:
    """Return the indices of the columns of the momentum."""
    own = [column.mass is not zero for term in terms for column in term.columns]
    if isinstance(terms[0], Links):  # whose columns `Body` has
        body = terms[0].body
        q, v = np.random.default_rng(0).uniform(-np.pi, np.pi, (2, 20, len(body.joints)))
        own[: len(body.base)] = np.abs(body.momentum(q, v)).max(axis=(0, 1)) > 1e-9
    return np.flatnonzero(own).tolist()
