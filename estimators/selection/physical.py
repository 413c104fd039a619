"""Physical bounds of a fitted model."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.decisions.gate import Gate
from estimators.weak_form.nonlinear import list_continuous_parameters
from pendulum_env._typing import Array, ArrayLike
from pendulum_env.physics import (
    LOAD,
    SIGNIFICANT,
    Column,
    Model,
    NonlinearParameter,
    Samples,
    Term,
    effects,
    list_loads,
)
from pendulum_env.physics.limits import collect_limits
from pendulum_env.physics.term import return_zero

CIRCLE = np.linspace(-np.pi, np.pi, 48, endpoint=False)  # [rad], where dry friction is evaluated, recorded or not


def find_violations(
    model: Model, motions: Mapping[str, Samples], recorded: Mapping[str, Samples] | None = None
) -> list[Gate]:
    """Return a failed gate for each physical bound that a fitted model violates at the joints of `motions`.

    `motions` are samples in motion of joints, by name, and `recorded` all samples, by default the same. A single
    friction parameter may be negative if friction in total dissipates power.
    """
    loading = tuple(term for term in model.terms if not motions.keys().isdisjoint(list_loads(term.at)))
    at_joints, units = replace(model, terms=loading), model.units()
    gates = [
        Gate(column.name, value, column.clamp(value), False, units.unit(column.unit))
        for column, value in find_bound_violations(at_joints.terms, at_joints.theta)
    ]
    gates += [
        Gate(term.get_full_name(parameter.name), parameter.high, parameter.high, False, parameter.get_unit(units))
        for term, parameter in find_parameters_at_limit(at_joints.terms)
    ]
    for joint, x in motions.items():
        at_joint = replace(model, terms=tuple(term for term in model.terms if term.at == joint))
        is_coupled = any(joint in list_loads(term.at) for term in model.terms if term.at != joint)
        gates += _find_violations_at(at_joint, x, (recorded or motions)[joint], is_coupled)
    return gates


def _find_violations_at(model: Model, x: Samples, recorded: Samples, is_coupled: bool) -> list[Gate]:
    """Return failed gates of inertia and friction of the terms at one joint with samples `x` in motion.

    Dry friction at rest is too large if it significantly exceeds the largest torque on the joint, at rest or in motion:
    the recorded torque less that of load, potential and time-varying terms. Stops limit the range: one is too soft if
    the motion presses it in by more than the range between them. Friction accelerates if its power in a sample is
    negative by more than 3 standard errors. The power of friction is not tested at a coupled joint, dry friction not
    with links.
    """
    gates = []
    if model.lacks_inertia:
        inertia = model.estimates["inertia"]
        gates.append(Gate("negative_inertia", inertia.value, 0.0, False, inertia.unit))
    columns = [(term, column) for term in model.terms for column in term.columns]
    parts = [(*pair, value) for pair, value in zip(columns, model.theta.tolist(), strict=True)]
    friction = [(term, column, value) for term, column, value in parts if _is_friction(term)]
    share = _compute_driving_share(model, [column for term, column, _ in friction if not term.has_hidden_state], x)
    if share > 0 and not is_coupled:
        gates.append(Gate("driving_friction", share, 0.0, False))
    driving = [(LOAD, 1.0), *((column, value) for term, column, value in parts if _drives_joint(term))]
    dry = _bound_dry_friction(model, [column for _, column, _ in friction if not column.of_torque], x)
    gates += _find_pushing_springs(model, x)
    for lower, upper in (term.ends for term in model.terms if term.ends is not None):
        lowest, highest = float(x.position.min()), float(x.position.max())
        free = min(upper, highest) - max(lower, lowest)
        depth = max(lower - lowest, highest - upper)
        if depth > free:
            gates.append(Gate("soft_stop", depth, free, False, model.units().unit("rad")))
    is_arm = any(term.at for term in model.terms)
    limit = _find_largest_torque(driving, x)
    if dry > limit:  # evaluate all samples only if needed: they include the torque of breaking away
        limit = _find_largest_torque(driving, recorded)
    if dry > limit and x.torque.any() and not is_arm:
        gates.append(Gate("dry_friction", dry, limit, False, model.units().unit("N m")))
    return gates


def _find_largest_torque(driving: Sequence[tuple[Column, float]], x: Samples) -> float:
    """Return the largest recorded torque in samples, less that of columns times their parameters [N m]."""
    driving_torque = sum((value * column.force(x) for column, value in driving), np.zeros_like(x.time))
    return float(np.abs(x.torque - driving_torque).max())


def _find_pushing_springs(model: Model, x: Samples) -> list[Gate]:
    """Return a failed gate for each spring whose torque falls with the angle at a recorded angle.

    Its slope dF/dq is negative there by more than 3 standard errors. With a user's limit on it, a spring has no gate.
    """
    gates, step = [], 1e-4  # exact to 1e-8 of the cubic coefficient
    above, below = (replace(x, position=x.position + change) for change in (step, -step))
    for term in (term for term in model.terms if term.is_restoring):
        theta = np.array([model.estimates[column.name].value for column in term.columns])
        slopes = [(column.force(above) - column.force(below)) / (2 * step) for column in term.columns]
        limited = collect_limits([term])
        is_limited = any(c.name in limited and np.any(slope) for c, slope in zip(term.columns, slopes, strict=True))
        if is_limited or find_bound_violations([term], theta):
            continue
        slope, std = _sum_with_error(model, term.columns, slopes, x)
        worst = int(np.argmin(slope + SIGNIFICANT * std))
        if slope[worst] < -SIGNIFICANT * std[worst]:
            first = term.columns[0]
            gates.append(Gate(first.name, float(slope[worst]), 0.0, False, model.estimates[first.name].unit))
    return gates


def _compute_driving_share(model: Model, friction: Sequence[Column], x: Samples) -> float:
    """Return the share of the samples in which the power of columns of friction is significantly negative."""
    total, std = _sum_with_error(model, friction, [column.power(x) for column in friction], x)
    rounding = 1e-9 * np.abs(total).max()
    return float(np.mean(total < -SIGNIFICANT * std - rounding))


def _sum_with_error(
    model: Model, columns: Sequence[Column], factors: Sequence[ArrayLike], x: Samples
) -> tuple[Array, Array]:
    """Return the sum of the columns' parameters times factors in N samples, and its standard error (N,).

    The standard error is infinite if that of a parameter with a factor is.
    """
    scales = np.array([np.broadcast_to(factor, x.time.shape) for factor in factors]).reshape(-1, len(x.time))
    names = list(model.estimates)
    place = [names.index(column.name) for column, scale in zip(columns, scales, strict=True) if scale.any()]
    scales = scales[scales.any(axis=1)]
    estimates = [model.estimates[names[k]] for k in place]
    total = np.array([estimate.value for estimate in estimates]) @ scales
    if not np.isfinite([estimate.std for estimate in estimates]).all():
        return total, np.full(len(x.time), np.inf)
    covariance = model.assumed_covariance[np.ix_(place, place)]
    return total, np.sqrt(np.maximum(np.einsum("pn,pq,qn->n", scales, covariance, scales), 0.0))


def _is_friction(term: Term) -> bool:
    """Return whether a term is friction, which may change with time: only the sum of its parts must dissipate."""
    return term.kind == "dissipative" or any(column.dry is not return_zero for column in term.columns)


def _drives_joint(term: Term) -> bool:
    """Return whether a term, as gravity does, can set a joint in motion without the motor."""
    return term.kind in ("potential", "time-varying") and term.ends is None and not _is_friction(term)


def _bound_dry_friction(model: Model, friction: Sequence[Column], x: Samples) -> float:
    """Return the largest dry friction of columns at rest, at angles over one turn, less 3 standard errors [N m].

    The time is the median of the samples. A joint that moves later has been at rest, so the largest torque bounds its
    friction there. Without a finite standard error of each column there is no tolerance.
    """
    zeros = np.zeros_like(CIRCLE)
    turn = Samples(zeros + float(np.median(x.time)), CIRCLE, zeros, zeros)
    total, std = _sum_with_error(model, friction, [column.dry(turn) for column in friction], turn)
    return float((total - SIGNIFICANT * np.where(np.isfinite(std), std, 0.0)).max())


def find_bound_violations(terms: Sequence[Term], theta: Array) -> list[tuple[Column, float]]:
    """Return the columns with a linear parameter, of theta (P,), outside its bounds, and its value."""
    columns = (column for term in terms for column in term.columns)
    return [pair for pair in zip(columns, theta.tolist(), strict=True) if not pair[0].is_allowed(pair[1])]


def find_parameters_at_limit(terms: Sequence[Term]) -> list[tuple[Term, NonlinearParameter]]:
    """Return the continuous nonlinear parameters at the upper limit of their law, with their terms.

    A fit ends at its limit if the data have another law. Limits that a user has set do not count.
    """
    at_limit = []
    for term in terms:
        limits = {p.name: p for p in effects().get(term.id, type(term)).nonlinear_parameters}
        values = {limits[p.name]: term.nonlinear_values[p.name] for p in list_continuous_parameters(term)}
        at_limit += [(term, parameter) for parameter, value in values.items() if value >= parameter.high]
    return at_limit
