"""Case of servos: effects are found by simulating each servo with its controller in the loop.

Friction at rest, sticking and breaking away show in the distance between a servo and its goal. A regression of torque
on motion omits rest, and torque of a controller is a function of the position itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from estimators.data.fit_data import FitData
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.setting import Setting
from estimators.findings import Finding, Kind
from estimators.in_loop.back_emf import include_back_emf, present, setting_with_back_emf
from estimators.in_loop.conclusion import conclude, find_regions
from estimators.in_loop.fit import LOOP
from estimators.in_loop.goals import change_reading, make_base, read_goals, with_goals
from estimators.in_loop.refit import refine, refine_rows, refit
from estimators.in_loop.rollouts import are_driven
from estimators.in_loop.split import choose_parts, split_rollouts
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.search import search
from pendulum_env.physics import Term
from pendulum_env.recording import Recording


def prepare(recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> tuple[FitData, Setting]:
    """Calibrate the recordings; leave out effects of a sensor, which simulations from goals do not show.

    An effect has to explain at least `LOOP.needed` of the residual.
    """
    data = FitData.from_recordings(recordings, holdout, setting.base)
    base = make_base(data.recordings, setting.base)
    library = {id: kind for id, kind in setting.library.items() if kind.kind != "sensor"}
    share = max(setting.criterion.explained_share, LOOP.needed)
    criterion = replace(setting.criterion, explained_share=share, needed_share=share)
    data = with_goal_reading(data, base)
    return data, replace(setting, base=base, library=library, criterion=criterion)


def with_goal_reading(data: FitData, base: Sequence[Term]) -> FitData:
    """Return the data with goals that are held or run on between rows, decided once, by the base model."""
    reading = read_goals(data.recordings, base, choose_parts(data.holdout)[0])
    if reading is None and all(r.drive is None or r.drive.goal for r in data.holdout):
        return data
    if reading is not None and any(r.drive is not None and r.drive.goal for r in data.holdout):
        undeclared = [r.name for r in data.recordings if r.drive is None or not r.drive.goal]
        reading = replace(reading, recordings=tuple(undeclared))  # a reading of some recordings is not reversed
    is_held = reading is None or reading.kind is Kind.GOALS_HELD
    data = replace(data, recordings=with_goals(data.recordings, is_held), holdout=with_goals(data.holdout, is_held))
    return data if reading is None else data.with_treatment(reading)


def reread_goals(trial: Trial) -> FitData | None:
    """Read the goals the other way if the base model leaves the reading open: the effects of a model may decide it."""
    data, unseen = trial.data, refine_rows(trial.evaluator)[1]
    readings = [treatment for treatment in data.treatments if treatment.kind in (Kind.GOALS_HELD, Kind.GOALS_RUN_ON)]
    error = trial.found.steps[-1].errors["holdout"].total
    if len(readings) != 1 or error < LOOP.faithful * unseen.rollouts.encoder[""]:
        return None
    fitted, held_out = (change_reading(part, readings[0]) for part in (data.recordings, data.holdout))
    if fitted is None or held_out is None:
        return None
    other = Kind.GOALS_RUN_ON if readings[0].kind is Kind.GOALS_HELD else Kind.GOALS_HELD
    return replace(data, recordings=fitted, holdout=held_out).with_treatment(Finding(other))


def make_evaluator(data: FitData, setting: Setting) -> ModelEvaluator:
    """Make the evaluator of models on rollouts.

    Raises:
        IdentificationError: if the recordings hold too little motion to begin with.
    """
    train, check = split_rollouts(data.recordings, data.holdout)
    return setting_with_back_emf(data, setting).evaluator((train.data, check.data))


SERVO = Case(
    takes=lambda base, recordings: are_driven(recordings),
    prepare=prepare,
    evaluator=make_evaluator,
    search=search,
    refit=refit,
    refine=refine,
    unexplained=find_regions,
    present=present,
    conclude=conclude,
    reveal=lambda data, base, kind: include_back_emf(data, (*base, kind())) or data,
    treatments=(lambda trial: include_back_emf(trial.data, trial.final.terms), reread_goals),
    is_timed=False,
)
