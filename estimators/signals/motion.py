"""Direction of motion, temperature and known load of a recording."""

from __future__ import annotations

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import KnownLoad
from pendulum_env.physics.term import ROOM, UNLOADED
from pendulum_env.recording import NEWTON_METRE, Recording

HALF_WIDTHS = (0.008, 0.01, 0.012, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06, 0.08)  # candidates of windows [s]
LONG_HALF_WIDTHS = (0.11, 0.16, 0.22, 0.32)  # of slow motion whose inertia a coarse encoder biases in shorter ones [s]
LEAD_IN = 0.3  # [s] at the start, where effects with memory depend on their unrecorded initial state
SLOWEST = 0.02  # [rad/s], least speed with a known sign; at least five times the noise of the velocity
SLOW, FAST = 0.02, 95  # share of the fast speed, this percentile, to which a slow or linear joint lowers it


def compute_fast_speed(velocity: Array) -> float:
    """Return the fast speed along a velocity (N,), without outliers [rad/s or m/s]."""
    return float(np.percentile(np.abs(velocity), FAST))


def find_slowest(velocity: Array) -> float:
    """Return the least speed with a known sign along a velocity (N,), apart from noise [rad/s or m/s]."""
    return min(SLOWEST, SLOW * compute_fast_speed(velocity))


def get_temperature(recording: Recording) -> Array:
    """Return the temperature along a recording (N,) [deg C]; room temperature without a measurement.

    A thermometer that shows steps is interpolated. Each step has the mean of its two values. Both ends and the middle
    of each extreme have the shown value.
    """
    if recording.temperature is None:
        return np.full(len(recording), ROOM)
    time, steps = recording.time, np.flatnonzero(np.diff(recording.temperature, prepend=np.nan) != 0)
    values_shown, middles = (
        recording.temperature[steps],
        0.5 * (time[steps] + time[np.append(steps[1:], len(time)) - 1]),
    )
    peaks = 1 + np.flatnonzero(np.diff(values_shown)[:-1] * np.diff(values_shown)[1:] < 0)
    changes = 0.5 * (time[steps[1:] - 1] + time[steps[1:]])
    instants = np.concatenate([time[[0, -1]], changes, middles[peaks]])
    values = np.concatenate([values_shown[[0, -1]], 0.5 * (values_shown[1:] + values_shown[:-1]), values_shown[peaks]])
    order = np.argsort(instants)
    return np.interp(time, instants[order], values[order])


def get_known_load(recording: Recording) -> KnownLoad:
    """Return the known load of a recording; no load if the torque is not in N m."""
    return UNLOADED if recording.torque_unit != NEWTON_METRE else get_load_in_newton_metres(recording)


def get_load_in_newton_metres(recording: Recording) -> KnownLoad:
    """Return the known load of a recording [kg m^2, N m], for any unit of its torque."""
    measured = 0.0 if recording.load_torque is None else recording.load_torque
    if recording.load is None:
        return KnownLoad(torque=measured)
    return KnownLoad(recording.load.inertia, recording.load.gravity, measured)
