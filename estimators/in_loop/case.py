"""Case of servos: effects are found by simulating each servo with its controller in the loop.

Friction at rest, sticking and breaking away show in the distance between a servo and its goal. A regression of torque
on motion omits rest, and torque of a controller is a function of the position itself.
"""

from collections.abc import Sequence
from dataclasses import replace

from estimators.data.fit_data import FitData
from estimators.diagnosis.case import Case
from estimators.diagnosis.setting import Setting
from estimators.in_loop.back_emf import add_back_emf, include_back_emf, present
from estimators.in_loop.conclusion import conclude, find_loop_regions
from estimators.in_loop.fit import LOOP
from estimators.in_loop.goal_reading import reread_goals
from estimators.in_loop.refit import refine, refit
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.in_loop.rollouts import Rollouts
from estimators.in_loop.servos import are_driven, choose_parts, make_base
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.search import search
from estimators.weak_form.preparation import prepare_windows
from estimators.weak_form.torque_rows import TorqueRows
from pendulum_env.recording import Recording


def prepare(recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> tuple[FitData, Setting]:
    """Calibrate the recordings; leave out effects of a sensor, which simulations from goals do not show.

    An effect must explain at least the share `LOOP.needed` of the residual.
    """
    data = FitData.from_recordings(recordings, holdout, setting.base)
    base = make_base(data.recordings, setting.base)
    library = {id: kind for id, kind in setting.library.items() if kind.kind != "sensor"}
    share = max(setting.criterion.explained_share, LOOP.needed)
    criterion = replace(setting.criterion, explained_share=share, needed_share=share)
    data = data.decide_conventions(setting.base)
    return data, replace(setting, base=base, library=library, criterion=criterion)


def make_evaluator(data: FitData, setting: Setting) -> ModelEvaluator:
    """Make the evaluator of models on rollouts; parameters of the fitted rows predict the held-out ones.

    Raises:
        IdentificationError: if the recordings have too little motion.
    """
    recordings, held_out = data.recordings, data.holdout or data.recordings
    train_part, check_part = choose_parts(data.holdout)
    train = RolloutRows(
        Rollouts(recordings, shares=train_part), TorqueRows(prepare_windows(recordings, part=train_part))
    )
    windows = TorqueRows(prepare_windows(held_out, part=check_part, fewest=0))
    check = RolloutRows(Rollouts(held_out, shares=check_part), windows, guide=train)
    return add_back_emf(data, setting).evaluator((train.data, check.data))


SERVO = Case(
    accepts=lambda base, recordings: are_driven(recordings),
    prepare=prepare,
    evaluator=make_evaluator,
    search=search,
    refit=refit,
    refine=refine,
    unexplained=find_loop_regions,
    present=lambda trial, step, _: present(trial, step),
    conclude=conclude,
    show_effect=lambda data, base, kind: include_back_emf(data, (*base, kind())) or data,
    treatments=(lambda trial: include_back_emf(trial.data, trial.final.terms), reread_goals),
    is_timed=False,
)
