"""Counts of the encoder that a position controller reads.

A controller that reads whole counts moves a joint at rest until its encoder shows the next count. The joint then rests
at the edge of a count, half a count behind its log. If the simulated controller reads the exact position, the fitted
dry friction is too small. Therefore the simulated controller reads counts, and simulated counts are compared with
logged counts.

The difference of two counts is zero or whole counts: most rows of a good model have no error at all. For scores and
standard errors, the rows have the quantisation noise of one encoder, as they have with an exact position.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.recording import Recording
from robots.servos.in_loop.settings import LOOP
from robots.servos.torque import find_drive, get_bus_voltage


def find_least_change(recordings: Sequence[Recording]) -> float:
    """Return the least change of position between samples [rad], the step of the finest encoder; inf without motion."""
    steps = [np.abs(np.diff(recording.position)) for recording in recordings]
    return min(float(changes[changes > LOOP.encoder.finest].min(initial=np.inf)) for changes in steps)


def find_encoder_step(recordings: Sequence[Recording]) -> float | None:
    """Return the step of the encoder of some recordings [rad]; None if their positions are not on a common grid.

    The grid of each recording begins at its first position.
    """
    step = find_least_change(recordings)
    if not np.isfinite(step):
        return None
    displacement = np.concatenate([recording.position - recording.position[0] for recording in recordings])
    for reach in LOOP.encoder.reaches:
        near = displacement[np.abs(displacement) < (reach + 0.5) * step]
        whole = np.rint(near / step)
        step = float(whole @ near / max(whole @ whole, 1.0)) or step
    is_grid = np.abs(displacement / step - np.rint(displacement / step)).max() < LOOP.encoder.off_grid
    return step if is_grid else None


def make_quantisation_noise(step: float, rows: int) -> Array:
    """Return the noise of an encoder (rows,), uniform within a step of the encoder [rad], the same in every call."""
    return np.asarray(np.random.default_rng(0).uniform(-0.5 * step, 0.5 * step, rows))


def compute_creep_torque(recordings: Sequence[Recording], resolution: float) -> float:
    """Return the standard deviation of the torque by which counts of the encoder help a joint over dry friction.

    A controlled position is read up to half a count off. The torque [unit of the drive] is uniform between 0 and X,
    that of half a count: the standard deviation is X/sqrt(12). Its mean X/2 remains as a bias of dry friction.
    `resolution` is the standard deviation of the quantisation [rad].
    """
    drives = [(find_drive(recording), get_bus_voltage(recording)) for recording in recordings]
    stiffness = [np.mean(drive.scale(bus)) * drive.kp for drive, bus in drives if drive.acts_on_position]
    return 0.5 * float(np.mean(stiffness)) * resolution if stiffness else 0.0
