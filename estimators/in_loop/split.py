"""Split of recordings of servos into fitted and held-out rollouts."""

from collections.abc import Sequence

from estimators.data.split import HELD_OUT
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.in_loop.rollouts import Rollouts
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import cut_all, prepare
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env.recording import Recording


def choose_parts(holdout: Sequence[Recording]) -> tuple[Part, Part]:
    """Return the parts of recordings to fit and to hold out: without held-out recordings, the end of each."""
    return (WHOLE, WHOLE) if holdout else ((0.0, 1 - HELD_OUT), (1 - HELD_OUT, 1.0))


def split_rollouts(recordings: Sequence[Recording], holdout: Sequence[Recording]) -> tuple[RolloutRows, RolloutRows]:
    """Return the rows of fitted and of held-out rollouts.

    Without held-out recordings, the ends of the fitted ones are held out. The held-out rows use parameters of the
    fitted rows.

    Raises:
        IdentificationError: if there is too little motion.
    """
    fit, test = choose_parts(holdout)
    held_out = tuple(holdout or recordings)
    windows = TorqueRows(prepare(recordings, part=fit))
    train = RolloutRows(Rollouts(tuple(recordings), shares=fit), windows)
    return train, RolloutRows(Rollouts(held_out, shares=test), TorqueRows(cut_all(held_out, part=test)), guide=train)
