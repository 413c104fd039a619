"""Path of a search: the steps from the base model to the final one, each confirmed by held-out data."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise, permutations

from estimators.decisions.errors import Step, Terms
from estimators.selection.evidence import Evidence
from estimators.selection.policies import CONFIRM, SWAP
from estimators.selection.state import SearchState, remove_term
from pendulum_env.physics import Term, list_ids


def confirm_steps(state: SearchState) -> list[Step]:
    """Return the confirmed steps to the terms of a state; the last step is removed until they are confirmed."""
    steps = find_model_path(state)
    while not are_confirmed(state.evidence, steps):
        steps = find_model_path(state.with_terms(steps[-2].model.terms))
    return steps


def are_confirmed(evidence: Evidence, steps: Sequence[Step]) -> bool:
    """Return whether each step is confirmed by held-out data, or all of them together.

    For all together, the last step leaves noise, is confirmed over the first, and has lower errors than without any one
    of its effects.
    """
    if all(evidence.decide(after, before, CONFIRM).passed for before, after in pairwise(steps)):
        return True
    base, terms = steps[0].model.terms, steps[-1].model.terms
    smaller = [remove_term(terms, term) for term in terms if term.id not in list_ids(base)]
    return (
        evidence.residuals.is_noise(terms)
        and evidence.decide(steps[-1], steps[0], CONFIRM).passed
        and (len(smaller) == 1 or all(evidence.decide(terms, model, CONFIRM).passed for model in smaller))
    )


def find_model_path(state: SearchState) -> list[Step]:
    """Return the steps from the start to the terms of a state, in an order in which each is confirmed.

    The first order removes, from the last to the first step, the effect that the model needs least. With few effects,
    other orders follow, and then the same orders with parameters refitted to the motion. If windows of torque do not
    show each effect, the refitted orders come first. If none is confirmed, the first order is returned.
    """
    evidence, terms, base_ids = state.evidence, state.terms, list_ids(state.start)
    order: list[Term] = []
    remaining = terms
    while effects := remaining[len(state.start) :]:
        shorter = min((remove_term(remaining, effect) for effect in effects), key=evidence.screening_score)
        order.insert(0, next(term for term in remaining if term not in shorter))
        remaining = shorter
    has_few = len(order) <= evidence.criterion.search.max_ordered
    orders = list(permutations(order)) if has_few else [tuple(order)]
    step_of_terms: dict[Terms, Step] = {}

    def fit_steps(order: Sequence[Term], refit: Callable[[Step], Step]) -> list[Step]:
        steps = []
        for count in range(len(order) + 1):
            present = tuple(term for term in terms if term.id in base_ids or term in order[:count])
            if present not in step_of_terms:
                step_of_terms[present] = evidence.fits.fit_with_std(present)
            steps.append(refit(replace(step_of_terms[present], added=order[count - 1].id if count else None)))
        return steps

    refits: list[Callable[[Step], Step]] = [lambda step: step, evidence.fits.refit_to_motion]
    if not all(evidence.decide(terms, remove_term(terms, effect), SWAP).passed for effect in order):
        refits.reverse()  # the motion alone determines an effect
    for refit in refits if order and evidence.train.segments else refits[:1]:
        for permutation in orders:
            steps = fit_steps(permutation, refit)
            if are_confirmed(evidence, steps):
                return steps
    return fit_steps(orders[0], refits[0])
