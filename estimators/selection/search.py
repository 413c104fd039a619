"""Search for missing effects: one loop of moves that add, swap and drop effects by one score.

The score is the log predictive density of held-out blocks (`score`). An effect is added if its gain is significant, if
it explains enough of the residual structure, if its parameters are physically possible, and if both held-out errors
fall. Then each effect is compared with every other effect in its place, and with its own absence.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations

from estimators.decisions.decision import decide
from estimators.decisions.errors import Step, Terms
from estimators.regression.least_squares import IdentificationError
from estimators.selection.candidates import (
    find_best_variant,
    find_undetermined_parameter,
    refit_nonlinear,
    release_significant,
    screen_effects,
)
from estimators.selection.evidence import Evidence
from estimators.selection.moves import SearchState, add_dry_friction, add_effect, remove_term, revise
from estimators.selection.policies import CONFIRM, DETERMINE_LAG, IMITATE, KEEP_BASE, SWAP, TIE
from estimators.selection.tables import drop_unneeded, replace_by_table
from pendulum_env.physics import Table, Term, is_dry, list_ids
from pendulum_env.physics.terms import list_forms


@dataclass(frozen=True)
class SearchResult:
    """Result of a search.

    Attributes:
        evidence: fits and scores of all models that were tried.
        steps: from the base model to the final one.
        table: nonparametric function that replaces effects; None without one.
    """

    evidence: Evidence
    steps: list[Step]
    table: Table | None = None

    @property
    def terms(self) -> Terms:
        """Terms of the final model."""
        return self.steps[-1].model.terms


def search(evidence: Evidence) -> SearchResult:
    """Search for the effects that the base model of an evidence lacks.

    If a delay or lag of the torque may fit a controller's answer in the end, the search is repeated without both.
    """
    state = find_effects(evidence)
    if not evidence.decide(state.terms, state.start, DETERMINE_LAG).passed:
        others = {id: effect for id, effect in evidence.library.items() if not (effect().lead or effect().delay)}
        state = find_effects(evidence.with_library(others))
        state = replace(state, evidence=state.evidence.with_library(evidence.library))
    return SearchResult(state.evidence, confirm_steps(state), state.table)


def find_effects(evidence: Evidence) -> SearchState:
    """Search for the effects that a base model lacks, or for a table in their place.

    If the result leaves structure, the search is repeated from each of the best `criterion.beam` first effects that
    tie with the found ones and keep the base parameters; a significantly better result is kept. Finally, unneeded
    effects and those that imitate known parameters are dropped, and effects that imitate a table are replaced by it.
    """
    start = refit_nonlinear(evidence, evidence.fits.base)
    state = grow(SearchState(evidence, start, start))
    if not state.is_noise:
        ids, first_models = list_ids(state.terms), screen_effects(evidence, start)  # without states of a link
        rivals = [*first_models[:1], *((*start, effect) for effect in state.effects)]
        freed = state.evidence.fits.release_known(start)
        for first in first_models[: evidence.criterion.beam]:
            if (
                first[-1].id not in ids
                and state.evidence.decide(first, freed, SWAP).passed
                and all(state.evidence.decide(first, rival, TIE).passed for rival in rivals)
                and state.evidence.decide((refitted := state.refit(first)).terms, start, KEEP_BASE).passed
            ):
                other = grow(refitted)
                if decide(other.hypothesis, state.hypothesis, SWAP).passed and are_confirmed(
                    other.evidence, find_model_path(other)
                ):
                    state = other
    return replace_by_table(drop_imitations(drop_unneeded(state)))


def drop_imitations(state: SearchState) -> SearchState:
    """Return the state without its effects if they imitate other values of known parameters, else the state.

    A simpler model with these parameters free must leave only noise in torque and motion, and predict equally.
    The simpler models lack one of the effects, or have one of the best other effects.
    """
    evidence, freed = state.evidence, state.evidence.fits.release_known(state.start)
    if freed == state.start or not state.effects:
        return state
    smaller = [evidence.fits.release_known(remove_term(state.terms, effect)) for effect in state.effects]
    others = screen_effects(evidence, freed)[: evidence.criterion.beam]
    is_imitated = any(evidence.decide(terms, state.terms, IMITATE).passed for terms in (*smaller, *others))
    return state.with_terms(state.start) if is_imitated else state


def grow(state: SearchState) -> SearchState:
    """Add effects until none is supported; after each, drop and swap effects.

    A revision is kept only if it leads to new terms and its steps are confirmed. At most `criterion.max_effects`
    are added.
    """
    start, visited = state, {list_forms(state.terms)}
    while len(state.terms) - len(start.start) < state.evidence.criterion.max_effects:
        longer = add_effect(state)
        if longer is None:
            break
        revised = revise(longer)
        if list_forms(revised.terms) in visited:  # avoids a cycle
            revised = longer
        is_kept = list_forms(revised.terms) == list_forms(longer.terms) or are_confirmed(
            revised.evidence, find_model_path(revised)
        )
        state = revised if is_kept else longer
        if list_forms(state.terms) in visited:
            break
        visited.add(list_forms(state.terms))
    return state


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
    has_few = len(order) <= evidence.criterion.max_ordered
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


def fit_without_and_with(evidence: Evidence, kind: type[Term]) -> list[Step]:
    """Return the steps from the base model to that with the best variant of an effect, with standard errors.

    Dry friction that is not significant in torque is fitted to free motion, if that confirms it.

    Raises:
        IdentificationError: if the data offer no variant of the effect, or do not determine it.
    """
    evidence.progress("fitting without it", 0.1)
    start = refit_nonlinear(evidence, evidence.fits.base)
    evidence.progress(f"searching {kind.id}", 0.3)
    trial = find_best_variant(evidence, start, kind, is_determined=True)
    terms = None if trial is None else refit_nonlinear(evidence, release_significant(evidence, trial.terms))
    if is_dry(kind()) and (terms is None or not evidence.decide(terms, start, SWAP).passed):
        if (by_motion := add_dry_friction(SearchState(evidence, start, start))) is not None:
            return find_model_path(by_motion)
    if terms is None:
        raise IdentificationError(f"{', '.join(evidence.train.names)}: nothing there shows {kind.id}", kind.id)
    evidence.progress(f"fitting with {kind.id}", 0.8)
    before, longer = evidence.fits.fit_with_std(start), evidence.fits.fit_with_std(terms, added=kind.id)
    if (name := find_undetermined_parameter(evidence, longer)) is not None:
        raise IdentificationError(
            f"{', '.join(evidence.train.names)}: {name} is not determined: within its standard error "
            "it means more torque than was applied",
            longer.model.terms[-1].id,
        )
    return [before, longer]
