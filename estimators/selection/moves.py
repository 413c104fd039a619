"""Moves of the search: each proposes models, decides, and returns the next state, or None."""

from __future__ import annotations

from collections.abc import Iterator

from estimators.decisions.errors import Terms
from estimators.selection.candidates import (
    list_simpler_parts,
    refine_parameters,
    refit_nonlinear,
    release_parameters,
    screen_effects,
    screen_replacements,
)
from estimators.selection.dry_friction import screen_dry_friction
from estimators.selection.links import add_link, leave_limits
from estimators.selection.policies import ADD, CHANGE_FORM, CONFIRM, KEEP_BASE, NEED, SWAP, TIE
from estimators.selection.state import SearchState, remove_term
from estimators.weak_form.nonlinear import list_reset_variants
from pendulum_env.physics import has_link, has_stop
from pendulum_env.physics.effect_texts import name_effects
from pendulum_env.physics.terms import count_parameters, list_forms


def extend_model(state: SearchState) -> SearchState | None:
    """Add an effect; else a pair of effects; else dry friction that only free motion shows; else return None."""
    if (longer := add_effect(state)) is not None or state.needs_stop:
        return longer
    return add_pair(state) or add_dry_friction(state)


def add_effect(state: SearchState) -> SearchState | None:
    """Add the effect, or another form of an effect, with the fewest parameters of those that tie with the best one.

    The best `search.max_tried` proposals are tried. A link that comes before any other is added by `add_link`.
    """
    evidence, confirmed = state.evidence, list[Terms]()
    for longer in propose_additions(state)[: evidence.criterion.search.max_tried]:
        if confirmed and not evidence.decide(longer, confirmed[0], TIE).passed:
            break
        if not (state.accepts(longer, ADD) and evidence.decide(longer, state.start, KEEP_BASE).passed):
            continue
        longer = refit_nonlinear(evidence, longer)
        changed = sorted(form[0] for form in list_forms(longer) - list_forms(state.terms))
        evidence.progress(f"confirming {name_effects(changed)}", 0.9)
        if has_link(longer) and not has_link(state.terms) and evidence.train.layout.predicts_torque:
            if not confirmed and (linked := add_link(state, longer)) is not None:
                return leave_limits(state, linked)
        elif state.accepts(longer, CONFIRM) or state.accepts(longer, CHANGE_FORM):
            confirmed.append(longer)
    return state.with_terms(min(confirmed, key=count_parameters)) if confirmed else None


def propose_additions(state: SearchState) -> list[Terms]:
    """Return the terms with each further effect or released parameter, the best prediction first.

    In data with contacts, a stop comes first.
    """
    evidence, terms = state.evidence, state.terms
    models = screen_effects(evidence, terms) + release_parameters(evidence, terms)
    models.sort(key=evidence.screening_score)
    return list(filter(has_stop, models)) if state.needs_stop else models


def add_pair(state: SearchState) -> SearchState | None:
    """Add two effects of a joint that explain the residual only together, the best prediction of all pairs.

    A pair is supported over the terms, significant over each of its effects alone, and lowers the held-out errors.
    """
    evidence = state.evidence
    pairs = [
        refit_nonlinear(evidence, pair)
        for pair, *singles in propose_pairs(state)
        if state.accepts(pair, ADD)
        and evidence.decide(pair, state.start, KEEP_BASE).passed
        and all(evidence.decide(pair, evidence.fits.release_known(single), SWAP).passed for single in singles)
        and state.accepts(pair, CONFIRM)
    ]
    return state.with_terms(min(pairs, key=evidence.screening_score)) if pairs else None


def propose_pairs(state: SearchState) -> Iterator[tuple[Terms, Terms, Terms]]:
    """Yield the terms with the best second effect beside each of the best first ones, then with each effect alone.

    Links are left out.
    """
    evidence, terms = state.evidence, state.terms
    if not state.has_room(2) or state.is_noise or not evidence.train.layout.has_fast_fits:
        return
    firsts = screen_effects(evidence, terms)[: evidence.criterion.search.n_restarts]
    for first in (model for model in firsts if not has_link(model)):
        elsewhere = [id for id, effect in evidence.library.items() if effect.at != first[-1].at]
        for pair in [model for model in screen_effects(evidence, first, elsewhere) if not has_link(model)][:1]:
            yield pair, first, (*terms, pair[-1])


def add_dry_friction(state: SearchState) -> SearchState | None:
    """Add an effect of dry friction that only free motion shows; None if none is confirmed.

    If it leaves a misfit to the motion, it must explain more than `criterion.needed_share`.
    """
    evidence, fits = state.evidence, state.evidence.fits
    for longer in screen_dry_friction(evidence, state.terms)[: evidence.criterion.search.n_restarts]:
        is_misfit = evidence.motion.is_misfit(fits.refit_to_motion(fits.fit(longer)))
        if state.accepts(longer, NEED if is_misfit else ADD) and state.accepts(longer, CONFIRM):
            return state.with_terms(longer)
    return None


def revise(state: SearchState) -> SearchState:
    """Drop and swap effects, and refit nonlinear parameters, until neither move changes the state."""
    for _ in range(2 * state.evidence.criterion.search.max_effects):
        revision = drop_effect(state) or swap_effect(state)
        if revision is None:
            break
        state = revision.refit(revision.terms)
    return state


def drop_effect(state: SearchState) -> SearchState | None:
    """Replace the terms by the best smaller model over which they are not supported; None if they always are."""
    unneeded = (model for model in propose_reductions(state) if not state.with_terms(model).accepts(state.terms, ADD))
    return next(map(state.with_terms, unneeded), None)


def propose_reductions(state: SearchState) -> list[Terms]:
    """Return the terms without one effect, or with a simpler one, the best prediction first.

    A simpler effect has a released nonlinear parameter at its default, or is a simpler part (`list_simpler_parts`).
    """
    terms = state.terms
    tighter = [
        refine_parameters(state.evidence, tuple(variant if term is effect else term for term in terms), variant.id)
        for effect in state.effects
        for variant in (*list_reset_variants(effect), *list_simpler_parts(state.evidence, effect))
    ]
    smaller = [*(remove_term(terms, effect) for effect in state.effects), *tighter]
    return sorted(smaller, key=state.evidence.screening_score)


def swap_effect(state: SearchState) -> SearchState | None:
    """Replace one of several effects, the least needed first, by its best competitor, if significantly better."""
    better = (model for model in propose_swaps(state) if state.accepts(model, SWAP))
    return next(map(state.with_terms, better), None)


def propose_swaps(state: SearchState) -> Iterator[Terms]:
    """Yield the terms with the best competitor in the place of each effect, the least needed first."""
    smaller = [remove_term(state.terms, effect) for effect in state.effects if len(state.effects) > 1]
    for others in sorted(smaller, key=state.evidence.screening_score):
        effect = next(term for term in state.terms if term not in others)
        yield from screen_replacements(state.evidence, state.terms, effect)[:1]
