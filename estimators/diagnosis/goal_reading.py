"""Reading of goals as a treatment of the data: held from row to row, or run on between rows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import ndtri

from estimators.data.fit_data import FitData
from estimators.diagnosis.case import Trial
from estimators.diagnosis.servo_refit import refine_rows
from estimators.diagnosis.setting import Setting
from estimators.findings import Finding, Kind
from estimators.in_loop import decide_conventions
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.in_loop.settings import LOOP
from estimators.weak_form.point import Point
from pendulum_env.recording import Recording
from pendulum_env.servo.torque import replace_drive

GOALS = {Kind.GOALS_HELD: "ramp", Kind.GOALS_RUN_ON: "held"}  # with the other reading


def decide_drives(data: FitData, setting: Setting) -> FitData:
    """Return the data with the conventions of their drives, decided by the base model, see `decide_conventions`."""
    recordings, holdout, findings = decide_conventions(data.recordings, data.holdout, setting.base, setting.criterion)
    return replace(data, recordings=recordings, holdout=holdout, treatments=(*data.treatments, *findings))


def reread_goals(trial: Trial) -> FitData | None:
    """Read the goals the other way if the found model leaves more than the noise of the encoder.

    The base model decided the reading, but a missing effect may favour the wrong one. Held goals are the default, so
    goals that run on are always read again as held goals. Held goals are read again only if the base model leaves the
    reading open, and the found model then predicts held-out motion better.
    """
    data, unseen = trial.data, refine_rows(trial.evidence)[1]
    readings = [treatment for treatment in data.treatments if treatment.kind in GOALS]
    error = trial.result.steps[-1].errors["holdout"].total
    if len(readings) != 1 or error < LOOP.limits.faithful * unseen.rollouts.noise.encoder_error:
        return None
    gain, is_held = readings[0].numbers.get("gain"), readings[0].kind is Kind.GOALS_HELD
    if is_held and (gain is None or abs(gain.value) > ndtri(1.0 - trial.setting.criterion.p_value) * (gain.std or 0.0)):
        return None
    reread = declare_goals(trial, GOALS[readings[0].kind])
    return reread if not is_held or predict_held_out(trial, reread) < error else None


def declare_goals(trial: Trial, goal: str) -> FitData:
    """Return the data of a trial with another reading of the goals; how controllers read positions is decided again."""
    data, changes = trial.data, dict[str, Any](goal=goal)
    if data.has_treatment(Kind.POSITION_READ):
        changes["reads"] = None

    def declare(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
        return tuple(replace_drive(r, replace(r.drive, **changes)) for r in recordings if r.drive is not None)

    finding = Finding(Kind.GOALS_HELD if goal == "held" else Kind.GOALS_RUN_ON)
    data = data.with_treatment(finding, recordings=declare(data.recordings), holdout=declare(data.holdout))
    return decide_drives(data, trial.setting) if "reads" in changes else data


def predict_held_out(trial: Trial, data: FitData) -> float:
    """Return the held-out error of the model of a trial, refitted from its parameters to other data [rad]."""
    model, evidence = trial.result.steps[-1].model, trial.case.make_evidence(data, trial.setting)
    rows = evidence.train.rollouts
    assert isinstance(rows, RolloutRows)
    rows.fits.set_start(Point.from_parameters(model.terms, np.asarray(model.theta)))
    return evidence.fits.fit(model.terms).errors["holdout"].total
