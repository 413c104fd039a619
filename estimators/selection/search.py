"""Search for missing effects: one loop of moves that add, swap and drop effects by one score.

The score is the log predictive density of held-out blocks (`score`). An effect is added if its gain is significant, if
it explains enough of the residual structure, if its parameters are physically possible, and if both held-out errors
fall. Then each effect is compared with every other effect in its place, and with its own absence.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations

from estimators.selection.candidates import refit_nonlinear, screen_effects
from estimators.selection.errors import Step, Terms
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.moves import SearchState, add_effect, remove_term, revise
from estimators.selection.tables import drop_unneeded, replace_by_table
from pendulum_env.physics import Table, Term, list_ids
from pendulum_env.physics.terms import list_forms


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes:
        evaluator: fits and scores of all models that were tried.
        steps: from the base model to the final one.
        table: nonparametric function that replaces effects; None without one.
    """

    evaluator: ModelEvaluator
    steps: list[Step]
    table: Table | None = None

    @property
    def terms(self) -> Terms:
        """Terms of the final model."""
        return self.steps[-1].model.terms


def search(evaluator: ModelEvaluator) -> SearchResult:
    """Search for the effects that the base model of an evaluator lacks.

    If the best first effect leaves structure in the end, the search is repeated from the next ones.
    """
    start = refit_nonlinear(evaluator, evaluator.base)
    state = grow(SearchState(evaluator, start, start))
    if not state.is_noise:
        known, firsts = list_ids(state.terms), screen_effects(evaluator, start)  # as at first, without states of a link
        rivals = [*firsts[:1], *((*start, effect) for effect in state.effects)]
        freed = state.evaluator.without_known(start)
        for first in firsts[: evaluator.criterion.beam]:
            if (
                first[-1].id not in known
                and state.evaluator.is_significant(first, freed)
                and all(state.evaluator.is_tied(first, rival) for rival in rivals)
            ):
                other = grow(state.refit(first))
                if _is_better(other, state) and are_confirmed(other.evaluator, find_model_path(other)):
                    state = other
    state = replace_by_table(drop_unneeded(state))
    return SearchResult(state.evaluator, confirm_steps(state), state.table)


def _is_better(one: SearchState, other: SearchState) -> bool:
    """Return whether one state, with an evaluator of its own, predicts significantly better than another."""
    penalty = other.evaluator.penalty(one.terms, other.terms)
    densities = one.evaluator.density(one.terms), other.evaluator.density(other.terms)
    return other.evaluator.bootstrap.gain(*densities, penalty).p_value <= other.evaluator.criterion.p_value


def grow(state: SearchState) -> SearchState:
    """Add effects while they gain; after each, drop and swap effects."""
    start, seen = state, {list_forms(state.terms)}
    while len(state.terms) - len(start.start) < state.evaluator.criterion.max_effects:
        longer = add_effect(state)
        if longer is None:
            break
        revised = revise(longer)
        if list_forms(revised.terms) in seen:  # avoids a cycle; unneeded effects are dropped in the end
            revised = longer
        follows = list_forms(revised.terms) == list_forms(longer.terms) or are_confirmed(
            revised.evaluator, find_model_path(revised)
        )
        state = revised if follows else longer
        if list_forms(state.terms) in seen:
            break
        seen.add(list_forms(state.terms))
    return state


def confirm_steps(state: SearchState) -> list[Step]:
    """Return the steps to the terms of a state, or to those of them that lower both errors one after the other."""
    steps = find_model_path(state)
    while not are_confirmed(state.evaluator, steps):
        steps = find_model_path(state.with_terms(steps[-2].model.terms))
    return steps


def are_confirmed(evaluator: ModelEvaluator, steps: Sequence[Step]) -> bool:
    """Return whether every step is confirmed, or all at once if they leave only noise and none can be left out."""
    if all(evaluator.is_confirmed(after, before) for before, after in pairwise(steps)):
        return True
    base, terms = steps[0].model.terms, steps[-1].model.terms
    smaller = [remove_term(terms, term) for term in terms if term.id not in list_ids(base)]
    return (
        evaluator.residuals.is_noise(terms)
        and evaluator.is_confirmed(steps[-1], steps[0])
        and (len(smaller) == 1 or all(evaluator.lowers_errors(terms, one) for one in smaller))
    )


def find_model_path(state: SearchState) -> list[Step]:
    """Return the steps from the start to the terms of a state, in an order in which each lowers both errors.

    The effect that the final model needs most comes first. Without such an order, that order is returned. With a large
    unexplained residual, the errors may fall only with the parameters fitted to the motion.
    """
    evaluator, terms, known = state.evaluator, state.terms, list_ids(state.start)
    order: list[Term] = []
    rest = terms
    while effects := rest[len(state.start) :]:
        shorter = min((remove_term(rest, effect) for effect in effects), key=evaluator.screening_score)
        order.insert(0, next(term for term in rest if term not in shorter))
        rest = shorter
    few = len(order) <= evaluator.criterion.max_ordered
    orders = list(permutations(order)) if few else [tuple(order)]
    fitted: dict[Terms, Step] = {}

    def path(order: Sequence[Term], refit: Callable[[Step], Step]) -> list[Step]:
        steps = []
        for count in range(len(order) + 1):
            present = tuple(term for term in terms if term.id in known or term in order[:count])
            if present not in fitted:
                fitted[present] = evaluator.fit_with_std(None, present)
            steps.append(refit(replace(fitted[present], added=order[count - 1].id if count else None)))
        return steps

    refits: list[Callable[[Step], Step]] = [lambda step: step, evaluator.refit_to_motion]
    for refit in refits if order and evaluator.train.segments else refits[:1]:
        for one in orders:
            steps = path(one, refit)
            if are_confirmed(evaluator, steps):
                return steps
    return path(orders[0], refits[0])
