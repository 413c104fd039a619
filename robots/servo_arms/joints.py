"""Joints of an arm of servos as recordings of single servos, with the torque of the links at each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from pendulum_env._typing import Array
from pendulum_env.errors import UserError
from pendulum_env.physics import Model, Term
from pendulum_env.physics.base import Coulomb, Inertia, Viscous
from pendulum_env.recording import Recording
from pendulum_env.settings import Blank, format_setting
from robots.arms.body import Body
from robots.arms.recording import ArmRecording
from robots.servo_arms.links import (
    LinkTable,
    LinkTorque,
    list_link_columns,
    list_names,
    make_link_torque,
    select_columns,
)

SAME_RATE = 1e-3  # largest relative difference of rates that are equal, apart from clocks
PAUSE = 1.0  # [s] between recordings on the common clock
STRIDE = 2  # samples of the log between two of the regressors
LEAST_SHARE = 0.006  # least norm of the independent part of a column, relative to the largest at all joints
SMOOTHING = 0.16  # [s], length of the filter that differentiates positions


@dataclass(frozen=True)
class DrivenJoint:
    """Joint of an arm as a servo: its fitted and held-out recordings, its base terms, and its model, if given."""

    name: str
    recordings: tuple[Recording, ...]
    holdout: tuple[Recording, ...]
    base: tuple[Term, ...]
    model: Model | None = None


def divide_arm(
    body: Body,
    recordings: Sequence[ArmRecording],
    holdout: Sequence[ArmRecording],
    servos: Mapping[str, Model],
) -> list[DrivenJoint]:
    """Return the joints of an arm as servos, with known models of servos by joint.

    Recordings follow each other on one clock, by which the torque of the links finds the motion of the other joints.

    Raises:
        UserError: if a joint is linear.
    """
    if sliding := [joint for joint in body.joints if joint in body.prismatic_joints]:
        raise UserError(
            f"joint '{sliding[0]}' is linear, and servos turn: hold it by naming the joints that turn, "
            f"{format_setting('joints', Blank('A,B,C'))}"
        )
    every, count = _put_on_one_clock([*recordings, *holdout]), len(recordings)
    names = {at: list_link_columns(model.terms) for at, model in servos.items()}
    links, joints = _list_links(body, every, count, names), []
    for k, name in enumerate(body.joints):
        own = tuple(recording.joints[k] for recording in every)
        base: tuple[Term, ...] = (Inertia(), *links[k], Viscous(), Coulomb())
        model = servos.get(name)
        if model is not None:
            new = {term.id: term for term in links[k]}
            model = replace(model, terms=tuple(new.get(term.id, term) for term in model.terms))
            base = model.terms
        joints.append(DrivenJoint(name, own[:count], own[count:], base, model))
    return joints


def _put_on_one_clock(recordings: Sequence[ArmRecording]) -> list[ArmRecording]:
    """Return the recordings after each other, those of almost equal rates with one rate.

    Samples of one rate are whole numbers of steps apart in a simulation, so its inputs are constant between them.
    """
    begin, result, rates = 0.0, list[ArmRecording](), np.array([recording.rate for recording in recordings])
    rate = float(np.median(rates))
    is_same = bool((np.abs(rates - rate) <= SAME_RATE * rate).all())
    for recording in recordings:
        time = recording.time - recording.time[0]
        if is_same:
            count = np.diff((*recording.starts, len(recording)))
            time = np.repeat(time[[*recording.starts]], count) + np.concatenate([np.arange(n) for n in count]) / rate
        result.append(replace(recording, time=time + begin, clock_start=0.0))
        begin = float(result[-1].time[-1]) + PAUSE
    return result


def _list_links(
    body: Body, recordings: Sequence[ArmRecording], count: int, known: Mapping[str, tuple[str, ...]]
) -> list[tuple[Term, ...]]:
    """Return the torque of the links at each joint; nothing without one.

    Its columns are `known` by joint, or chosen by the first `count` recordings, which are fitted.
    """
    rows = [np.unique(np.append(np.arange(0, len(r), STRIDE), len(r) - 1)) for r in recordings]
    time = np.concatenate([r.time[own] for r, own in zip(recordings, rows, strict=True)])
    motions = [[series[own] for series in _differentiate(r)] for r, own in zip(recordings, rows, strict=True)]
    q, v, a = (np.concatenate(series) for series in zip(*motions, strict=True))
    rest, n_fitted = np.zeros_like(q), sum(map(len, rows[:count]))
    gravity, total = body.torque(q, rest, rest), body.torque(q, v, a)  # (N, n, P)
    sizes = _list_typical_sizes(body)
    weighted = total[:n_fitted] * sizes
    least = LEAST_SHARE * float(np.linalg.norm(weighted, axis=0).max(initial=0.0))
    result = list[tuple[Term, ...]]()
    for k in range(len(body.joints)):
        turned, unit = q.copy(), rest.copy()
        turned[:, k], unit[:, k] = q[:, k] + np.pi / 2, 1.0
        held, ahead = gravity[:, k], body.torque(turned, rest, rest)[:, k]
        mass = body.torque(q, rest, unit)[:, k] - held
        sine, cosine = np.sin(q[:, k, None]), np.cos(q[:, k, None])
        other = total[:, k] - held - mass * a[:, k, None]
        series = np.stack([mass, held * cosine - ahead * sine, held * sine + ahead * cosine, other], axis=2)
        every_name = list_names(body.names)
        if (joint := body.joints[k]) in known:
            chosen = [every_name.index(name) for name in known[joint]]
        else:
            chosen = select_columns(weighted[:, k], a[:n_fitted, k], least)
        names = tuple(every_name[place] for place in chosen)
        known_columns = np.column_stack([a[:n_fitted, k], total[:n_fitted, k, chosen]])
        shares = np.linalg.lstsq(known_columns, total[:n_fitted, k])[0]
        table = LinkTable(names, time, series[:, chosen].reshape(len(time), -1), shares)
        result.append((make_link_torque(LinkTorque, table)(),) if chosen else ())
    return result


def _differentiate(recording: ArmRecording) -> tuple[Array, Array, Array]:
    """Return the smoothed positions, velocities and accelerations of all joints (N, n) each."""
    parts = []
    for segment in recording.segments:
        length = min(2 * round(0.5 * SMOOTHING * segment.rate) + 1, 2 * ((len(segment) - 1) // 2) + 1)
        smooth = partial(scipy.signal.savgol_filter, segment.position, length, min(3, length - 1), axis=0)
        parts.append([smooth(deriv=order, delta=1.0 / segment.rate) for order in range(3)])
    q, v, a = (np.concatenate(series) for series in zip(*parts, strict=True))
    return q, v, a


def _list_typical_sizes(body: Body) -> Array:
    """Return a typical size of each base parameter (P,): that in the robot file, or a tenth of those of its kind."""
    kinds = np.array([name[0] for name in body.names])  # first moments and inertias
    sizes = [np.sqrt(np.mean(body.values[kinds == kind] ** 2)) for kind in kinds.tolist()]
    return np.maximum(np.abs(body.values), 0.1 * np.array(sizes))
