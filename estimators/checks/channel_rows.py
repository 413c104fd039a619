"""Equations of the torque channel: windows of recordings, and columns that approximate any law of the joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.checks.alignment import CHANNEL
from estimators.data.rows import BLOCK
from estimators.regression.balance import place_columns
from estimators.selection.score import Blocks
from estimators.signals.motion import get_load_in_newton_metres
from estimators.weak_form.links import prepare_arm
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import TorqueWindows, prepare_windows, smooth_laws
from pendulum_env._typing import Array, Index
from pendulum_env.arms.joints import arm_base, find_body
from pendulum_env.physics import LOAD, Column, Term
from pendulum_env.physics.friction import Stribeck
from pendulum_env.physics.potential import Cogging
from pendulum_env.recording import NEWTON_METRE, Recording

# share of samples driven by the motor, or braked by the load, above which gear losses and the torque constant cannot be
# distinguished; a choice: only the other samples distinguish both
MAX_DRIVEN_SHARE = 0.9
# friction proportional to the weight of the joint, and to the known loads [per N m]
OWN_FRICTION = Column("own", "1", dry=lambda x: np.abs(np.sin(x.position)))
LOAD_FRICTION = Column("hung", "1", dry=lambda x: np.abs(x.load.gravity * np.sin(x.position) - x.load.torque))
# friction proportional to the motor torque, and its derivative by that torque
MOTOR_FRICTION = Column("motor", "1", dry=lambda x: np.abs(x.torque), of_torque=True)
FRICTION_SLOPE = Column("sense", "1", dry=lambda x: np.sign(x.torque), of_torque=True)


@dataclass(frozen=True, eq=False)
class ChannelRows:
    """Equations of the torque channel.

    Attributes:
        data: windows with their known loads; N equations.
        rows: indices of the equations used (R,).
        phi: columns (R, P), weighted; the first is that of the known loads if a current is logged.
        where: stretch of each used equation, for cross-validation.
        carried: torque of the known loads (N,) [N m]; 0 if a current is logged.
        clusters: cluster of time of each used equation (R,), and of four or more recordings its recording (R,). Errors
            may be correlated within a cluster.
    """

    data: TorqueWindows
    rows: Index
    phi: Array
    where: Blocks
    carried: Array
    clusters: tuple[Index, ...]


def make_channel_rows(recordings: Sequence[Recording], terms: Sequence[Term]) -> ChannelRows | None:
    """Make the equations of recordings; None if too few are far enough from the ends of segments.

    Columns are the known load if a current is logged, friction under loads, and smooth laws of each joint. Those of the
    effects in `terms` follow, except torque-dependent effects.

    Raises:
        IdentificationError: if too little of the motion is clear of stick.
    """
    is_arm = not find_body(terms).can_simulate
    data = _make_arm_windows(recordings, terms) if is_arm else _make_pendulum_windows(recordings)
    rows = _find_clear_windows(data)
    joints = [(data.locate_rows(at), data.part(at)) for at in data.joints]
    laws = [(place, joint.columns([law])[0][0]) for place, joint in joints for law in _smooth_laws(joint)]
    of_torque = list_torque_dependent(terms)
    known = [term for term in terms if not term.fixed and term not in of_torque]
    column_parts = [*laws, *((data.locate_rows(term.at), data.columns([term])[0][0]) for term in known)]
    load, *friction = (data.averages.column(c, data.averages.samples) for c in (LOAD, OWN_FRICTION, LOAD_FRICTION))
    load_torque, gain = (load, []) if recordings[0].torque_unit == NEWTON_METRE else (0.0 * load, [load])
    has_several = len({r.load for r in recordings}) > 1
    has_several |= any(r.has_varying_load for r in recordings) and not is_brake(data)
    friction_columns = [] if is_arm else friction if has_several else friction[:1]
    phi = np.column_stack([*gain, *friction_columns, place_columns(len(load), column_parts)])
    if len(rows) < CHANNEL.min_equations * phi.shape[1]:
        return None
    block, _, of_block = data.blocks(BLOCK)
    _, begin, stretch = np.unique(block[rows], return_index=True, return_inverse=True)
    recording = of_block[block[rows]]
    where = Blocks(stretch, recording, recording[begin], stretch)
    is_several = len(np.unique(recording)) >= CHANNEL.min_recordings
    cluster_sets = [data.clusters[rows], *([recording] if is_several else [])]
    numbered = tuple(np.unique(labels, return_inverse=True)[1] for labels in cluster_sets)
    return ChannelRows(data, rows, phi[rows] * data.weights[rows, None], where, load_torque, numbered)


def make_angle_columns(data: TorqueWindows, count: int) -> Array:
    """Make columns (N, 2 K) of cogging of the orders 1 to K, the smaller of `count` and `CHANNEL.orders`."""
    orders = range(1, min(count, CHANNEL.orders) + 1)
    return np.column_stack([data.columns([Cogging(float(order))])[0][0] for order in orders])


def list_torque_dependent(terms: Sequence[Term]) -> list[Term]:
    """List the terms with columns that depend on the torque; terms with fixed columns (a lag) are left out."""
    return [term for term in terms if not term.fixed and any(column.of_torque for column in term.columns)]


def is_brake(data: TorqueWindows) -> bool:
    """Return whether the load torque opposes the motion in more than `MAX_DRIVEN_SHARE` of the samples."""
    return compute_driven_share(data, -np.asarray(data.samples.load.torque)) > MAX_DRIVEN_SHARE


def compute_driven_share(data: TorqueWindows, torque: Array) -> float:
    """Compute the share of samples in which a torque (N,) or () has the direction of the motion."""
    return float(np.mean(torque * data.samples.velocity > 0))


def _make_pendulum_windows(recordings: Sequence[Recording]) -> TorqueWindows:
    """Prepare the windows of a pendulum with known loads."""
    data = prepare_windows(recordings)
    hung = zip(data.windows, map(get_load_in_newton_metres, recordings), strict=True)
    return replace(data, windows=tuple(replace(w, samples=replace(w.samples, load=load)) for w, load in hung))


def _make_arm_windows(recordings: Sequence[Recording], terms: Sequence[Term]) -> TorqueWindows:
    """Prepare the windows of all joints of an arm, weighted by the residual of links and friction."""
    data = prepare_arm(recordings, terms[:1])
    return replace(data, weights=TorqueRows(data).weights(arm_base(find_body(terms))))


def _smooth_laws(data: TorqueWindows) -> tuple[Term, ...]:
    """Make terms that approximate nearly any law of one joint."""
    fast = float(np.percentile(np.abs(data.samples.velocity), 95))
    return (*smooth_laws(data.windows[0]), *(Stribeck(share * fast) for share in CHANNEL.stribeck_shares))


def _find_clear_windows(data: TorqueWindows) -> Index:
    """Find the windows (R,) that stay inside their segment under every delay up to `CHANNEL.reach`."""
    masks = []
    for w in data.windows:
        margin = len(w.kernel) // 2 + int(np.ceil(CHANNEL.reach * w.recording.rate)) + 2
        bounds = np.array([*w.recording.starts, len(w.recording)])
        segment = np.searchsorted(bounds, w.centers, side="right")
        masks.append((w.centers >= bounds[segment - 1] + margin) & (w.centers < bounds[segment] - margin))
    return np.flatnonzero(np.concatenate(masks))
