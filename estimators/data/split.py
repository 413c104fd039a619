"""Split of recordings into fitted and held-out data, as windows and segments."""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.regression.equations import IdentificationError
from estimators.selection.criterion import Criterion
from estimators.weak_form.torque_windows import choose_half_width, prepare
from pendulum_env.recording import Recording

HELD_OUT = 0.3  # share of each recording, at its end, that is held out if no recording is
MOTION = 0.5  # least share of the motion that is fitted, if the end of each recording is held out
SHORTEST = 0.25  # least factor on the lengths of windows, if longer windows are too few

Parts = tuple[RegressionData, RegressionData]  # fitted and held out


def split_arm(
    recordings: Sequence[Recording], holdout: Sequence[Recording] = ()
) -> tuple[list[Recording], list[Recording]]:
    """Return fitted and held-out recordings of an arm: by default the last 30 % of each recording is held out."""
    if holdout:
        return list(recordings), list(holdout)
    pairs = [recording.split(1 - HELD_OUT) for recording in recordings]
    return [first for first, _ in pairs], [last for _, last in pairs]


def gather(recordings: Sequence[Recording], holdout: Sequence[Recording] = (), shorter: float = 1.0) -> Parts:
    """Prepare fitted and held-out data; without held-out recordings, the end of each recording is held out.

    Args:
        recordings: to fit.
        holdout: to check on.
        shorter: factor on the lengths of the windows; it is reduced further if they are too few.

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
