"""Detection of feedback from motion to torque.

A controller reacts to sensor errors and disturbances immediately. The innovations of torque and position are then
correlated. Those of a planned torque are not.

In a closed loop, a fit of recorded torque is consistent only if its residual is noise (Forssell and Ljung, Automatica
35(7), 1999). The controller reacts to each unmodelled torque, and a delay or a lag fits its reaction.

Motion of one frequency determines neither delay nor lag: inertia and viscous friction have the same effect on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from estimators.checks.settings import CHECKS
from estimators.decisions.criterion import Criterion, TimingLimits
from estimators.findings import Finding, Quantity
from estimators.memoize import memoized
from estimators.regression.least_squares import Equations, solve, solve_least_squares
from estimators.weak_form.floors import compute_precision
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import Array
from pendulum_env.recording import Recording
from pendulum_env.tone import ONE_FREQUENCY, find_tone

FEEDBACK = CHECKS.feedback


@dataclass(frozen=True)
class Feedback(Finding):
    """Torque that reacts to the motion, with its median `gain` between samples."""

    gain: Quantity
    recordings: tuple[str, ...]


def find_feedback(recordings: Sequence[Recording], criterion: Criterion = Criterion()) -> list[Feedback]:
    """Find recordings in which torque reacts to unpredicted changes of position within a few samples.

    A finding has the median gain of the recordings with one unit. Several joints are not tested.
    """
    gains: dict[str, dict[str, float]] = {}
    for recording in (recording for recording in recordings if recording.position.ndim == 1):
        gains_by_stride = (_estimate_feedback_gain(recording, stride, criterion.timing) for stride in FEEDBACK.strides)
        if (gain := next((gain for gain in gains_by_stride if gain is not None), None)) is not None:
            gains.setdefault(recording.units.unit("N m/rad"), {})[recording.name] = gain
    return [
        Feedback(Quantity(float(np.median([*by_name.values()])), unit=unit), tuple(by_name))
        for unit, by_name in gains.items()
    ]


def have_one_frequency(recordings: Sequence[Recording], criterion: Criterion = Criterion()) -> bool:
    """Return whether all recordings have the same single frequency; False for several joints."""
    if any(recording.position.ndim > 1 for recording in recordings):
        return False
    longest = [max(recording.segments, key=len) for recording in recordings]
    tones = [find_tone(segment.position, 1.0 / segment.rate) for segment in longest]
    frequencies = [frequency for frequency, _ in tones]
    is_pure = min(share for _, share in tones) > ONE_FREQUENCY
    return is_pure and max(frequencies) < criterion.timing.same_ratio * min(frequencies)


def is_consistent(
    recordings: Sequence[Recording],
    data: TorqueWindows,
    residual: Array,
    untimed: Array,
    parameters: int,
    criterion: Criterion = Criterion(),
) -> bool:
    """Return whether a fit of the torque's timing is consistent.

    The motion must have more than one frequency. A law that the model lacks may look like a small delay. Therefore, the
    RMS residual must be at most `misfit_ratio` noise floors, or the timing must explain the share `explained_share`
    of the residual without it. If torque reacts to the motion, only noise is consistent.

    Args:
        recordings: recordings of the fit; those of several joints are only tested for their frequencies.
        data: their windows.
        residual: weighted residual of the fit (R,) [N m].
        untimed: the same without a correction of the time (R,) [N m].
        parameters: number of fitted parameters.
        criterion: limits of the decision.
    """
    if have_one_frequency(recordings, criterion):
        return False
    if data.joints != ("",):
        return True
    size, untimed_size = float(np.linalg.norm(residual)), float(np.linalg.norm(untimed))
    is_explained = size**2 <= (1 - criterion.explained_share) * untimed_size**2
    if is_explained and not find_feedback(recordings, criterion):
        return True
    inertia = data.base_inertia
    least = min(w.noise.compute_std(inertia) for w in data.windows)  # weights are relative to the least
    floor = max(compute_precision(data.windows), least)
    freedom = max(1, len(residual) - parameters)
    return bool(size <= criterion.misfit_ratio * floor * freedom**0.5)


@memoized
def _estimate_feedback_gain(recording: Recording, stride: int, timing: TimingLimits) -> float | None:
    """Estimate the slope of torque innovations over position innovations of every `stride`-th sample [N m/rad].

    None if the slope is not significantly negative, or the recording is too short. An error of a time stamp changes
    torque and position by their rates. The covariance of the innovations must be significantly negative without its
    part in proportion to the product of the predicted changes.
    """
    pieces = [slice(part.start, part.stop, stride) for part in recording.segment_slices]
    pieces = [piece for piece in pieces if piece.stop - piece.start > 2 * FEEDBACK.past * stride]
    if sum((piece.stop - piece.start) // stride - FEEDBACK.past for piece in pieces) < 20 * FEEDBACK.parts:
        return None
    position, torque = (
        np.concatenate([sliding_window_view(series[piece] - series.mean(), FEEDBACK.past + 1) for piece in pieces])
        for series in (recording.position, recording.torque)
    )  # (R, FEEDBACK.past + 1) each: past and present
    past = np.column_stack([position[:, :-1], torque[:, :-1], np.ones(len(torque))])
    predicted = [past @ solve_least_squares(past, series[:, -1]) for series in (position, torque)]
    innovation, answer = position[:, -1] - predicted[0], torque[:, -1] - predicted[1]
    changes = (predicted[0] - position[:, -2]) * (predicted[1] - torque[:, -2])
    limits = [FEEDBACK.outlier_limit * 1.4826 * float(np.median(np.abs(series))) for series in (innovation, answer)]
    calm = (np.abs(innovation) < limits[0]) & (np.abs(answer) < limits[1])
    innovation, answer, changes = innovation[calm], answer[calm], changes[calm]
    if len(innovation) < FEEDBACK.parts or not (innovation.any() and answer.any()):
        return None
    parts = np.arange(len(innovation)) * FEEDBACK.parts // len(innovation)
    weights = np.ones(len(answer))
    slope = solve(Equations(innovation[:, None], answer), weights, parts)
    covariance = solve(Equations(np.column_stack([weights, changes]), innovation * answer), weights, parts)
    if any(fit.theta[0] >= -timing.z_score * fit.std[0] for fit in (slope, covariance)):
        return None
    return gain if (gain := float(slope.theta[0])) < -timing.correlation * answer.std() / innovation.std() else None
