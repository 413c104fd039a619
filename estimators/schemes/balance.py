"""Balances of recordings, stacked; of several joints in the three views of the six schemes.

    torque   at an instant                  Y(q, q', q'') theta + f = tau
    impulse  mean over a sample             (M q')' + dU/dq - dK/dq + f = tau, momentum by its increments
    energy   mean over a sample             (K + U)' + q' f = q' tau, stored energy by its increments

A mechanism of n joints has n rows per sample in the views of torque and impulse, and one row in the view of energy.
`LinkedMechanism` has the columns of the links. The views of the pendulum make the columns of other terms, in the row of
their joint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators.regression.least_squares import Equations, subtract_known_columns, weigh_joints, weigh_recordings
from estimators.schemes import six
from estimators.schemes.six import Regression, Regressor, Scheme, average_over_samples, compute_increments
from estimators.signals.measurements import Measurements, add_states, measure_joints
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import Term, list_loads
from pendulum_env.physics.joints import Links
from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.physics.term import return_zero
from pendulum_env.recording import Recording

CLUSTER_TIME = 0.5  # [s], longer than the correlation of residuals without drift; shorter in short recordings
N_CLUSTERS = 30  # least number in all recordings together

Joints = tuple[Measurements, ...]  # measurements of n joints at the same instants
Segments = Sequence[Sequence[Joints]]  # by recording, then by segment


@dataclass(frozen=True, eq=False)
class Stack:
    """Equations of all recordings (R,); those of several joints at one instant are adjacent.

    Attributes:
        equations: R equations in P unknowns.
        usable: mask of the equations away from stick (R,).
        weights: weight of each equation (R,).
        joint: number of the joint (R,), 0 if the balances of the joints are summed.
        clusters: number of the short stretch of time (R,), within one recording.
        time: duration of all segments up to the equation (R,) [s].
        starts: index of the first equation of each segment.
    """

    equations: Equations
    usable: Mask
    weights: Array
    joint: Index
    clusters: Index
    time: Array
    starts: tuple[int, ...]


def stack_series(joints: Joints, *names: str) -> tuple[Array, ...]:
    """Stack measured series of all joints, (N, n) each."""
    return tuple(np.column_stack([getattr(m, name) for m in joints]) for name in names)


def stack_motion(joints: Joints) -> tuple[Array, ...]:
    """Return smoothed position, velocity and acceleration of all joints, (N, n) each."""
    return stack_series(joints, "position", "velocity", "acceleration")


def _compute_link_columns(joints: Joints, mechanism: LinkedMechanism, view: str) -> Array:
    """Compute the columns of the base parameters of the links in a view (N, n or 1, P)."""
    (q, v, a), period = stack_motion(joints), joints[0].period
    if view == "torque":
        return mechanism.torque(q, v, a)
    if view == "impulse":
        return compute_increments(mechanism.momentum(q, v)) / period + average_over_samples(mechanism.exchange(q, v))
    return compute_increments(mechanism.energy(q, v))[:, None] / period


def adapt_to_arms(schemes: Sequence[Regressor]) -> tuple[Scheme, ...]:
    """Remove the guard of energy schemes for a linked mechanism: one of its joints is always near a reversal."""
    adapted = []
    for scheme in schemes:
        if not isinstance(scheme, Scheme):
            raise TypeError(f"{scheme.id} is a scheme of one joint: an arm takes the six, perhaps with other options")
        adapted.append(replace(scheme, guard=None) if scheme.adds_up else scheme)
    return tuple(adapted)


def compute_balances(joints: Joints, terms: Sequence[Term], view: str) -> list[Equations]:
    """Compute the balance of N samples for each joint, or the summed balance of energy.

    Columns and fixed columns of a term act on each joint that it loads, times the factor of the joint.

    Args:
        joints: measurements of the n joints at N instants.
        terms: terms of the model, the links first.
        view: key of `VIEWS`: `torque`, `impulse` or `energy`.
    """
    links, *others = terms
    assert isinstance(links, Links)
    names = links.mechanism.joints
    joints = add_joint_states(joints, terms)
    view_column, supplied = six.VIEWS[view]
    link_columns = _compute_link_columns(joints, links.mechanism, view)  # (N, n or 1, P)
    column_index = link_columns.shape[2]
    phi = np.zeros((*link_columns.shape[:2], column_index + sum(len(term.columns) for term in others)))
    phi[:, :, :column_index] = link_columns
    y = np.column_stack([supplied(m) for m in joints])
    for term in others:
        factors = {names.index(joint): factor for joint, factor in list_loads(term.at).items()}
        m, row_factors = _combine_measurements(joints, factors), {0: 1.0} if view == "energy" else factors
        rows, row_factor = list(row_factors), np.array([*row_factors.values()])
        for column in term.columns:
            phi[:, rows, column_index] = np.multiply.outer(view_column(m, column), row_factor)
            column_index += 1
        for column in term.fixed:
            y[:, rows] -= np.multiply.outer(view_column(m, column), row_factor)
    if view == "energy":
        y = y.sum(axis=1, keepdims=True)
    return [Equations(phi[:, k], y[:, k]) for k in range(y.shape[1])]


def apply_scheme(scheme: Scheme, balances: Sequence[Equations], joints: Joints) -> list[Regression]:
    """Apply a scheme to the balance of each joint, or to the summed balance.

    With a guard, a summed balance leaves out samples near stick of any joint.
    """
    clear = [m.find_clear(scheme.guard) for m in joints]
    gates = [np.all(clear, axis=0)] if scheme.adds_up else clear
    moving = np.any([m.moving for m in joints], axis=0)
    period = joints[0].period
    pairs = zip(balances, gates, strict=True)
    return [scheme.apply_operator(balance, scheme.gate(gate, moving), period) for balance, gate in pairs]


def _combine_measurements(joints: Joints, factors: Mapping[int, float]) -> Measurements:
    """Combine position, velocity and acceleration of joints, weighted by their factors; other series are of the first.

    Measurements of one joint are returned without its factor.
    """
    first = joints[next(iter(factors))]
    if len(factors) == 1:
        return first
    weights = np.array(list(factors.values()))
    position, velocity, acceleration = (series[:, list(factors)] @ weights for series in stack_motion(joints))
    return replace(first, position=position, velocity=velocity, acceleration=acceleration, unfiltered=None)


def measure_segments(recordings: Sequence[Recording], terms: Sequence[Term]) -> Segments:
    """Measure the joints in each segment of recordings, with the states of the terms along the motion."""
    return [[add_joint_states(joints, terms) for joints in measure_joints(r.joints)] for r in recordings]


def add_joint_states(joints: Joints, terms: Sequence[Term]) -> Joints:
    """Return measurements of joints with the states of the terms at each."""
    names = terms[0].mechanism.joints
    return tuple(
        add_states(m, [term for term in terms if term.at == name]) for m, name in zip(joints, names, strict=True)
    )


def make_regressions(terms: Sequence[Term]) -> Callable[[Regressor, Joints], list[Regression]]:
    """Make the function that computes the regressions of joints from a scheme and their measurements.

    Balances with links are memoised by the identity of `joints`.
    """
    balances: dict[tuple[int, str], list[Equations]] = {}

    def compute_regressions(scheme: Regressor, joints: Joints) -> list[Regression]:
        if not (isinstance(scheme, Scheme) and isinstance(terms[0], Links)):
            return [scheme.regression(m, terms) for m in joints]
        key = id(joints), scheme.view
        if key not in balances:
            balances[key] = compute_balances(joints, terms, scheme.view)
        return apply_scheme(scheme, balances[key], joints)

    return compute_regressions


def stack_equations(
    segments: Segments, compute_regressions: Callable[[Joints], list[Regression]], terms: Sequence[Term] = ()
) -> Stack:
    """Stack the equations of all segments, weighted by the noise of joints, or of the recordings of a pendulum.

    Args:
        segments: measurements of the joints in each segment of each recording.
        compute_regressions: function from measurements of the joints to their regressions.
        terms: terms of the columns; known parameters are subtracted before the noise of recordings is compared.
    """
    measured = [joints[0] for group in segments for joints in group]
    regressions = [compute_regressions(joints) for group in segments for joints in group]
    cluster_time, count = min(CLUSTER_TIME, sum(len(m) * m.period for m in measured) / N_CLUSTERS), len(regressions[0])
    clusters, times, total_time, n_clusters = [], [], 0.0, 0
    for m in measured:
        elapsed = np.arange(1, len(m) + 1) * m.period
        cluster = np.minimum((elapsed / cluster_time).astype(np.intp), max(0, round(elapsed[-1] / cluster_time) - 1))
        clusters.append(n_clusters + cluster)
        times.append(total_time + elapsed)
        total_time, n_clusters = total_time + float(elapsed[-1]), n_clusters + int(cluster[-1]) + 1
    equations = Equations(
        np.concatenate([_interleave_rows([r.equations.phi for r in of_joints]) for of_joints in regressions]),
        np.concatenate([_interleave_rows([r.equations.y for r in of_joints]) for of_joints in regressions]),
    )
    usable = np.concatenate([_interleave_rows([r.usable for r in of_joints]) for of_joints in regressions])
    n_instants = [sum(len(joints[0]) for joints in group) for group in segments]
    recording = np.repeat(np.arange(len(segments)), count * np.array(n_instants))
    joint = np.tile(np.arange(count), len(usable) // count)
    weights = np.ones(len(usable))
    if count > 1:
        weights[usable] = weigh_joints(Equations(equations.phi[usable], equations.y[usable]), joint[usable])
    elif len(segments) > 1:
        columns = [column for term in terms for column in term.columns]
        known_values = {j: column.least for j, column in enumerate(columns) if column.is_known}
        unknown_part = subtract_known_columns(equations, list(known_values), np.array(list(known_values.values())))
        theta = np.linalg.lstsq(unknown_part.phi[usable], unknown_part.y[usable], rcond=None)[0]
        residual = (unknown_part.y - unknown_part.phi @ theta) * usable
        squares = np.asarray(np.bincount(recording, residual**2), dtype=float)
        weights = weigh_recordings(squares, np.bincount(recording, usable), 0.0)[recording]
    cluster_of_row, time = (np.repeat(np.concatenate(series), count) for series in (clusters, times))
    starts = tuple((count * np.cumsum([0, *(len(m) for m in measured[:-1])])).tolist())
    return Stack(equations, usable, weights, joint, cluster_of_row, time, starts)


def _interleave_rows(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Interleave the rows of n joints (N, ...): rows of one instant become adjacent (n N, ...)."""
    return parts[0] if len(parts) == 1 else np.stack(parts, axis=1).reshape(-1, *parts[0].shape[1:])


def find_momentum_columns(terms: Sequence[Term]) -> list[int]:
    """Find the indices of the columns of the momentum, which have mass."""
    has_momentum = [column.mass is not return_zero for term in terms for column in term.columns]
    if isinstance(terms[0], Links):
        mechanism = terms[0].mechanism
        q, v = np.random.default_rng(0).uniform(-np.pi, np.pi, (2, 20, len(mechanism.joints)))
        has_momentum[: len(mechanism.base)] = np.abs(mechanism.momentum(q, v)).max(axis=(0, 1)) > 1e-9
    return np.flatnonzero(has_momentum).tolist()
