"""Replay of recordings, row by row, by an online estimator or diagnosis."""

from collections.abc import Iterator, Sequence
from typing import Protocol, TypeVar

import numpy as np

from pendulum_env._typing import Array, Mask
from pendulum_env.recording import Recording

Result = TypeVar("Result", covariant=True)


class OnlineAlgorithm(Protocol[Result]):
    """`OnlineEstimator` or `Diagnoser`: takes samples of B pendulums, or of a linked mechanism, at a rate [Hz]."""

    rate: float
    batch: int

    def reset(self, which: Mask | None = None) -> None:
        """Restart plants (B,) with their next sample; all by default."""

    def take(self, time: Array, position: Array, torque: Array) -> Result:
        """Add a sample with the torque over the period that ends with it."""


def stream_recording(
    algorithm: OnlineAlgorithm[Result], recordings: Recording | Sequence[Recording]
) -> Iterator[Result]:
    """Yield the result of an online algorithm after each row of a recording.

    The torque of a row acts until the next row; the algorithm takes it with the next row.

    Args:
        algorithm: an `OnlineEstimator` or a `Diagnoser`.
        recordings: of one mechanism, or one for each of B pendulums, with the same number of rows.

    Raises:
        ValueError: if the number of recordings, or their rate, is not that of the algorithm, or their lengths differ.

    Examples:
        >>> from estimators.online import OnlineEstimator, stream_recording
        >>> from pendulum_env.backends import record
        >>> from pendulum_env.excitation import excitation
        >>> recording = record(None, excitation("paper", 1), 5.0, rate=500.0, rng=1)
        >>> *_, estimates = stream_recording(OnlineEstimator(recording.rate), recording)
        >>> estimates.theta[0, 0].round(2)
        array([0.09, 2.01, 0.36, 0.92])
    """
    runs = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if len(runs) != algorithm.batch:
        raise ValueError(f"there are {len(runs)} recordings for {algorithm.batch} pendulums: give one for each")
    for run in runs:
        if not 0.9 < run.rate / algorithm.rate < 1.1:
            raise ValueError(f"the recording has {run.rate:.6g} Hz, not {algorithm.rate:g} Hz: pass rate={run.rate:g}")
        if len(run.time) != len(runs[0].time):
            raise ValueError(f"recordings have {len(runs[0].time)} and {len(run.time)} rows: cut them to one length")
    time, position, torque = (
        np.stack([getattr(run, name) for run in runs], axis=1) for name in ("time", "position", "torque")
    )
    held = np.concatenate([np.zeros_like(torque[:1]), torque[:-1]])
    return map(algorithm.take, time, position, held)
