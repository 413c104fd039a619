"""Reading of goals as a treatment of the data: held from row to row, or run on between rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimators.data.fit_data import FitData
from estimators.diagnosis.case import Trial
from estimators.findings import Finding, Kind
from estimators.in_loop.convention_fits import TIE
from estimators.in_loop.fit import LOOP
from estimators.in_loop.refit import refine_rows
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.moves import SearchState, drop_effect
from estimators.weak_form.point import Point
from pendulum_env.servo.drive import Goal
from pendulum_env.servo.torque import replace_drive


def reread_goals(trial: Trial) -> FitData | None:
    """Read the goals the other way if the base model leaves the reading open, but the found model does not.

    The found model is refitted under the other reading. The goals are read the other way if it then predicts held-out
    motion better, or does not need one of its effects.
    """
    data, unseen = trial.data, refine_rows(trial.evaluator)[1]
    readings = [treatment for treatment in data.treatments if treatment.kind in (Kind.GOALS_HELD, Kind.GOALS_RUN_ON)]
    error = trial.result.steps[-1].errors["holdout"].total
    if len(readings) != 1 or error < LOOP.faithful * unseen.rollouts.encoder[""]:
        return None
    gain = readings[0].numbers.get("gain")
    if gain is None or abs(gain.value) > TIE * (gain.std or 0.0):
        return None
    goal: Goal = "ramp" if readings[0].kind is Kind.GOALS_HELD else "held"
    fitted, held_out = (
        tuple(replace_drive(r, replace(r.drive, goal=goal)) for r in part if r.drive is not None)
        for part in (data.recordings, data.holdout)
    )
    finding = Finding(Kind.GOALS_HELD if goal == "held" else Kind.GOALS_RUN_ON)
    data = data.with_treatment(finding, recordings=fitted, holdout=held_out)
    state = refit_state(trial, trial.case.evaluator(data, trial.setting))
    is_likelier = state.evaluator.fit(state.terms).errors["holdout"].total < error
    return data if is_likelier or drop_effect(state) is not None else None


def refit_state(trial: Trial, evaluator: ModelEvaluator) -> SearchState:
    """Return the state of a search that reached the model of a trial, refitted from its parameters to other data."""
    first, last = trial.result.steps[0].model, trial.result.steps[-1].model
    start = Point.from_parameters(last.terms, np.asarray(last.theta))
    rows = evaluator.train.rollouts
    assert isinstance(rows, RolloutRows)
    rows.set_start(start)
    return SearchState(evaluator, first.terms, start.terms).refit(start.terms)
