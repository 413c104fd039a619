"""Windowed equations of several joints, grouped by joint, with columns of links that depend on all joints.

A window of a joint is clear of stick and reversals of this joint; other joints may stick. The columns of links are
linear in the acceleration, <w Y(q, q', q'')> = <w M(q) q''> + <w Y(q, q', 0)>. The first part averages raw second
differences of the positions; the second is smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.decisions.score import BLOCK
from estimators.regression.least_squares import IdentificationError, solve_least_squares
from estimators.signals.motion import HALF_WIDTHS
from estimators.weak_form.averages import WindowAverages
from estimators.weak_form.preparation import choose_half_width, limit_noise, smooth_laws
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.torque_windows import PayloadColumns, TermColumns, TorqueWindows, join_windows
from estimators.weak_form.window_columns import WindowColumns, WindowTorque
from estimators.weak_form.windows import Windows, cut
from pendulum_env._typing import Array
from pendulum_env.physics import Term, list_loads
from pendulum_env.physics.joints import Coupling, Links, find_linked_mechanism
from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.recording import Recording


def prepare_arm(
    recordings: Sequence[Recording],
    terms: Sequence[type[Term] | Term],
    margin: float = 0.0,
    block: float = BLOCK,
    half_widths: Sequence[float] | None = None,
    fitted: TorqueWindows | None = None,
) -> TorqueWindows:
    """Cut recordings into windows, with the columns of links and couplings; `margin` is that of `cut`.

    Half widths [s] are chosen by the noise of the recordings unless given. A `block` of the score lasts so long [s].
    `fitted` are windows of an earlier part of the same recordings, with the same sensors: their half widths and noise
    are taken.

    Raises:
        IdentificationError: if a joint moves too little clear of stick.
    """
    mechanism = find_linked_mechanism(terms)
    earlier = {} if fitted is None else {(w.at, w.run): w for w in fitted.windows}
    if earlier:
        half_widths = [earlier[mechanism.joints[0], run].half_width for run in range(len(recordings))]
    widths = half_widths or [choose_common_width(recording.joints) for recording in recordings]
    entries = [
        [
            replace(cut(joint, width, margin=margin), at=name, run=run, payload=recording.link_load)
            for name, joint in zip(mechanism.joints, recording.joints, strict=True)
        ]
        for run, (recording, width) in enumerate(zip(recordings, widths, strict=True))
    ]
    for k, name in enumerate(mechanism.joints):
        if sum(len(joints[k].centers) for joints in entries) < RESOLUTION.fewest_of_joint:
            names = ", ".join(recording.name for recording in recordings)
            raise IdentificationError(
                f"{names}: joint '{name}' is rarely clear of stick and reversals: record longer, faster or wider motion"
            )
    parts = [_compute_link_columns(joints, mechanism) for joints in entries]
    if earlier:
        calibrated = [[w.with_noise_of(earlier[w.at, w.run]) for w in joints] for joints in entries]
    else:
        calibrated = [
            [_calibrate_windows(joints, k, part) for k in range(len(joints))]
            for joints, part in zip(entries, parts, strict=True)
        ]
    if any(w.noise.excess is not None for joints in calibrated for w in joints):  # other scales of equations
        parts = [_compute_link_columns(joints, mechanism) for joints in calibrated]
    return replace(_join_joints(calibrated, parts, terms), block=block)


def choose_common_width(joints: Sequence[Recording]) -> float:
    """Choose the half width of the windows of all joints [s]; long ones would leave none of a fast joint."""
    return max(choose_half_width(joint, longest=HALF_WIDTHS[-1]) for joint in joints)


def join_recording(entries: Sequence[Windows], terms: Sequence[Term]) -> TorqueWindows:
    """Join the windows of the joints of one recording, with the columns of links and couplings."""
    return _join_joints([entries], [_compute_link_columns(entries, find_linked_mechanism(terms))], terms)


def _join_joints(
    entries: Sequence[Sequence[Windows]], parts: Sequence[_LinkColumns], terms: Sequence[type[Term] | Term]
) -> TorqueWindows:
    """Join windows of all recordings, grouped by joint, with the columns of links, couplings and payloads.

    `entries` has per recording the windows of each joint, `parts` the links' columns of these.
    """
    mechanism, kinds = (
        find_linked_mechanism(terms),
        dict.fromkeys(term if isinstance(term, type) else type(term) for term in terms),
    )
    joints = range(len(mechanism.joints))
    linear, rates = (
        np.concatenate([joints_of_run[k] for k in joints for joints_of_run in series])
        for series in zip(*((part.linear, part.rates) for part in parts), strict=True)
    )
    inertia = np.mean([np.diagonal(part.masses.mean(axis=0), axis1=1, axis2=2).T for part in parts], axis=0)
    data = join_windows(
        [joints_of_run[k] for k in joints for joints_of_run in entries], {Links.id: TermColumns(linear, rates, inertia)}
    )
    return replace(
        data,
        shared_columns={
            **data.shared_columns,
            **{kind.id: _compute_coupling_columns(entries, kind) for kind in kinds if issubclass(kind, Coupling)},
        },
        payload=_make_payload_columns(data, linear, mechanism),
    )


def _make_payload_columns(data: TorqueWindows, linear: Array, mechanism: LinkedMechanism) -> PayloadColumns | None:
    """Return the columns of known payloads, for their errors' share in the standard errors; None without a payload.

    The ten columns of a `LinkLoad` are the links' columns `linear` (R, P) times the change of the P base parameters by
    each standard parameter. Recordings with the same payload share its columns.
    """
    loads = [w.payload for w in data.windows]
    payloads = list(dict.fromkeys(load for load in loads if load is not None))
    if not payloads:
        return None
    owner = np.array([-1 if load is None else payloads.index(load) for load in loads])[data.recording_of_window]
    columns = [
        linear @ mechanism.link_columns(payload.joint) * (owner == k)[:, None] for k, payload in enumerate(payloads)
    ]
    torque = sum(payload_columns @ payload.standard for payload_columns, payload in zip(columns, payloads, strict=True))
    return PayloadColumns(np.asarray(torque), np.column_stack(columns))


def _compute_coupling_columns(entries: Sequence[Sequence[Windows]], kind: type[Coupling]) -> TermColumns:
    """Compute the columns of a coupling of joints on the rows of all joints, and their rates."""
    parts = [_compute_shared_columns(joints[k], joints, kind()) for k in range(len(entries[0])) for joints in entries]
    linear, rates = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return TermColumns(linear, rates, np.zeros((len(entries[0]), linear.shape[1])))


def _compute_shared_columns(w: Windows, entries: Sequence[Windows], term: Term) -> tuple[Array, Array]:
    """Compute the columns of a coupling on the rows `w` of one joint, and their time derivatives, (R, P) each.

    Its motion is the sum of the joints' motions in `entries`, times their factors; zero for a joint without factor.
    """
    factors = list_loads(term.at)
    if w.at not in factors:
        return (np.zeros((len(w.centers), len(term.columns))),) * 2
    factor_of_joint = np.array([factors.get(windows.at, 0.0) for windows in entries])
    position, velocity, acceleration = (series @ factor_of_joint for series in _stack_motion(entries))
    w = replace(w, samples=replace(w.samples, position=position, velocity=velocity), acceleration=acceleration)
    rates = np.column_stack([w.rates.column(column, w.samples) for column in term.columns])
    return factors[w.at] * WindowColumns([w]).columns([term])[0][0], factors[w.at] * rates


def _stack_motion(entries: Sequence[Windows]) -> tuple[Array, Array, Array]:
    """Stack position, velocity and raw acceleration of all joints, (N, n) each."""
    parts = ((w.samples.position, w.samples.velocity, w.acceleration) for w in entries)
    q, v, a = (np.column_stack(series) for series in zip(*parts, strict=True))
    return q, v, a


@dataclass(frozen=True)
class _LinkColumns:
    """Links' columns of one recording.

    Attributes:
        linear: columns on the rows of each joint (R_k, P).
        rates: their time derivatives (R_k, P).
        masses: derivatives of the mass matrix by each parameter at S samples (S, P, n, n).
    """

    linear: list[Array]
    rates: list[Array]
    masses: Array


def _compute_link_columns(entries: Sequence[Windows], mechanism: LinkedMechanism) -> _LinkColumns:
    """Compute the links' columns from the windows of each joint of one recording."""
    q, v, a = _stack_motion(entries)
    smooth, inertial = mechanism.torque(q, v, np.zeros_like(v)), mechanism.momentum(q, a)  # (N, n, P)

    def average(rows: WindowAverages, k: int) -> Array:
        return np.asarray(rows.wider @ smooth[:, k] + rows.narrow @ inertial[:, k])

    places = q[:: max(1, len(q) // RESOLUTION.places)]
    masses = [mechanism.momentum(places, np.broadcast_to(unit, places.shape)) for unit in np.eye(len(entries))]
    return _LinkColumns(
        [average(w.averages, k) for k, w in enumerate(entries)],
        [average(w.rates, k) for k, w in enumerate(entries)],
        np.transpose(masses, (1, 3, 2, 0)),
    )


def _calibrate_windows(entries: Sequence[Windows], k: int, columns: _LinkColumns) -> Windows:
    """Return the windows of joint k with noise at most the residual of a fit of links and all smooth laws.

    Their acceleration noise is that of the torque sum_j M_kj q_j'' of all joints, divided by M_kk.
    """
    w = entries[k]
    laws = [law for law in smooth_laws(w) if law.id not in ("inertia", "gravity")]
    phi = np.column_stack([columns.linear[k], *(WindowColumns([w]).columns([law])[0][0] for law in laws)])
    theta = solve_least_squares(phi, WindowTorque([w]).net)[: columns.masses.shape[1]]
    mass = np.sqrt(np.mean(np.einsum("p,spj->sj", theta, columns.masses[:, :, k]) ** 2, axis=0))  # |M_kj| (n,)
    noise = float(np.linalg.norm(mass * [windows.noise.acceleration for windows in entries]))
    w = replace(w, noise=replace(w.noise, acceleration=noise / max(float(mass[k]), 1e-300)))
    return limit_noise(w, phi, lambda _: float(mass[k]))
