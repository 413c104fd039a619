"""Moves with tables: nonparametric functions that compete with effects, which may imitate an unknown law."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from estimators.data.variants import make_variants, refine_variants
from estimators.decisions.errors import Terms
from estimators.findings import Finding
from estimators.selection.candidates import find_best_variant, refit_nonlinear, screen_effects
from estimators.selection.evidence import Evidence
from estimators.selection.policies import ADD, BEAT_BY_TABLE, CONFIRM, EXPLAIN_TORQUE, NEED, SWAP, TIE, TIE_TABLE
from estimators.selection.state import SearchState, remove_term
from pendulum_env.physics import Table, Term, count_term_parameters, list_ids, list_loads


def replace_by_table(state: SearchState) -> SearchState:
    """Replace effects that imitate a table; return the state with `table` set, and terms without it, or the state.

    Effects imitate a table if the model with the table leaves only noise, predicts equally, and has fewer parameters or
    replaces two or more effects that leave structure. Or it predicts significantly better, and leaves only noise in the
    place of two or more effects, or explains enough: a share of the noise, or most of the structure; if it leaves
    structure, most of all torque above the noise floor. The table with the best prediction of held-out data is kept, in
    the shortest model over which that prediction is not needed: another form of the table may include an effect.
    `add_beside_table` adds effects.
    """
    evidence = state.evidence
    totals = {
        terms: _compute_held_out_gain(evidence, terms, state.terms)
        for terms in list_table_models(state)
        if any(evidence.decide(terms, state.terms, policy).passed for policy in (TIE_TABLE, BEAT_BY_TABLE))
    }
    if not totals:
        return state
    likeliest = max(totals, key=lambda terms: totals[terms])
    of_table = [terms for terms in totals if get_table(state, terms).id == get_table(state, likeliest).id]
    tied = [terms for terms in of_table if not state.evidence.decide(likeliest, terms, NEED).passed]
    shortest = min([likeliest, *tied], key=lambda terms: (len(terms), -totals[terms]))
    final = add_beside_table(state.with_terms(shortest))
    return replace(final, terms=remove_table(final.evidence, final.terms), table=get_table(final, final.terms))


def _compute_held_out_gain(evidence: Evidence, terms: Terms, others: Terms) -> float:
    """Return the gain of some terms over others on held-out data [nat]."""
    _, (new, old) = evidence.densities.compare_held_out(terms, others)
    return float(np.sum(new - old))


def list_table_models(state: SearchState) -> Iterator[Terms]:
    """Yield models with each form of each table.

    The table takes the place of all effects, or of all of its kind, or is added to the effects that are then still
    needed. If the state leaves only noise, the table needs fewer parameters than the effects, or takes the place of two
    or more of its kind.
    """
    evidence, start = state.evidence, state.start
    limit = sum(map(count_term_parameters, state.effects)) if state.is_noise else np.inf
    unexplained = {at for at in evidence.residuals.joints if not evidence.residuals.is_noise_at(at, state.terms)}
    joints = unexplained | {at for effect in state.effects for at in list_loads(effect.at)}
    for table in evidence.tables:
        if table.at and table.at not in joints:
            continue
        of_kind = [effect for effect in state.effects if (effect.kind, effect.at) == (table.kind, table.at)]
        others_of_kind = tuple(term for term in state.terms if term not in of_kind)
        for others in dict.fromkeys((others_of_kind, start, state.terms)):
            fewest = min(map(count_term_parameters, make_variants(evidence.train, others, table)), default=np.inf)
            replaces_kind = len(of_kind) > 1 and others is others_of_kind
            if fewest >= limit and not replaces_kind:
                continue
            if replaces_kind:
                yield from (trial.terms for trial in refine_variants(evidence.train, others, table))
            elif (trial := find_best_variant(evidence, others, table)) is not None:
                yield drop_unneeded(state.with_terms(trial.terms)).terms


def add_beside_table(state: SearchState) -> SearchState:
    """Add effects to a state with a table while each is needed and structure is left.

    No effect is added if another table predicts significantly better, or another form of the same table ties with it.
    """
    evidence = state.evidence
    while len(state.effects) <= evidence.criterion.search.max_effects and not state.is_noise:
        terms = state.terms
        candidates = screen_effects(evidence, terms)[: evidence.criterion.search.max_tried]
        longer = next((candidate for candidate in candidates if evidence.decide(candidate, terms, NEED).passed), None)
        if longer is None:
            break
        others = [
            find_best_variant(evidence, terms, table) for table in evidence.tables if table.id not in list_ids(terms)
        ]
        if any(trial is not None and evidence.decide(trial.terms, longer, SWAP).passed for trial in others):
            break
        if any(evidence.decide(finer, longer, TIE).passed for finer in list_table_forms(state)):
            break
        state = state.refit(longer)
    return state


def list_table_forms(state: SearchState) -> list[Terms]:
    """Return the terms of a state with each other form of their table: other numbers of pieces, or a turn."""
    table = get_table(state, state.terms)
    kind = next(kind for kind in state.evidence.tables if kind.id == table.id)
    trials = refine_variants(state.evidence.train, remove_term(state.terms, table), kind)
    return [trial.terms for trial in trials if trial.terms[-1] != table]


def drop_unneeded(state: SearchState) -> SearchState:
    """Drop effects that are not needed, the least needed first; a table stays.

    Without a table, effects that leave only noise stay, too.
    """
    evidence = state.evidence
    while True:
        effects = remove_table(evidence, state.terms)[len(state.start) :]
        if len(effects) == len(state.effects) and state.is_noise:
            return state
        smaller = [refit_nonlinear(evidence, remove_term(state.terms, effect)) for effect in effects]
        unneeded = [model for model in smaller if not evidence.decide(state.terms, model, NEED).passed]
        if not unneeded:
            return state
        state = state.with_terms(min(unneeded, key=evidence.screening_score))


def remove_table(evidence: Evidence, terms: Terms) -> Terms:
    """Return the terms without tables that compete with effects."""
    competing = {table.id for table in evidence.tables}
    return tuple(term for term in terms if term.id not in competing)


def get_table(state: SearchState, terms: Terms) -> Table:
    """Return the table among the terms after those of the start, which must include one."""
    return next(term for term in terms[len(state.start) :] if isinstance(term, Table))


def find_explaining_law(evidence: Evidence, terms: Terms, laws: Iterable[type[Term]]) -> str | None:
    """Return the id of the law that, added to the terms, has the highest held-out density.

    Candidates are laws that are supported and lower the held-out errors of the terms. They explain the share
    `criterion.explained_share` of the residual torque, or pass `NEED`. Return None
    without candidates.
    """
    trials = [find_best_variant(evidence, terms, law) for law in laws if law.id not in list_ids(terms)]
    models = [
        trial.terms
        for trial in trials
        if trial is not None
        and evidence.decide(trial.terms, terms, ADD).passed
        and any(evidence.decide(trial.terms, terms, policy).passed for policy in (EXPLAIN_TORQUE, NEED))
        and evidence.decide(trial.terms, terms, CONFIRM).passed
    ]
    best = max(
        models,
        key=evidence.densities.sum_held_out,
        default=None,
    )
    return best[-1].id if best else None


@dataclass(frozen=True)
class ExplainingTable(Finding):
    """Table that explains a residual, or more of it than an effect does: its id and nonlinear parameters."""

    table: str
    parameters: Mapping[str, float]

    @classmethod
    def from_table(cls, table: Table) -> Self:
        """Make the finding on a table."""
        return cls(table.id, dict(table.nonlinear_values))
