"""Findings on the drive of a servo: the rate of its speed, and the scale of its torque."""

from collections.abc import Sequence

import numpy as np

from estimators.findings import Finding, Kind, Quantity
from estimators.in_loop.fit import LOOP
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from pendulum_env.servo.torque import compute_asked_torque


def find_speed_rate(model: Model, recordings: Sequence[Recording]) -> Finding | None:
    """Return a finding where a controller may see the speed so late that this passes for inertia."""
    drives = [own.drive for own in recordings if own.drive is not None and own.drive.rate is None]
    gains = [(drive.kp if drive.acts_on_speed else drive.kd) * (drive.gain or 1.0) for drive in drives]
    off = max(gains, default=0.0) / (2 * LOOP.seldom)
    if off <= model.estimates["inertia"].std:
        return None
    inertia = Quantity(off, unit=model.estimates["inertia"].unit)
    return Finding(Kind.SPEED_RATE_UNKNOWN, {"rate": Quantity(LOOP.seldom, unit="Hz"), "inertia": inertia})


def find_torque_scale(recordings: Sequence[Recording]) -> Finding | None:
    """Return a finding where the logged torque is not the torque that the drive asks for, but a multiple of it."""
    told = [own for own in recordings if own.has_logged_torque and own.drive and own.torque_unit == own.drive.unit]
    if not told:
        return None
    logged, asked = (
        np.concatenate(every) for every in zip(*((own.torque, compute_asked_torque(own)) for own in told), strict=True)
    )
    share = float(logged @ asked / max(asked @ asked, np.finfo(float).tiny))
    if abs(share - 1.0) < LOOP.scale:
        return None
    return Finding(Kind.TORQUE_SCALED, {"factor": Quantity(share)})
