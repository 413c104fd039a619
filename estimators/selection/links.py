"""Moves with links: plays and elastic transmissions, whose states are estimated from the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from estimators.decisions.decision import decide
from estimators.decisions.errors import Terms
from estimators.selection.candidates import find_best_variant, screen_effects
from estimators.selection.policies import CONFIRM, REFIT, SWAP
from estimators.selection.state import SearchState
from estimators.simulation import multiple_shooting
from estimators.weak_form.nonlinear import set_values
from estimators.weak_form.point import Point
from pendulum_env.physics import SIGNIFICANT, NonlinearParameter, find_link
from pendulum_env.physics.effect_texts import name_effect

LINK_SHARE = 0.3  # of the friction, that a link has at first; fits to torque from 0.1, as in the loop, end elsewhere


def add_link(state: SearchState, longer: Terms) -> SearchState | None:
    """Add the link in `longer` with estimated states; None if it is not confirmed.

    If structure is left, friction of the link is tried, then the other kind of link, and each kind with one more
    effect. The density of held-out torque decides: only estimated states show which kind of link fits.
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
    start again from their upper limits, for example all weight at the link; `REFIT` decides.
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
    """Return `found`, a state with a fitted link, with friction of the link; `found` if it does not predict better.

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

    None if no fit is confirmed, or if it does not predict better than the smaller model refitted to the motion.
    """
    evidence = state.evidence
    step, before = evidence.fits.fit(longer, added=longer[-1].id), evidence.fits.fit(state.terms)
    evidence.progress(f"fitting the states of {name_effect(longer[-1].id)}", 0.9)
    refitted = evidence.fits.make_step(
        multiple_shooting.estimate(evidence.train.data.windows, step.model), added=step.added
    )
    confirmed = [fitted for fitted in (refitted, step) if evidence.decide(fitted, before, CONFIRM).passed]
    if not confirmed or not evidence.decide(confirmed[0], evidence.fits.refit_to_motion(before), REFIT).passed:
        return None
    linked = confirmed[-1] if evidence.decide(confirmed[-1], confirmed[0], REFIT).passed else confirmed[0]
    return replace(state, evidence=evidence.with_fits(evidence.fits.with_link(linked)), terms=linked.model.terms)
