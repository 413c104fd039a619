"""Reading of goals as a treatment of the data: held from row to row, or run on between rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtri

from estimators.data.fit_data import FitData
from estimators.decisions.decision import Policy, decide
from estimators.decisions.gate import Gate
from estimators.diagnosis.case import Trial
from estimators.diagnosis.options import Options
from estimators.findings import Quantity
from estimators.weak_form.point import Point
from pendulum_env.recording import Recording
from robots.servos.in_loop import decide_conventions
from robots.servos.in_loop.conventions import ControllerConvention, GoalConvention
from robots.servos.in_loop.rollout_rows import RolloutRows
from robots.servos.refit import refine_rows
from robots.servos.torque import find_drive, replace_drive


def decide_drives(data: FitData, options: Options) -> FitData:
    """Return the data with the conventions of their drives, decided by the base model, see `decide_conventions`."""
    recordings, holdout, findings = decide_conventions(data.recordings, data.holdout, options.base, options.criterion)
    return replace(data, recordings=recordings, holdout=holdout, treatments=(*data.treatments, *findings))


def reread_goals(trial: Trial) -> FitData | None:
    """Read the goals the other way if the found model leaves more than the noise of the encoder.

    The base model decided the reading, but a missing effect may favour the wrong one. Held goals are the default, so
    goals that run on are always read again as held goals. Held goals are read again only if the base model leaves the
    reading open, and the found model then predicts held-out motion better.
    """
    data, unseen = trial.data, refine_rows(trial.evidence)[1]
    readings = [treatment for treatment in data.treatments if isinstance(treatment, GoalConvention)]
    error = trial.result.steps[-1].errors["holdout"].total
    if len(readings) != 1 or error < trial.options.criterion.loop.faithful * unseen.rollouts.noise.encoder_error:
        return None
    is_held = readings[0].is_held
    other = Reading(trial, "ramp" if is_held else "held")
    return None if is_held and not decide(other, Reading(trial), REREAD).passed else other.data


def declare_goals(trial: Trial, goal: str) -> FitData:
    """Return the data of a trial with another reading of the goals; how controllers read positions is decided again."""
    data, changes = trial.data, dict[str, Any](goal=goal)
    if any(isinstance(one, ControllerConvention) and one.is_of_position for one in data.treatments):
        changes["reads"] = None

    def declare(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
        return tuple(replace_drive(r, replace(find_drive(r), **changes)) for r in recordings)

    treated = {"recordings": declare(data.recordings), "holdout": declare(data.holdout)}
    data = data.with_treatment(GoalConvention(goal == "held"), **treated)
    return decide_drives(data, trial.options) if "reads" in changes else data


@dataclass(frozen=True)
class Reading:
    """Data of a trial with a reading of the goals, that of the trial if it is None."""

    trial: Trial
    goal: str | None = None

    @cached_property
    def data(self) -> FitData:
        """Data with the reading."""
        return self.trial.data if self.goal is None else declare_goals(self.trial, self.goal)

    @property
    def gain(self) -> Quantity:
        """Gain over the other reading, by the base model [nat]; infinite if it is unknown."""
        reading = next(treatment for treatment in self.data.treatments if isinstance(treatment, GoalConvention))
        return reading.gain or Quantity(np.inf)

    def compute_held_out_error(self) -> float:
        """Return the held-out error of the model of the trial, refitted from its parameters to the data [rad]."""
        last = self.trial.result.steps[-1]
        if self.goal is None:
            return last.errors["holdout"].total
        model, evidence = last.model, self.trial.case.make_evidence(self.data, self.trial.options)
        rows = evidence.train.rollouts
        assert isinstance(rows, RolloutRows)
        rows.fits.set_start(Point.from_parameters(model.terms, np.asarray(model.theta)))
        return evidence.fits.fit(model.terms).errors["holdout"].total


def require_open_reading(after: Reading, before: Reading) -> Iterator[Gate]:
    """Test that the base model leaves the reading open: an insignificant gain of the present one over the other."""
    gain = before.gain
    limit = float(ndtri(1.0 - before.trial.options.criterion.p_value)) * (gain.std or 0.0)
    yield Gate("gain", abs(gain.value), limit, abs(gain.value) <= limit, "nat", gain.std)


def require_lower_error_in_loop(after: Reading, before: Reading) -> Iterator[Gate]:
    """Test the held-out error of the motion in the loop."""
    new, old = after.compute_held_out_error(), before.compute_held_out_error()
    yield Gate("holdout_in_loop", new, old, new < old, "rad")


# Held goals are read as running on.
REREAD = Policy("reread", (require_open_reading, require_lower_error_in_loop))
