"""Refits of the final model to simulated motion, which, unlike windows, includes stick and reversals."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from estimators.data.fits import find_term_edges
from estimators.decisions.errors import Step
from estimators.decisions.gate import Gate
from estimators.selection import gates
from estimators.selection.evidence import Evidence, Hypothesis
from estimators.selection.policies import CONFIRM, REFIT, REFIT_TO_MOTION, Rule
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

    The result is unchanged if the model is no misfit to the motion and has no bristles.
    """
    evidence, (*others, last) = result.evidence, result.steps
    if not (evidence.motion.is_misfit(last) or any(has_bristles(term) for term in last.model.terms)):
        return result
    evidence.progress("fitting the segments", 0.9)
    refined = _choose_step(evidence, last, evidence.fits.refit_to_motion(last), policy=REFIT_TO_MOTION)
    if others and not evidence.decide(refined, others[-1], CONFIRM).passed:
        return result
    return replace(result, steps=[*others, refined])


def refit_by_likelihood(selection: SearchResult, start: Model | None = None) -> SearchResult:
    """Return the result with the last model refitted by maximum likelihood, if held-out data confirm it.

    A model with a link is refitted together with the link's states; others only if their residual is noise.

    Args:
        selection: result with the step to refit as its last.
        start: initial guess of a model with a link, by default the fit to windows.
    """
    evidence, (*others, last) = selection.evidence, selection.steps
    if not last.model.has_known_inertia:
        return selection
    if has_link(last.model.terms):
        linked = evidence.fits.linked
        if linked is not None and linked.model.terms == last.model.terms:
            refitted = _choose_step(evidence, last, linked)
        else:
            refitted = _refit_with_link(evidence, last, start or last.model)
        model = multiple_shooting.add_standard_errors(evidence.train.data.windows, refitted.model)
        refitted = replace(refitted, model=model)
    elif not _has_edges(evidence, last.model) and evidence.residuals.is_noise(last.model.terms):
        refitted = _refit_by_likelihood(evidence, last)
    else:
        return selection
    if others and not evidence.decide(refitted, others[-1], CONFIRM).passed:
        return selection
    return replace(selection, steps=[*others, refitted])


def _choose_step(evidence: Evidence, step: Step, *refits: Step, policy: Rule = REFIT) -> Step:
    """Return a step, replaced by each refit in turn that passes a policy."""
    for refit in refits:
        step = refit if evidence.decide(refit, step, policy).passed else step
    return step


def _has_edges(evidence: Evidence, model: Model) -> bool:
    """Return whether a law of the model jumps at a parameter other than an instant, see `find_term_edges`."""
    edges = find_term_edges(evidence.train, model.terms).values()
    return any(not edge.instant for of_term in edges for edge in of_term)


def _refit_by_likelihood(evidence: Evidence, last: Step) -> Step:
    """Return the step by maximum likelihood, or `last`: with few segments, or by `REFIT_BY_LIKELIHOOD`."""
    start = Point.from_model(last.model)
    segments = [choose_segments(w, SEGMENT) for w in evidence.train.data.windows]
    if sum(len(segment.first) for segment in segments) < FEWEST * len(start.values):
        return last
    refitted = evidence.fits.make_step(output_error.fit_maximum_likelihood(segments, start), added=last.added)
    return refitted if evidence.decide(refitted, last, REFIT_BY_LIKELIHOOD).passed else last


def require_innovations(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that held-out innovations do not grow."""
    segments = [choose_segments(w, SEGMENT) for w in after.evidence.holdout.data.windows]
    new, old = (Point.from_model(each.step.model) for each in (after, before))
    filters = output_error.make_innovations(segments, old)
    new_rms, old_rms = (output_error.compute_rms(segments, point, filters=filters) for point in (new, old))
    yield Gate("innovations", new_rms, old_rms, new_rms <= old_rms)


def require_smaller_std(after: Hypothesis, before: Hypothesis) -> Iterator[Gate]:
    """Test that standard errors are smaller on average."""
    ratio = _compute_std_ratio(after.step, before.step)
    yield Gate("standard_errors", ratio, 1, ratio < 1)


REFIT_BY_LIKELIHOOD = Rule("refit by likelihood", (gates.require_no_loss, require_innovations, require_smaller_std))


def _compute_std_ratio(step: Step, reference: Step) -> float:
    """Return the ratio of the standard errors of two steps: the geometric mean, of parameters free in both."""
    pairs = [(step.model.estimates[name].std, estimate.std) for name, estimate in reference.model.estimates.items()]
    free = np.array([pair for pair in pairs if min(pair) > 0])
    return float(np.exp(np.mean(np.log(free[:, 0] / free[:, 1])))) if len(free) else np.inf


def _refit_with_link(evidence: Evidence, last: Step, start: Model) -> Step:
    """Return the step with parameters and link states refitted, from its model or `start`, or `last`."""
    refitted = multiple_shooting.estimate(evidence.train.data.windows, start)
    models = [refitted, *([start] if start is not last.model else [])]
    return _choose_step(evidence, last, *(evidence.fits.make_step(model, added=last.added) for model in models))
