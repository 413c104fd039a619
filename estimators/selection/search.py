"""Search for missing effects: one loop of moves that add, swap and drop effects.

Each move proposes models and decides by the policies of `policies`. The score is the log predictive density of held-out
blocks. An effect is added if its gain is significant, if it explains enough of the residual structure, if its
parameters are physically possible, and if both held-out errors fall. Then each effect is compared with every other
effect in its place, and with its own absence.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from estimators.decisions.decision import decide
from estimators.decisions.errors import Step, Terms
from estimators.selection.candidates import refit_nonlinear, screen_effects
from estimators.selection.evidence import Evidence
from estimators.selection.moves import extend_model, revise
from estimators.selection.path import are_confirmed, confirm_steps, find_model_path
from estimators.selection.policies import DETERMINE_LAG, IMITATE, KEEP_BASE, SWAP, TIE
from estimators.selection.state import SearchState, remove_term
from estimators.selection.tables import drop_unneeded, replace_by_table
from pendulum_env.physics import Table, list_ids
from pendulum_env.physics.potential import GravityTilt
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
    """Search for the effects that the base model lacks.

    If a delay or lag of the torque may fit a controller's answer in the end, the search is repeated without both.
    """
    state = find_effects(evidence)
    if not evidence.decide(state.terms, state.start, DETERMINE_LAG).passed:
        others = {id: effect for id, effect in evidence.library.items() if not effect().delays_torque}
        state = find_effects(evidence.with_library(others))
        state = replace(state, evidence=state.evidence.with_library(evidence.library))
    return SearchResult(state.evidence, confirm_steps(state), state.table)


def find_effects(evidence: Evidence) -> SearchState:
    """Search for the effects that a base model lacks, or for a table in their place."""
    start = refit_nonlinear(evidence, evidence.fits.base)
    state = grow(SearchState(evidence, start, start))
    for first in propose_starts(evidence, state):  # another first effect
        other = grow(first)
        if decide(other.hypothesis, state.hypothesis, SWAP).passed and is_confirmed(other):
            state = other
    return replace_by_table(drop_imitations(drop_unneeded(state)))


def grow(state: SearchState) -> SearchState:
    """Extend a model until no extension passes; after each, drop and swap effects."""
    visited = {list_forms(state.terms)}
    while state.has_room(1) and (longer := extend_model(state)) is not None:
        revised = revise(longer)
        is_same = list_forms(revised.terms) == list_forms(longer.terms)
        is_cycle = list_forms(revised.terms) in visited
        state = revised if not is_cycle and (is_same or is_confirmed(revised)) else longer
        if list_forms(state.terms) in visited:
            break
        visited.add(list_forms(state.terms))
    return state


def is_confirmed(state: SearchState) -> bool:
    """Return whether held-out data confirm the steps from the start of a state to its terms."""
    return are_confirmed(state.evidence, find_model_path(state))


def propose_starts(evidence: Evidence, state: SearchState) -> Iterator[SearchState]:
    """Yield states with another first effect: tilted gravity if the zero is wrong, and others if structure is left.

    The best `search.n_restarts` first effects are tried if they tie with the found ones and keep the base parameters.
    `evidence` has no states of a link.
    """
    start, ids = state.start, list_ids(state.terms)
    tilt = evidence.library.get(GravityTilt.id)
    if tilt is not None and tilt.id not in ids and evidence.train.has_wrong_zero(start):
        yield state.refit((*start, tilt()))
    if state.is_noise:
        return
    models, freed = screen_effects(evidence, start), state.evidence.fits.release_known(start)
    rivals = [*models[:1], *((*start, effect) for effect in state.effects)]
    for first in models[: evidence.criterion.search.n_restarts]:
        if first[-1].id not in ids and state.evidence.decide(first, freed, SWAP).passed:
            if all(state.evidence.decide(first, rival, TIE).passed for rival in rivals):
                refitted = state.refit(first)
                if state.evidence.decide(refitted.terms, start, KEEP_BASE).passed:
                    yield refitted


def drop_imitations(state: SearchState) -> SearchState:
    """Return the state without its effects if they imitate other values of known parameters, else the state.

    A simpler model with these parameters free must leave only noise in torque and motion, and predict equally.
    The simpler models lack one of the effects, or have one of the best other effects.
    """
    evidence, freed = state.evidence, state.evidence.fits.release_known(state.start)
    if freed == state.start or not state.effects:
        return state
    smaller = [evidence.fits.release_known(remove_term(state.terms, effect)) for effect in state.effects]
    others = screen_effects(evidence, freed)[: evidence.criterion.search.n_restarts]
    is_imitated = any(state.accepts(terms, IMITATE) for terms in (*smaller, *others))
    return state.with_terms(state.start) if is_imitated else state
