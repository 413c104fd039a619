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
    """Return the rows of fitted and of held-out rollouts; raises IdentificationError if there is too little motion."""
    first, last = choose_parts(holdout)
    unseen = tuple(holdout or recordings)
    windows = TorqueRows(prepare(recordings, part=first))
    train = RolloutRows(Rollouts(tuple(recordings), shares=first), windows)
    return train, RolloutRows(Rollouts(unseen, shares=last), TorqueRows(cut_all(unseen, part=last)), guide=train)
