"""Split of recordings into what is fitted and what is held out, as windows and segments."""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.regression.equations import IdentificationError
from estimators.selection.criterion import Criterion
from estimators.weak_form.torque_windows import choose_half_width, prepare
from pendulum_env.recording import Recording

HELD_OUT = 0.3  # end of each recording that is held out when no recording is
MOTION = 0.5  # of the motion, that has to come before what is held out of the end of recordings
SHORTEST = 0.25  # share of the windows' length, the least, where longer windows are too few

Parts = tuple[RegressionData, RegressionData]  # fitted and held out


def parted(
    recordings: Sequence[Recording], holdout: Sequence[Recording] = ()
) -> tuple[list[Recording], list[Recording]]:
    """What is fitted of an arm and what is held out: the last 30 % of each recording, where no others are."""
    if holdout:
        return list(recordings), list(holdout)
    pairs = [recording.split(1 - HELD_OUT) for recording in recordings]
    return [first for first, _ in pairs], [last for _, last in pairs]


def gather(recordings: Sequence[Recording], holdout: Sequence[Recording] = (), shorter: float = 1.0) -> Parts:
    """Training and held-out data, prepared; without held-out recordings, the end of each recording is held out.

    Args:
        recordings: to fit.
        holdout: to check on.
        shorter: factor on the lengths of the windows, which are shorter still where they would be too few.

    Raises:
        IdentificationError: if a part holds too little motion, or torque is never applied.
    """
    if not any(recording.has_torque or recording.known_inertia for recording in recordings):
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: torque is never applied, so that only ratios of parameters are known: take `FitData.of`"
        )
    try:
        return _gather(recordings, holdout, shorter)
    except IdentificationError:
        if shorter <= SHORTEST:
            raise
        return gather(recordings, holdout, Criterion.shorter_window * shorter)  # more windows, each with more noise


def _gather(recordings: Sequence[Recording], holdout: Sequence[Recording], shorter: float) -> Parts:
    widths, checks = ([shorter * choose_half_width(r) for r in part] for part in (recordings, holdout))
    if holdout:
        return RegressionData.of(recordings, widths), RegressionData.of(holdout, checks)

    def split(share: float) -> Parts:
        return RegressionData.of(recordings, widths, (0.0, share)), RegressionData.of(recordings, widths, (share, 1.0))

    motion = np.concatenate([w.centers / len(w.recording) for w in prepare(recordings, widths).windows])
    if np.mean(motion < 1 - HELD_OUT) >= MOTION:
        with suppress(IdentificationError):  # the end may be at rest
            return split(1 - HELD_OUT)
    return split(float(np.quantile(motion, 1 - HELD_OUT)))  # of the motion, not of the time
