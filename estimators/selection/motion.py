"""Refits of the final model to simulated motion, which, unlike windows, includes stick and reversals."""

from dataclasses import replace

import numpy as np

from estimators.data.fits import find_term_edges
from estimators.decisions.errors import Step, compute_held_out_cost
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.search import SearchResult
from estimators.simulation import multiple_shooting, output_error
from estimators.simulation.free_running import choose_segments
from estimators.weak_form.point import Point
from pendulum_env.physics import Model, has_link
from pendulum_env.physics.terms import has_bristles

SEGMENT = 0.5  # length of a segment [s], short enough to linearise the growth of errors
FEWEST = 2  # least number of segments per parameter


def refit_if_misfit(result: SearchResult) -> SearchResult:
    """Return the result with the last model refitted to free-running motion, if that is confirmed by held-out data.

    The result is unchanged if the model is no misfit to the motion and has no bristles. The better of both by held-out
    cost is kept.
    """
    evaluator, (*others, last) = result.evaluator, result.steps
    if not (evaluator.is_misfit(last) or any(has_bristles(term) for term in last.model.terms)):
        return result
    evaluator.progress("fitting the segments", 0.9)
    refined = min(last, evaluator.refit_to_motion(last), key=compute_held_out_cost)
    if others and not evaluator.is_confirmed(refined, others[-1]):
        return result
    return replace(result, steps=[*others, refined])


def refit_by_likelihood(selection: SearchResult, start: Model | None = None) -> SearchResult:
    """Return the result with the last model refitted by maximum likelihood, if held-out data confirm it.

    A model with a link is refitted together with the link's states; others only if their residual is noise.

    Args:
        selection: result with the step to refit as its last.
        start: initial guess of a model with a link, by default the fit to windows.
    """
    evaluator, (*others, last) = selection.evaluator, selection.steps
    if not last.model.has_known_inertia:
        return selection
    if has_link(last.model.terms):
        linked = evaluator.linked
        if linked is not None and linked.model.terms == last.model.terms:
            refitted = min(last, linked, key=compute_held_out_cost)
        else:
            refitted = _refit_with_link(evaluator, last, start or last.model)
        model = multiple_shooting.add_standard_errors(evaluator.train.data.windows, refitted.model)
        refitted = replace(refitted, model=model)
    elif not _has_edges(evaluator, last.model) and evaluator.residuals.is_noise(last.model.terms):
        refitted = _refit_by_likelihood(evaluator, last)
    else:
        return selection
    if others and not evaluator.is_confirmed(refitted, others[-1]):
        return selection
    return replace(selection, steps=[*others, refitted])


def _has_edges(evaluator: ModelEvaluator, model: Model) -> bool:
    """Return whether a law of the model jumps at a parameter other than an instant, see `find_term_edges`."""
    edges = find_term_edges(evaluator.train, model.terms).values()
    return any(not edge.instant for of_term in edges for edge in of_term)


def _refit_by_likelihood(evaluator: ModelEvaluator, last: Step) -> Step:
    """Return the step by maximum likelihood, or `last`: with larger innovations or errors, or few segments.

    Held-out innovations must not grow, and standard errors must be smaller on average.
    """
    start = Point.from_model(last.model)
    segments, holdout_segments = ([choose_segments(w, SEGMENT) for w in part.data.windows] for part in evaluator.parts)
    if sum(len(segment.first) for segment in segments) < FEWEST * len(start.values):
        return last
    refitted = evaluator.make_step(output_error.fit_maximum_likelihood(segments, start), added=last.added)
    filters = output_error.make_innovations(holdout_segments, start)
    old_rms, new_rms = (
        output_error.compute_rms(holdout_segments, point, filters=filters)
        for point in (start, Point.from_model(refitted.model))
    )
    return refitted if new_rms <= old_rms and _has_smaller_std(refitted, last) else last


def _has_smaller_std(step: Step, reference: Step) -> bool:
    """Return whether the first step has smaller standard errors: by geometric mean, of parameters free in both."""
    pairs = [(step.model.estimates[name].std, estimate.std) for name, estimate in reference.model.estimates.items()]
    free = np.array([pair for pair in pairs if min(pair) > 0])
    return len(free) > 0 and float(np.mean(np.log(free[:, 0] / free[:, 1]))) < 0


def _refit_with_link(evaluator: ModelEvaluator, last: Step, start: Model) -> Step:
    """Return the step with parameters and link states refitted, from its model or `start`, or `last`.

    The least held-out cost decides among the steps that do not increase the held-out torque error.
    """
    refitted = multiple_shooting.estimate(evaluator.train.data.windows, start)
    models = [refitted, *([start] if start is not last.model else [])]
    steps = [evaluator.make_step(model, added=last.added) for model in models]
    candidates = [step for step in steps if step.errors["holdout"].torque_rms <= last.errors["holdout"].torque_rms]
    return min(last, *candidates, key=compute_held_out_cost) if candidates else last
