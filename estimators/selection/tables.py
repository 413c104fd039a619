"""Moves with tables: nonparametric functions that compete with effects, which may imitate an unknown law."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from estimators.data.variants import make_variants, refine_variants
from estimators.decisions.errors import Terms
from estimators.findings import Finding, Kind, Quantity
from estimators.selection.candidates import find_best_variant, refit_nonlinear, screen_effects
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.moves import SearchState, remove_term
from pendulum_env.physics import Table, Term, count_term_parameters, list_ids, list_loads
from pendulum_env.physics.terms import count_parameters


def replace_by_table(state: SearchState) -> SearchState:
    """Replace effects that imitate a table; return the state with `table` set, and terms without it, or the state.

    Effects imitate a table if the model with the table leaves only noise, predicts equally, and has fewer parameters or
    replaces two or more effects that leave structure. Or it predicts significantly better, and leaves only noise in the
    place of two or more effects, or explains enough: a share of the noise, or most of the structure; if it leaves
    structure, most of all torque above the noise floor. The table with the best prediction of held-out data is kept, in
    the shortest model over which that prediction is not needed: another form of the table may include an effect.
    `add_beside_table` adds effects.
    """
    totals = {
        terms: total for terms in list_table_models(state) if (total := _compute_table_gain(state, terms)) is not None
    }
    if not totals:
        return state
    likeliest = max(totals, key=lambda terms: totals[terms])
    of_table = [terms for terms in totals if get_table(state, terms).id == get_table(state, likeliest).id]
    tied = [terms for terms in of_table if not state.evaluator.is_needed(likeliest, terms)]
    shortest = min([likeliest, *tied], key=lambda terms: (len(terms), -totals[terms]))
    final = add_beside_table(state.with_terms(shortest))
    return replace(final, terms=remove_table(final.evaluator, final.terms), table=get_table(final, final.terms))


def _compute_table_gain(state: SearchState, terms: Terms) -> float | None:
    """Return the gain of terms with a table on held-out data [nat]; None if they do not replace those of the state."""
    evaluator = state.evaluator
    density = evaluator.refitted_density if evaluator.residuals.are_refitted(terms) else evaluator.density
    is_noise, criterion = evaluator.residuals.is_noise(terms), evaluator.criterion
    replaces_several = is_noise and len(set(list_ids(state.terms)) - set(list_ids(terms))) > 1
    is_simpler = is_noise and count_parameters(terms) < count_parameters(state.terms)
    replaces = is_simpler or (replaces_several and not state.is_noise)
    replaces = replaces and evaluator.is_tied(terms, state.terms, density)
    if not replaces and evaluator.gain(terms, state.terms, density).p_value <= criterion.p_value:
        share = evaluator.residuals.explained_share(terms, state.terms, above_floor=not (state.is_noise or is_noise))
        least = criterion.explained_share if state.is_noise else criterion.needed_share
        replaces = replaces_several or share > least
    return float(np.sum((density(terms) - density(state.terms))[evaluator.held_out])) if replaces else None


def list_table_models(state: SearchState) -> Iterator[Terms]:
    """Yield models with each form of each table.

    The table takes the place of all effects, or of all of its kind, or is added to the effects that are then still
    needed. If the state leaves only noise, the table needs fewer parameters than the effects, or takes the place of two
    or more of its kind.
    """
    evaluator, start = state.evaluator, state.start
    limit = sum(map(count_term_parameters, state.effects)) if state.is_noise else np.inf
    unexplained = {at for at in evaluator.residuals.joints if not evaluator.residuals.is_noise_at(at, state.terms)}
    joints = unexplained | {at for effect in state.effects for at in list_loads(effect.at)}
    for table in evaluator.tables:
        if table.at and table.at not in joints:
            continue
        of_kind = [effect for effect in state.effects if (effect.kind, effect.at) == (table.kind, table.at)]
        others_of_kind = tuple(term for term in state.terms if term not in of_kind)
        for others in dict.fromkeys((others_of_kind, start, state.terms)):
            fewest = min(map(count_term_parameters, make_variants(evaluator.train, others, table)), default=np.inf)
            replaces_kind = len(of_kind) > 1 and others is others_of_kind
            if fewest >= limit and not replaces_kind:
                continue
            if replaces_kind:
                yield from (trial.terms for trial in refine_variants(evaluator.train, others, table))
            elif (trial := find_best_variant(evaluator, others, table)) is not None:
                yield drop_unneeded(state.with_terms(trial.terms)).terms


def add_beside_table(state: SearchState) -> SearchState:
    """Add effects to a state with a table while each is needed and structure is left.

    No effect is added if another table predicts significantly better, or another form of the same table ties with it.
    """
    evaluator = state.evaluator
    while len(state.effects) <= evaluator.criterion.max_effects and not state.is_noise:
        terms = state.terms
        candidates = screen_effects(evaluator, terms)[: evaluator.criterion.max_tried]
        longer = next((candidate for candidate in candidates if evaluator.is_needed(candidate, terms)), None)
        if longer is None:
            break
        others = [
            find_best_variant(evaluator, terms, table) for table in evaluator.tables if table.id not in list_ids(terms)
        ]
        if any(trial is not None and evaluator.is_significant(trial.terms, longer) for trial in others):
            break
        if any(evaluator.is_tied(finer, longer) for finer in list_table_forms(state)):
            break
        state = state.refit(longer)
    return state


def list_table_forms(state: SearchState) -> list[Terms]:
    """Return the terms of a state with each other form of their table: other numbers of pieces, or a turn."""
    table = get_table(state, state.terms)
    kind = next(kind for kind in state.evaluator.tables if kind.id == table.id)
    trials = refine_variants(state.evaluator.train, remove_term(state.terms, table), kind)
    return [trial.terms for trial in trials if trial.terms[-1] != table]


def drop_unneeded(state: SearchState) -> SearchState:
    """Drop effects that are not needed, the least needed first; a table stays.

    Without a table, effects that leave only noise stay, too.
    """
    evaluator = state.evaluator
    while True:
        effects = remove_table(evaluator, state.terms)[len(state.start) :]
        if len(effects) == len(state.effects) and state.is_noise:
            return state
        smaller = [refit_nonlinear(evaluator, remove_term(state.terms, effect)) for effect in effects]
        unneeded = [model for model in smaller if not evaluator.is_needed(state.terms, model)]
        if not unneeded:
            return state
        state = state.with_terms(min(unneeded, key=evaluator.screening_score))


def remove_table(evaluator: ModelEvaluator, terms: Terms) -> Terms:
    """Return the terms without tables that compete with effects."""
    competing = {table.id for table in evaluator.tables}
    return tuple(term for term in terms if term.id not in competing)


def get_table(state: SearchState, terms: Terms) -> Table:
    """Return the table among the terms after those of the start, which must include one."""
    return next(term for term in terms[len(state.start) :] if isinstance(term, Table))


def find_explaining_law(evaluator: ModelEvaluator, terms: Terms, laws: Iterable[type[Term]]) -> str | None:
    """Return the id of the law that, added to the terms, has the highest held-out density.

    Candidates are laws that are supported and lower the held-out errors of the terms. They explain the share
    `criterion.explained_share` of the residual torque, or are needed, see `ModelEvaluator.is_needed`. Return None
    without candidates.
    """
    residuals, least_share = evaluator.residuals, evaluator.criterion.explained_share
    trials = [find_best_variant(evaluator, terms, law) for law in laws if law.id not in list_ids(terms)]
    models = [
        trial.terms
        for trial in trials
        if trial is not None
        and evaluator.is_supported(trial.terms, terms)
        and (residuals.explained_share(trial.terms, terms) > least_share or evaluator.is_needed(trial.terms, terms))
        and evaluator.lowers_errors(trial.terms, terms)
    ]
    best = max(models, key=lambda longer: float(np.sum(evaluator.density(longer)[evaluator.held_out])), default=None)
    return best[-1].id if best else None


def explain_table(kind: Kind, table: Table) -> Finding:
    """Return a finding of some kind about a table, with its nonlinear parameters."""
    numbers = {name: Quantity(value) for name, value in table.nonlinear_values.items()}
    return Finding(kind, numbers, effects=(table.id,))
