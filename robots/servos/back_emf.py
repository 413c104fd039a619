"""Back-EMF of motors that a voltage drives: a part of viscous friction, unless the recordings distinguish the two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.checks.signs import compute_significant_sign
from estimators.data.fit_data import FitData
from estimators.data.treatment import Treatment
from estimators.decisions.errors import Step
from estimators.diagnosis.case import Trial
from estimators.diagnosis.options import Options
from estimators.weak_form.point import Point
from pendulum_env.physics import Term, list_ids
from pendulum_env.physics.actuation import BackEmf
from robots.servos.in_loop.servos import has_unpowered_motor, select_voltage_drives
from robots.servos.refit import refit_step

BACK_EMF_INCLUDED = "back_emf_included"  # action of a treatment: the base model has back-EMF


def add_back_emf(data: FitData, options: Options) -> Options:
    """Return the options with back-EMF in the base model if that is a treatment of the data."""
    if BACK_EMF_INCLUDED not in data.actions:
        return options
    return replace(options, base=(*options.base, BackEmf()))


def present(trial: Trial, step: Step) -> Step:
    """Return a step with back-EMF added to viscous friction if recordings do not distinguish the two.

    They do if the motor is ever off, or if an effect that depends on back-EMF, as friction by load, is significant.
    Known or bounded friction stays as it is.
    """
    followers = [term.columns[0].name for term in step.model.terms if _follows_back_emf(term)]
    has_gear_friction = any(compute_significant_sign(step.model, name) > 0 for name in followers)
    if BackEmf.id not in step.model.estimates or has_unpowered_motor(trial.data.recordings) or has_gear_friction:
        return step
    theta = {column.name: value for column, value in zip(step.model.columns, step.model.theta, strict=True)}
    viscous = next((column for column in step.model.columns if column.name == "viscous"), None)
    total = theta.get("viscous", 0.0) + theta.pop(BackEmf.id)
    if viscous is None or viscous.is_known or not viscous.is_allowed(total):
        return step
    other_terms = tuple(term for term in step.model.terms if term.id != BackEmf.id)
    start = Point.from_parameters(other_terms, np.array(list((theta | {"viscous": total}).values())))
    return refit_step(trial.evidence, step, start)


def include_back_emf(data: FitData, terms: Sequence[Term]) -> FitData | None:
    """Return the data with back-EMF as a treatment, if a voltage drives the motor and friction depends on the load.

    Otherwise return None: back-EMF is viscous friction, or the base model has it because the motor is ever off.
    """
    is_distinguishable = any(map(_follows_back_emf, terms)) and BackEmf.id not in list_ids(terms)
    is_included = is_distinguishable and bool(select_voltage_drives(data.recordings))
    return data.with_treatment(Treatment(BACK_EMF_INCLUDED, n_assumptions=1)) if is_included else None


def _follows_back_emf(term: Term) -> bool:
    """Return whether the law of a term depends on back-EMF."""
    return any(parameter.follows == BackEmf.id for parameter in term.nonlinear_parameters)
