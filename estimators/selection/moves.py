"""Moves of the search: functions from a state of the search to the next state, or None."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimators.decisions.errors import Terms, compute_held_out_cost
from estimators.selection.candidates import (
    find_best_variant,
    list_simpler_parts,
    refine_parameters,
    refit_nonlinear,
    release_parameters,
    screen_effects,
    screen_replacements,
)
from estimators.selection.dry_friction import screen_dry_friction
from estimators.selection.evaluator import ModelEvaluator
from estimators.simulation import multiple_shooting
from estimators.weak_form.contacts import count_contacts
from estimators.weak_form.nonlinear import list_reset_variants, set_values
from estimators.weak_form.point import Point
from pendulum_env.physics import SIGNIFICANT, NonlinearParameter, Table, Term, find_link, has_link, has_stop, list_ids
from pendulum_env.physics.terms import count_parameters, list_forms

LINK_SHARE = 0.3  # of the friction, that a link has at first; fits to torque from 0.1, as in the loop, end elsewhere


@dataclass(frozen=True)
class SearchState:
    """Model that the search has reached.

    Attributes:
        evaluator: fits and scores of models; with a fitted link, on data with its estimated states.
        start: terms that the search started from.
        terms: terms of the model, those of `start` first.
        table: nonparametric function that replaces effects; None without one.
    """

    evaluator: ModelEvaluator
    start: Terms
    terms: Terms
    table: Table | None = None

    @property
    def effects(self) -> Terms:
        """Terms that were added to the start."""
        return self.terms[len(self.start) :]

    @property
    def is_noise(self) -> bool:
        """True if the residual of the model is noise on all data."""
        return self.evaluator.residuals.is_noise(self.terms)

    def with_terms(self, terms: Terms) -> SearchState:
        """Return the state with other terms."""
        return replace(self, terms=terms)

    def refit(self, terms: Terms) -> SearchState:
        """Return the state with other terms and refitted nonlinear parameters."""
        return self.with_terms(refit_nonlinear(self.evaluator, terms))


def remove_term(terms: Terms, term: Term) -> Terms:
    """Return the terms without one of them."""
    return tuple(other for other in terms if other is not term)


def add_effect(state: SearchState) -> SearchState | None:
    """Add one effect, or release a nonlinear parameter of an effect; else add a pair; None if none is confirmed.

    The best `criterion.max_tried` candidates must be supported and confirmed, and keep the base parameters of the
    start. Of those that tie with the best one, the one with the fewest parameters is added. A link that comes before
    any other is added by `add_link`. Without a pair, `add_dry_friction` follows. In data with contacts, a stop comes
    first.
    """
    evaluator, terms = state.evaluator, state.terms
    confirmed: list[Terms] = []
    screened = screen_effects(evaluator, terms)
    candidates = sorted(screened + release_parameters(evaluator, terms), key=evaluator.screening_score)
    needs_stop = (
        not has_stop(terms) and evaluator.train.layout.predicts_torque and count_contacts(evaluator.train.data) > 0
    )
    if needs_stop:  # only a stop explains the torque at contacts
        candidates = list(filter(has_stop, candidates))
    for longer in candidates[: evaluator.criterion.max_tried]:
        if confirmed and not evaluator.is_tied(longer, confirmed[0]):
            break
        if not (evaluator.is_supported(longer, terms) and evaluator.keeps_base(longer, state.start)):
            continue
        longer = refit_nonlinear(evaluator, longer)
        evaluator.progress(
            f"confirming {', '.join(sorted(form[0] for form in list_forms(longer) - list_forms(terms)))}", 0.9
        )
        if has_link(longer) and not has_link(terms) and evaluator.train.layout.predicts_torque:
            if not confirmed and (linked := add_link(state, longer)) is not None:
                return leave_limits(state, linked)
        elif evaluator.lowers_errors(longer, terms) or improves_form(evaluator, longer, terms):
            confirmed.append(longer)
    if confirmed or needs_stop:
        return state.with_terms(min(confirmed, key=count_parameters)) if confirmed else None
    return add_pair(state, screened[: evaluator.criterion.beam]) or add_dry_friction(state)


def improves_form(evaluator: ModelEvaluator, longer: Terms, terms: Terms) -> bool:
    """Return whether `longer` differs from `terms` only in the form of one effect, and improves the prediction.

    The form must lower the held-out torque error; the effect must lower all held-out errors.
    """
    ids = {id for id, *_ in list_forms(longer) ^ list_forms(terms)}
    if list_ids(longer) != list_ids(terms) or len(ids) != 1 or not evaluator.train.layout.predicts_torque:
        return False
    (effect,) = (term for term in longer if term.id in ids)
    after, before = (evaluator.fit(model).errors["holdout"].get_joint_error(effect.at) for model in (longer, terms))
    return after < before and evaluator.lowers_errors(longer, remove_term(longer, effect))


def add_pair(state: SearchState, firsts: Sequence[Terms]) -> SearchState | None:
    """Add two effects of a joint that explain the residual only together; None if no pair is confirmed.

    A pair is supported over the terms, significant over each of its effects alone, and lowers the held-out errors. The
    best prediction is taken. `firsts` are the terms of the state plus each first effect to try; links are left out.
    """
    evaluator, terms, pairs = state.evaluator, state.terms, list[Terms]()
    is_full = len(state.effects) + 2 > evaluator.criterion.max_effects
    if is_full or state.is_noise or not evaluator.train.layout.has_fast_fits:
        return None
    for first in (model for model in firsts if not has_link(model)):
        elsewhere = [id for id, effect in evaluator.library.items() if effect.at != first[-1].at]
        for pair in [model for model in screen_effects(evaluator, first, elsewhere) if not has_link(model)][:1]:
            singles = [evaluator.release_known(single) for single in (first, (*terms, pair[-1]))]
            if (
                evaluator.is_supported(pair, terms)
                and evaluator.keeps_base(pair, state.start)
                and all(evaluator.is_significant(pair, single) for single in singles)
                and evaluator.lowers_errors(pair, terms)
            ):
                pairs.append(refit_nonlinear(evaluator, pair))
    return state.with_terms(min(pairs, key=evaluator.screening_score)) if pairs else None


def add_dry_friction(state: SearchState) -> SearchState | None:
    """Add an effect of dry friction that only free motion shows; None if none is confirmed.

    If it leaves a misfit to the motion, it must explain more than `criterion.needed_share`.
    """
    evaluator, terms = state.evaluator, state.terms
    for longer in screen_dry_friction(evaluator, terms)[: evaluator.criterion.beam]:
        is_misfit = evaluator.is_misfit(evaluator.refit_to_motion(evaluator.fit(longer)))
        is_enough = evaluator.is_needed if is_misfit else evaluator.is_supported
        if is_enough(longer, terms) and evaluator.lowers_errors(longer, terms):
            return state.with_terms(longer)
    return None


def add_link(state: SearchState, longer: Terms) -> SearchState | None:
    """Add the link in `longer` with estimated states; None if it is not confirmed.

    If structure is left, friction of the link is tried, then the other kind of link, and each kind with one more
    effect. The least held-out cost decides: only estimated states show which kind of link fits.
    """
    evaluator, terms = state.evaluator, state.terms
    linked = fit_link_states(state, longer)
    if linked is None or linked.is_noise:
        return linked
    linked = try_link_friction(state, linked)
    if linked.is_noise:
        return linked
    kinds = [kind for kind in evaluator.library.values() if kind.link and kind.id != longer[-1].id]
    trials = [
        trial.terms for trial in (find_best_variant(evaluator, terms, kind) for kind in kinds) if trial is not None
    ]
    for alone in (longer, *trials):
        trials += [larger for larger in screen_effects(evaluator, alone)[:1] if evaluator.is_significant(larger, alone)]
    others = [fit_link_states(state, trial) for trial in trials]
    states = [linked, *(alternative for alternative in others if alternative is not None)]
    return min(states, key=lambda candidate: candidate.evaluator.cost_with_link)


def leave_limits(state: SearchState, found: SearchState) -> SearchState:
    """Return `found`, a state with a fitted link, or another fit if parameters of its link may be at lower limits.

    A limit is no evidence. A play without a gap is an elastic joint, which replaces it if confirmed. Other parameters
    start again from their upper limits, for example all weight at the link; the lower held-out cost decides.
    """
    link, linked = find_link(found.terms), found.evaluator.linked
    estimates = {} if linked is None else linked.model.estimates

    def is_at_limit(parameter: NonlinearParameter, errors: float = 0.0) -> bool:
        estimate, value = estimates.get(link.get_full_name(parameter.name)), link.nonlinear_values[parameter.name]
        return bool(value <= parameter.low + (errors * estimate.std if estimate is not None else 0.0))

    names = {parameter.name for parameter in link.free if is_at_limit(parameter)}
    reductions = [reduced for reduced in link.reductions if names - reduced.nonlinear_values.keys()]
    unsure = [parameter for parameter in link.free if is_at_limit(parameter, SIGNIFICANT)]
    if not (reductions or unsure):
        return found
    theta = {name: estimate.value for name, estimate in estimates.items()}
    restart = set_values(link, unsure, [parameter.high for parameter in unsure]).bind(theta)
    for start in reductions or [restart]:
        other = fit_link_states(state, tuple(start if term is link else term for term in found.terms))
        is_less = other is not None and other.evaluator.cost_with_link < found.evaluator.cost_with_link
        if other is not None and (reductions or is_less):
            return other
    return found


def try_link_friction(state: SearchState, found: SearchState) -> SearchState:
    """Return `found`, a state with a fitted link, with friction of the link; `found` if it does not lower the cost.

    Insignificant parts of the friction, dry or viscous, are removed.
    """
    assert found.evaluator.linked is not None
    point = multiple_shooting.add_link_friction(Point.from_model(found.evaluator.linked.model), LINK_SHARE)
    while released := [parameter for parameter in point.terms[-1].free if parameter.nominal is not None]:
        longer = fit_link_states(state, point.terms)
        if longer is None or longer.evaluator.cost_with_link >= found.evaluator.cost_with_link:
            break
        link, linked = longer.terms[-1], longer.evaluator.linked
        assert linked is not None
        estimates = [linked.model.estimates.get(link.get_full_name(parameter.name)) for parameter in released]
        needless = [  # a part that ended at zero has no estimate
            parameter
            for parameter, estimate in zip(released, estimates, strict=True)
            if estimate is None or not estimate.is_significant
        ]
        if not needless:
            return longer
        point = point._replace(terms=(*longer.terms[:-1], set_values(link, needless, [0.0] * len(needless))))
    return found


def fit_link_states(state: SearchState, longer: Terms) -> SearchState | None:
    """Return the state with a fitted link, the last of `longer`, and an evaluator with the link's estimated states.

    None if no fit is confirmed, or if its held-out cost is not below that of the smaller model refitted to the motion.
    """
    evaluator = state.evaluator
    step, before = evaluator.fit(longer, added=longer[-1].id), evaluator.fit(state.terms)
    evaluator.progress(f"fitting the states of {step.added}", 0.9)
    refitted = evaluator.make_step(
        multiple_shooting.estimate(evaluator.train.data.windows, step.model), added=step.added
    )
    confirmed = [fitted for fitted in (refitted, step) if evaluator.is_confirmed(fitted, before)]
    if not confirmed or compute_held_out_cost(confirmed[0]) >= compute_held_out_cost(evaluator.refit_to_motion(before)):
        return None
    linked = min(confirmed, key=compute_held_out_cost)
    return replace(state, evaluator=evaluator.with_link(linked), terms=linked.model.terms)


def revise(state: SearchState) -> SearchState:
    """Drop and swap effects, and refit nonlinear parameters, until neither move changes the state."""
    for _ in range(2 * state.evaluator.criterion.max_effects):
        revision = drop_effect(state) or swap_effect(state)
        if revision is None:
            break
        state = revision.refit(revision.terms)
    return state


def drop_effect(state: SearchState) -> SearchState | None:
    """Replace the terms by the best smaller model over which they are not supported; None if they always are.

    A smaller model lacks an effect, has a released nonlinear parameter at its default, or has a simpler part of an
    effect (`list_simpler_parts`).
    """
    terms = state.terms
    tighter = [
        refine_parameters(state.evaluator, tuple(variant if term is effect else term for term in terms), variant.id)
        for effect in state.effects
        for variant in (*list_reset_variants(effect), *list_simpler_parts(state.evaluator, effect))
    ]
    smaller = [*(remove_term(terms, effect) for effect in state.effects), *tighter]
    smaller.sort(key=state.evaluator.screening_score)
    unneeded = (model for model in smaller if not state.evaluator.is_supported(terms, model))
    return next(map(state.with_terms, unneeded), None)


def swap_effect(state: SearchState) -> SearchState | None:
    """Replace one of several effects, the least needed first, by its best competitor, if significantly better."""
    if len(state.effects) < 2:
        return None
    evaluator = state.evaluator
    smaller = [remove_term(state.terms, effect) for effect in state.effects]
    for others in sorted(smaller, key=evaluator.screening_score):
        effect = next(term for term in state.terms if term not in others)
        for competitor in screen_replacements(evaluator, state.terms, effect)[:1]:
            if evaluator.is_significant(competitor, state.terms):
                return state.with_terms(competitor)
    return None
