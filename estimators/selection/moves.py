"""Moves of the search: functions from a state of the search to the next state, or None."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimators.decisions.decision import decide
from estimators.decisions.errors import Terms
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
from estimators.selection.evidence import Evidence, Hypothesis
from estimators.selection.policies import ADD, CHANGE_FORM, CONFIRM, KEEP_BASE, NEED, REFIT, SWAP, TIE
from estimators.simulation import multiple_shooting
from estimators.weak_form.nonlinear import list_reset_variants, set_values
from estimators.weak_form.point import Point
from pendulum_env.physics import SIGNIFICANT, NonlinearParameter, Table, Term, find_link, has_link, has_stop
from pendulum_env.physics.terms import count_parameters, list_forms

LINK_SHARE = 0.3  # of the friction, that a link has at first; fits to torque from 0.1, as in the loop, end elsewhere


@dataclass(frozen=True)
class SearchState:
    """Model that the search has reached.

    Attributes:
        evidence: fits and scores of models; with a fitted link, on data with its estimated states.
        start: terms that the search started from.
        terms: terms of the model, those of `start` first.
        table: nonparametric function that replaces effects; None without one.
    """

    evidence: Evidence
    start: Terms
    terms: Terms
    table: Table | None = None

    @property
    def effects(self) -> Terms:
        """Terms that were added to the start."""
        return self.terms[len(self.start) :]

    @property
    def hypothesis(self) -> Hypothesis:
        """Model as one side of a decision, with its estimated link states."""
        return Hypothesis(self.evidence, self.terms, self.evidence.fits.linked)

    @property
    def is_noise(self) -> bool:
        """True if the residual of the model is noise on all data."""
        return self.evidence.residuals.is_noise(self.terms)

    def with_terms(self, terms: Terms) -> SearchState:
        """Return the state with other terms."""
        return replace(self, terms=terms)

    def refit(self, terms: Terms) -> SearchState:
        """Return the state with other terms and refitted nonlinear parameters."""
        return self.with_terms(refit_nonlinear(self.evidence, terms))


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
    evidence, terms = state.evidence, state.terms
    confirmed: list[Terms] = []
    screened = screen_effects(evidence, terms)
    candidates = sorted(screened + release_parameters(evidence, terms), key=evidence.screening_score)
    needs_stop = not has_stop(terms) and evidence.train.layout.predicts_torque and evidence.train.data.contacts > 0
    if needs_stop:  # only a stop explains the torque at contacts
        candidates = list(filter(has_stop, candidates))
    for longer in candidates[: evidence.criterion.max_tried]:
        if confirmed and not evidence.decide(longer, confirmed[0], TIE).passed:
            break
        if not (evidence.decide(longer, terms, ADD).passed and evidence.decide(longer, state.start, KEEP_BASE).passed):
            continue
        longer = refit_nonlinear(evidence, longer)
        evidence.progress(
            f"confirming {', '.join(sorted(form[0] for form in list_forms(longer) - list_forms(terms)))}", 0.9
        )
        if has_link(longer) and not has_link(terms) and evidence.train.layout.predicts_torque:
            if not confirmed and (linked := add_link(state, longer)) is not None:
                return leave_limits(state, linked)
        elif any(evidence.decide(longer, terms, policy).passed for policy in (CONFIRM, CHANGE_FORM)):
            confirmed.append(longer)
    if confirmed or needs_stop:
        return state.with_terms(min(confirmed, key=count_parameters)) if confirmed else None
    return add_pair(state, screened[: evidence.criterion.beam]) or add_dry_friction(state)


def add_pair(state: SearchState, firsts: Sequence[Terms]) -> SearchState | None:
    """Add two effects of a joint that explain the residual only together; None if no pair is confirmed.

    A pair is supported over the terms, significant over each of its effects alone, and lowers the held-out errors. The
    best prediction is taken. `firsts` are the terms of the state plus each first effect to try; links are left out.
    """
    evidence, terms, pairs = state.evidence, state.terms, list[Terms]()
    is_full = len(state.effects) + 2 > evidence.criterion.max_effects
    if is_full or state.is_noise or not evidence.train.layout.has_fast_fits:
        return None
    for first in (model for model in firsts if not has_link(model)):
        elsewhere = [id for id, effect in evidence.library.items() if effect.at != first[-1].at]
        for pair in [model for model in screen_effects(evidence, first, elsewhere) if not has_link(model)][:1]:
            singles = [evidence.fits.release_known(single) for single in (first, (*terms, pair[-1]))]
            if (
                evidence.decide(pair, terms, ADD).passed
                and evidence.decide(pair, state.start, KEEP_BASE).passed
                and all(evidence.decide(pair, single, SWAP).passed for single in singles)
                and evidence.decide(pair, terms, CONFIRM).passed
            ):
                pairs.append(refit_nonlinear(evidence, pair))
    return state.with_terms(min(pairs, key=evidence.screening_score)) if pairs else None


def add_dry_friction(state: SearchState) -> SearchState | None:
    """Add an effect of dry friction that only free motion shows; None if none is confirmed.

    If it leaves a misfit to the motion, it must explain more than `criterion.needed_share`.
    """
    evidence, terms = state.evidence, state.terms
    for longer in screen_dry_friction(evidence, terms)[: evidence.criterion.beam]:
        is_misfit = evidence.motion.is_misfit(evidence.fits.refit_to_motion(evidence.fits.fit(longer)))
        policy = NEED if is_misfit else ADD
        if evidence.decide(longer, terms, policy).passed and evidence.decide(longer, terms, CONFIRM).passed:
            return state.with_terms(longer)
    return None


def add_link(state: SearchState, longer: Terms) -> SearchState | None:
    """Add the link in `longer` with estimated states; None if it is not confirmed.

    If structure is left, friction of the link is tried, then the other kind of link, and each kind with one more
    effect. The least held-out cost decides: only estimated states show which kind of link fits.
    """
    evidence, terms = state.evidence, state.terms
    linked = fit_link_states(state, longer)
    if linked is None or linked.is_noise:
        return linked
    linked = try_link_friction(state, linked)
    if linked.is_noise:
        return linked
    kinds = [kind for kind in evidence.library.values() if kind.link and kind.id != longer[-1].id]
    trials = [
        trial.terms for trial in (find_best_variant(evidence, terms, kind) for kind in kinds) if trial is not None
    ]
    for alone in (longer, *trials):
        trials += [
            larger for larger in screen_effects(evidence, alone)[:1] if evidence.decide(larger, alone, SWAP).passed
        ]
    others = [fit_link_states(state, trial) for trial in trials]
    states = [linked, *(alternative for alternative in others if alternative is not None)]
    return choose_state(states)


def choose_state(states: Sequence[SearchState]) -> SearchState:
    """Return the first of some states with a fitted link, replaced by each later one that is better."""
    best, *others = states
    for other in others:
        best = other if decide(other.hypothesis, best.hypothesis, REFIT).passed else best
    return best


def leave_limits(state: SearchState, found: SearchState) -> SearchState:
    """Return `found`, a state with a fitted link, or another fit if parameters of its link may be at lower limits.

    A limit is no evidence. A play without a gap is an elastic joint, which replaces it if confirmed. Other parameters
    start again from their upper limits, for example all weight at the link; the lower held-out cost decides.
    """
    link, linked = find_link(found.terms), found.evidence.fits.linked
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
        if other is not None and (reductions or decide(other.hypothesis, found.hypothesis, REFIT).passed):
            return other
    return found


def try_link_friction(state: SearchState, found: SearchState) -> SearchState:
    """Return `found`, a state with a fitted link, with friction of the link; `found` if it does not lower the cost.

    Insignificant parts of the friction, dry or viscous, are removed.
    """
    assert found.evidence.fits.linked is not None
    point = multiple_shooting.add_link_friction(Point.from_model(found.evidence.fits.linked.model), LINK_SHARE)
    while released := [parameter for parameter in point.terms[-1].free if parameter.nominal is not None]:
        longer = fit_link_states(state, point.terms)
        if longer is None or not decide(longer.hypothesis, found.hypothesis, REFIT).passed:
            break
        link, linked = longer.terms[-1], longer.evidence.fits.linked
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
    """Return the state with a fitted link, the last of `longer`, and an evidence with the link's estimated states.

    None if no fit is confirmed, or if its held-out cost is not below that of the smaller model refitted to the motion.
    """
    evidence = state.evidence
    step, before = evidence.fits.fit(longer, added=longer[-1].id), evidence.fits.fit(state.terms)
    evidence.progress(f"fitting the states of {step.added}", 0.9)
    refitted = evidence.fits.make_step(
        multiple_shooting.estimate(evidence.train.data.windows, step.model), added=step.added
    )
    confirmed = [fitted for fitted in (refitted, step) if evidence.decide(fitted, before, CONFIRM).passed]
    if not confirmed or not evidence.decide(confirmed[0], evidence.fits.refit_to_motion(before), REFIT).passed:
        return None
    linked = confirmed[-1] if evidence.decide(confirmed[-1], confirmed[0], REFIT).passed else confirmed[0]
    return replace(state, evidence=evidence.with_fits(evidence.fits.with_link(linked)), terms=linked.model.terms)


def revise(state: SearchState) -> SearchState:
    """Drop and swap effects, and refit nonlinear parameters, until neither move changes the state."""
    for _ in range(2 * state.evidence.criterion.max_effects):
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
        refine_parameters(state.evidence, tuple(variant if term is effect else term for term in terms), variant.id)
        for effect in state.effects
        for variant in (*list_reset_variants(effect), *list_simpler_parts(state.evidence, effect))
    ]
    smaller = [*(remove_term(terms, effect) for effect in state.effects), *tighter]
    smaller.sort(key=state.evidence.screening_score)
    unneeded = (model for model in smaller if not state.evidence.decide(terms, model, ADD).passed)
    return next(map(state.with_terms, unneeded), None)


def swap_effect(state: SearchState) -> SearchState | None:
    """Replace one of several effects, the least needed first, by its best competitor, if significantly better."""
    if len(state.effects) < 2:
        return None
    evidence = state.evidence
    smaller = [remove_term(state.terms, effect) for effect in state.effects]
    for others in sorted(smaller, key=evidence.screening_score):
        effect = next(term for term in state.terms if term not in others)
        for competitor in screen_replacements(evidence, state.terms, effect)[:1]:
            if evidence.decide(competitor, state.terms, SWAP).passed:
                return state.with_terms(competitor)
    return None
