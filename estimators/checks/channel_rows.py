"""Rows of the torque channel: windows of recordings, and columns that approximate nearly any law of the joint."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.checks.alignment import CHANNEL
from estimators.regression.balance import place_columns
from estimators.signals.channel import REACH
from estimators.weak_form.columns import is_torque_dependent
from estimators.weak_form.links import prepare_arm
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import TorqueWindows, prepare_windows, smooth_laws
from pendulum_env._typing import Array
from pendulum_env.arms.joints import arm_base, find_body
from pendulum_env.physics import Column, Term
from pendulum_env.physics.friction import Stribeck
from pendulum_env.physics.potential import Cogging
from pendulum_env.recording import Recording

LawsOfRows = Sequence[tuple[slice, Column]]  # columns that depend on the torque, with their rows
# share of samples driven by the motor, or braked by the load, above which gear losses and the torque constant cannot be
# distinguished; a choice: only the other samples distinguish both
MAX_DRIVEN_SHARE = 0.9
# friction proportional to the weight of the joint, and to the known loads [per N m]
OWN_FRICTION = Column("own", "1", dry=lambda x: np.abs(np.sin(x.position)))
LOAD_FRICTION = Column("hung", "1", dry=lambda x: np.abs(x.load.gravity * np.sin(x.position) - x.load.torque))
# friction by the torque of the motor, |tau| sgn q', and errors of its gain, tau^2 and tau^3, on all rows
MOTOR_FRICTION = (slice(None), Column("motor", "1", dry=lambda x: np.abs(x.torque)))
FRICTION_SLOPE = Column("slope", "1", dry=lambda x: np.sign(x.torque))  # its derivative by that torque
NONLINEAR_GAIN: LawsOfRows = [
    MOTOR_FRICTION,
    (slice(None), Column("square", "1", force=lambda x: x.torque**2)),
    (slice(None), Column("cube", "1", force=lambda x: x.torque**3)),
]
ANGLE_LAWS = [Cogging(float(order)) for order in range(1, 49)]  # waves of the angle


def make_channel_rows(recordings: Sequence[Recording], terms: Sequence[Term]) -> tuple[TorqueRows, Array, LawsOfRows]:
    """Make the rows of recordings, clear of the ends of segments under every delay up to `REACH`.

    Args:
        recordings: with known torque.
        terms: effects of the joint; for an arm all terms of the model, the links first. Fixed columns are left out.

    Returns:
        Rows, columns of motion alone (R, P), and columns of `terms` that depend on the torque.

    Raises:
        IdentificationError: if too little of the motion is clear of stick.
    """
    body, margin = find_body(terms), REACH + 2.0 / min(recording.rate for recording in recordings)
    if body.can_simulate:
        data = prepare_windows(recordings, margin=margin)
    else:
        data = prepare_arm(recordings, terms[:1], margin)
        data = replace(data, weights=TorqueRows(data).weights(arm_base(body)))
    joints = [(data.locate_rows(at), data.part(at)) for at in data.joints]
    parts = [(rows, part.columns([law])[0][0]) for rows, part in joints for law in _make_smooth_laws(part)]
    of_torque = list[tuple[slice, Column]]()
    for term in (term for term in terms if not term.fixed):
        rows = data.locate_rows(term.at)
        if is_torque_dependent(term):
            of_torque += [(rows, column) for column in term.columns]
        else:
            parts.append((rows, data.columns([term])[0][0]))
    for friction in (OWN_FRICTION, *list_load_friction(data)) if body.can_simulate else ():
        parts.append((slice(None), data.averages.column(friction, data.averages.samples)[:, None]))
    return TorqueRows(data), place_columns(len(data.weights), parts), of_torque


def list_load_friction(data: TorqueWindows) -> list[Column]:
    """List friction under the known loads, if these differ; the torque of a brake resembles friction itself."""
    recordings = [w.recording for w in data.windows]
    has_several = len({recording.load for recording in recordings}) > 1
    has_several |= any(recording.has_varying_load for recording in recordings) and not is_brake(data)
    return [LOAD_FRICTION] if has_several and any(w.samples.load for w in data.windows) else []


def is_brake(data: TorqueWindows) -> bool:
    """Return whether the load torque opposes the motion in more than `MAX_DRIVEN_SHARE` of the samples."""
    return compute_driven_share(data, -np.asarray(data.samples.load.torque)) > MAX_DRIVEN_SHARE


def compute_driven_share(data: TorqueWindows, torque: Array) -> float:
    """Compute the share of samples in which a torque (N,) or () has the direction of the motion."""
    return float(np.mean(torque * data.samples.velocity > 0))


def _make_smooth_laws(data: TorqueWindows) -> tuple[Term, ...]:
    """Make terms that approximate nearly any law of one joint."""
    fast = float(np.percentile(np.abs(data.samples.velocity), 95))
    return (*smooth_laws(data.windows[0]), *(Stribeck(share * fast) for share in CHANNEL.stribeck_shares))
