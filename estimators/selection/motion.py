"""Free-running simulation after the search: models refined by the motion.

Windows exclude stick and reversals; a simulation includes both.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.selection.criterion import Criterion
from estimators.selection.errors import Step, compute_held_out_cost
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.search import SearchResult
from estimators.simulation import multiple_shooting, output_error
from estimators.simulation.free_running import Segments, choose_segments
from estimators.simulation.output_error import Point
from pendulum_env.physics import Model, has_link, has_transmission
from pendulum_env.physics.terms import has_bristles

SEGMENT = 0.5  # [s], segment length, short enough for errors to grow as linearised
FEWEST = 2  # segments per parameter


def refit_if_misfit(found: SearchResult) -> SearchResult:
    """Refit the last model to the motion where free-running simulation errs by more than noise, or bristles hide."""
    evaluator, (*others, last) = found.evaluator, found.steps
    if not (is_misfit(evaluator, last) or any(has_bristles(term) for term in last.model.terms)):
        return found
    evaluator.progress("fitting the segments", 0.9)
    refined = min(last, evaluator.refit_to_motion(last), key=compute_held_out_cost)
    if others and not evaluator.is_confirmed(refined, others[-1]):
        return found
    return replace(found, steps=[*others, refined])


def is_misfit(evaluator: ModelEvaluator, step: Step) -> bool:
    """Return whether free-running simulation errs by much more than noise, even from fitted initial states."""
    if has_transmission(step.model.terms):
        return False  # its impacts are too sharp to simulate as closely, and other effects would only imitate them
    if not (evaluator.train.segments and step.model.has_known_inertia):
        return False
    segments, point = evaluator.train.segments, Point.from_model(step.model)
    if not errs_by_more_than_noise(segments, step, evaluator.criterion):
        return False
    noise = max(_accuracy(segments, evaluator.criterion), output_error.compute_torque_noise_rms(segments, point))
    return output_error.compute_rms(segments, point) > evaluator.criterion.misfit * noise


def errs_by_more_than_noise(segments: Sequence[Segments], step: Step, criterion: Criterion) -> bool:
    """Return whether the error of fitted segments is much larger than noise of torque and initial state makes it."""
    noise = max(_accuracy(segments, criterion), output_error.compute_noise_rms(segments, Point.from_model(step.model)))
    return step.errors["train"].position_rms > criterion.misfit * noise


def _accuracy(segments: Sequence[Segments], criterion: Criterion) -> float:
    """Return the accuracy of a simulation of the segments [rad]."""
    return criterion.accuracy * float(np.std(np.concatenate([segment.position.ravel() for segment in segments])))


def refit_by_likelihood(selection: SearchResult, start: Model | None = None) -> SearchResult:
    """Refit the last model by maximum likelihood, if held-out data confirm it; the states of a link are estimated.

    Windows lose information near reversals and from a coarse encoder.

    Args:
        selection: its last step is refitted.
        start: initial guess of a model with a link, by default the fit to windows.
    """
    evaluator, (*others, last) = selection.evaluator, selection.steps
    if not last.model.has_known_inertia:
        return selection
    if has_link(last.model.terms):
        known = evaluator.linked
        if known is not None and known.model.terms == last.model.terms:
            found = min(last, known, key=compute_held_out_cost)
        else:
            found = _refit_with_link(evaluator, last, start or last.model)
        # windows take the motion of the link for granted, which its parameters have made
        found = replace(found, model=multiple_shooting.add_standard_errors(evaluator.train.data.windows, found.model))
    elif evaluator.residuals.is_noise(last.model.terms):
        found = _refit_by_likelihood(evaluator, last)
    else:
        return selection
    if others and not evaluator.is_confirmed(found, others[-1]):
        return selection
    return replace(selection, steps=[*others, found])


def _refit_by_likelihood(evaluator: ModelEvaluator, last: Step) -> Step:
    """Return the maximum-likelihood model, if its standard errors and held-out innovations are no larger."""
    start = Point.from_model(last.model)
    segments, checks = ([choose_segments(w, SEGMENT) for w in part.data.windows] for part in evaluator.parts)
    if sum(len(segment.first) for segment in segments) < FEWEST * len(start.values):
        return last
    found = evaluator.make_step(last.added, output_error.fit_maximum_likelihood(segments, start))
    filters = output_error.make_innovations(checks, start)
    old, new = (
        output_error.compute_rms(checks, point, filters=filters) for point in (start, Point.from_model(found.model))
    )
    return found if new <= old and _has_smaller_std(found, last) else last


def _has_smaller_std(one: Step, other: Step) -> bool:
    """Return whether standard errors are smaller on average, of parameters that are free in both."""
    pairs = [(one.model.estimates[name].std, known.std) for name, known in other.model.estimates.items()]
    free = np.array([pair for pair in pairs if min(pair) > 0])
    return len(free) > 0 and float(np.mean(np.log(free[:, 0] / free[:, 1]))) < 0


def _refit_with_link(evaluator: ModelEvaluator, last: Step, start: Model) -> Step:
    """Refit the step together with the states of its link, if that lowers held-out errors."""
    shot = multiple_shooting.estimate(evaluator.train.data.windows, start)
    tried = [shot, *([start] if start is not last.model else [])]
    steps = [evaluator.make_step(last.added, model) for model in tried]
    no_worse = [step for step in steps if step.errors["holdout"].torque_rms <= last.errors["holdout"].torque_rms]
    return min(last, *no_worse, key=compute_held_out_cost) if no_worse else last
