"""Refits of models of servos with shorter steps of the integrator."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.checks.torque_constant import widen_by_constant
from estimators.data.fits import fit_terms
from estimators.in_loop.profile import Profile, widen_by_profile
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.selection.errors import Step
from estimators.selection.evaluator import ModelEvaluator
from estimators.simulation.output_error import Point
from pendulum_env.physics import Model, Term
from pendulum_env.recording import Recording
from pendulum_env.units import is_of_torque


def refine_rows(evaluator: ModelEvaluator) -> tuple[RolloutRows, RolloutRows]:
    """Return the rows of fitted and held-out rollouts with shorter steps of the integrator."""
    train, unseen = (part.rollouts for part in evaluator.parts)
    assert isinstance(train, RolloutRows) and isinstance(unseen, RolloutRows)
    return train.fine, unseen.fine


def refit_step(evaluator: ModelEvaluator, step: Step) -> Step:
    """Refit a step with shorter steps of the integrator, from where it was."""
    start = Point.within(step.model.terms, np.asarray(step.model.theta))  # where nonlinear parameters follow
    refine_rows(evaluator)[0].begin_at(start)
    return fit_step(evaluator, step.added, start.terms)


def fit_step(evaluator: ModelEvaluator, added: str | None, terms: Sequence[Term]) -> Step:
    """Fit a step with shorter steps of the integrator."""
    train, unseen = refine_rows(evaluator)
    terms = train.fit(terms).terms
    profile = train.scan(terms)
    terms = terms if profile is None else profile.point.terms
    model = widen_errors(fit_terms(train.data, terms)[0], train, profile)
    model = _convert_to_torque_unit(model, train.rollouts.recordings[0])
    return Step(added, model, {"train": train.data.errors(model), "holdout": unseen.data.errors(model)})


def _convert_to_torque_unit(model: Model, recording: Recording) -> Model:
    """Return a model in the unit of the torque, with its constant, whose error scales all parameters."""
    constant = recording.torque_constant
    if constant is None:
        return model.convert_units(recording.units)
    larger = 1.0 + constant.std / constant.value
    there = {
        name: replace(own, value=larger * own.value) if is_of_torque(own.unit) else own
        for name, own in model.estimates.items()
    }
    return widen_by_constant(model, constant, model, replace(model, estimates=there))


def widen_errors(model: Model, rows: RolloutRows, profile: Profile | None = None) -> Model:
    """Widen the standard errors of a model by a profile and by the error of the clock of a log, a share of a sample."""
    point = Point.of(model)
    near, rollouts = rows.near(model.terms), rows.rollouts
    by_nonlinear, nonlinear = rows.nonlinear_jacobian(model.terms, point.theta)
    slopes = np.column_stack([near.slopes[:, : len(point.theta)], by_nonlinear])
    late = np.column_stack([other.position_errors([point])[:, 0] for other in rollouts.mistimed])
    weights = near.weights[:, None]
    moved = np.linalg.lstsq(weights * slopes, -weights * (late - rollouts.position_errors([point])), rcond=None)[0]
    names = [*(column.name for column in model.columns), *nonlinear]
    place = [list(model.estimates).index(name) for name in names]
    covariance = model.assumed_covariance[np.ix_(place, place)]
    if profile is not None:
        covariance = widen_by_profile(names, covariance, profile)
    covariance += moved @ moved.T
    wider = {
        name: replace(model.estimates[name], std=float(std))
        for name, std in zip(names, np.sqrt(np.diag(covariance)), strict=True)
    }
    return replace(model, estimates={**model.estimates, **wider}).with_covariance(names, covariance)
