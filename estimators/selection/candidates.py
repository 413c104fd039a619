"""Candidate models: the terms of a model with the best variant of a further effect."""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from estimators.data.variants import rank_variants, refine_variants, try_variants
from estimators.decisions.decision import NOTHING_TESTED, Decision
from estimators.decisions.errors import Step, Terms
from estimators.decisions.gate import Gate
from estimators.memoize import memoized
from estimators.progress import Screened
from estimators.search_hints import find_hints, is_possible
from estimators.selection.evidence import Evidence
from estimators.selection.policies import ADD, KEEP_BASE, SWAP
from estimators.weak_form.nonlinear import list_continuous_parameters, list_released_variants, set_values
from estimators.weak_form.rows import ScoredTerms
from estimators.weak_form.torque_windows import find_largest_sizes
from pendulum_env.physics import Term, count_term_parameters, has_transmission, list_ids
from pendulum_env.physics.effect_texts import name_effect

SAME = 1e-6  # relative difference of equal torques by rounding


class Screening(NamedTuple):
    """Result of screening one effect: the model with it, or None and the decision that excludes the effect."""

    terms: Terms | None
    decision: Decision = NOTHING_TESTED


def screen_effects(evidence: Evidence, terms: Terms, excluded: Collection[str] = ()) -> list[Terms]:
    """Return the terms plus the best variant of each further possible effect, the best prediction first."""
    library = screen_library(evidence, terms, excluded).values()
    return sorted((screened.terms for screened in library if screened.terms is not None), key=evidence.screening_score)


@memoized
def screen_library(evidence: Evidence, terms: Terms, excluded: Collection[str] = ()) -> dict[str, Screening]:
    """Screen each effect of the library that the terms lack, by id; slow transmissions come last."""
    missing = [effect for id, effect in evidence.library.items() if id not in list_ids(terms) | {*excluded}]
    missing.sort(key=lambda effect: effect.kind == "transmission")
    screened: dict[str, Screening] = {}
    for n_done, effect in enumerate(missing):
        gate = _make_transmission_gate(evidence, terms, screened) if effect.kind == "transmission" else None
        if gate is not None:
            screened[effect.id] = Screening(None, Decision((gate,)))
            continue
        text = f"effect {n_done + 1} of {len(missing)}, {name_effect(effect.id)}"
        evidence.progress(text, n_done / len(missing))
        if (trial := screen_effect(evidence, terms, effect)) is None:
            screened[effect.id] = Screening(None, Decision((Gate("variants", 0, 1, False),)))
        else:
            possible = Decision(tuple(evidence.fits.find_violations(trial.terms)))
            screened[effect.id] = Screening(trial.terms if possible.passed else None, possible)
            evidence.progress(Screened(text, effect.id, trial.fitted_rms), (n_done + 1) / len(missing))
    return screened


def _make_transmission_gate(evidence: Evidence, terms: Terms, screened_effects: dict[str, Screening]) -> Gate | None:
    """Return the failed gate of a transmission that is not tried; None if it is tried.

    It is not tried with another transmission. In a search by torque, it must be the first effect, and the terms must
    not leave only noise, alone or with an effect already in `screened_effects`.
    """
    if has_transmission(terms):
        return Gate("transmissions", 1, 0, False)
    if not evidence.train.layout.predicts_torque:
        return None
    if len(terms) > len(evidence.fits.base):
        return Gate("earlier_effects", len(terms) - len(evidence.fits.base), 0, False)
    for model in (terms, *(screened.terms for screened in screened_effects.values() if screened.terms is not None)):
        if evidence.residuals.is_noise(model):
            limit = evidence.criterion.misfit_ratio
            return Gate("residual_over_noise", evidence.residuals.relative_rms(model), limit, False)
    return None


def screen_effect(evidence: Evidence, terms: Terms, effect: type[Term]) -> ScoredTerms | None:
    """Return the terms with the best variant of an effect; None without variants.

    The best of a coarse grid is refined if it explains at least `criterion.coarse_share` of the residual of the
    training data. Its prediction does not count: a stop near its place predicts worse than none.
    """
    if not find_hints(effect).multimodal:
        ranked = rank_variants(evidence.train, terms, effect)
        if not ranked:
            return None
        is_uniform = (
            len({len(trial.terms[-1].columns) for trial in ranked}) == 1
        )  # else the one with most columns is first
        share = evidence.shares.compute_of_torque(ranked[0].terms, terms, has_holdout=False)
        if is_uniform and share < evidence.criterion.coarse_share:
            return ranked[0]
    return find_best_variant(evidence, terms, effect)


def find_best_variant(
    evidence: Evidence, terms: Terms, effect: type[Term], is_determined: bool = False
) -> ScoredTerms | None:
    """Return the refined variant of an effect with the fewest parameters; None without any variant.

    A variant with more parameters replaces it if it is significantly better, or if it is significant over the terms and
    keeps the base parameters, which the simpler variant loses. With `is_determined`, the data also have to determine
    its parameters.
    """
    trials = refine_variants(evidence.train, terms, effect)
    if not trials:
        return None
    simplest, *others = trials
    for trial in others:
        is_better = evidence.decide(trial.terms, simplest.terms, SWAP).passed or (
            evidence.decide(trial.terms, terms, SWAP).passed
            and not evidence.decide(simplest.terms, terms, KEEP_BASE).passed
            and evidence.decide(trial.terms, terms, KEEP_BASE).passed
        )
        if is_better and is_determined:
            is_better = find_undetermined_parameter(evidence, evidence.fits.fit_with_std(trial.terms)) is None
        simplest = trial if is_better else simplest
    return simplest


def find_undetermined_parameter(evidence: Evidence, step: Step) -> str | None:
    """Return a parameter of a step's last term with a torque that may, within its error, exceed the applied torque."""
    if not evidence.train.layout.predicts_torque:
        return None
    term = step.model.terms[-1]
    sizes = find_largest_sizes(evidence.train.data, term).tolist()
    for column, largest in zip(term.columns, sizes, strict=True):
        estimate = step.model.estimates[column.name]
        if not estimate.is_significant and max(abs(estimate.value), estimate.std) > largest:
            return column.name
    return None


def can_reproduce(evidence: Evidence, larger: Term, term: Term) -> bool:
    """Return whether `larger`, with more parameters, can reproduce any torque of `term` at the same joint."""
    if larger.at != term.at or count_term_parameters(larger) <= count_term_parameters(term) or not term.columns:
        return False
    (part,), (whole,) = evidence.train.maker.columns([term]), evidence.train.maker.columns([larger])
    remaining = part.linear - whole.linear @ np.linalg.lstsq(whole.linear, part.linear, rcond=None)[0]
    return bool(np.linalg.norm(remaining) < SAME * np.linalg.norm(part.linear))


def list_simpler_parts(evidence: Evidence, effect: Term) -> list[Term]:
    """Return the simpler effects of the library that an effect contains, as a spring an offset.

    They have no nonlinear parameters. In rows of simulated motion, they include the laws that the effect becomes where
    a nonlinear parameter is zero, as a play without a gap an elastic joint.
    """
    if effect.kind == "transmission":
        return [] if evidence.train.layout.predicts_torque else _list_reductions(evidence, effect)
    if len(effect.columns) < 2:
        return []
    simple = [kind() for kind in evidence.library.values() if kind.at == effect.at and not kind.nonlinear_parameters]
    return [term for term in simple if can_reproduce(evidence, effect, term)]


def _list_reductions(evidence: Evidence, effect: Term) -> list[Term]:
    """Return the effects of the library that an effect becomes where a parameter is zero, with its other parameters."""
    reductions = []
    for reduced in effect.reductions:
        variants = [kind() for kind in evidence.library.values() if (kind.id, kind.at) == (reduced.id, effect.at)]
        for variant in variants:
            parameters = list_continuous_parameters(variant)
            reductions.append(
                set_values(variant, parameters, [reduced.nonlinear_values[parameter.name] for parameter in parameters])
            )
    return reductions


def needs_all_parts(evidence: Evidence, terms: Terms) -> bool:
    """Return whether the last of some terms is supported over each of its `list_simpler_parts` in its place."""
    *others, effect = terms
    return all(evidence.decide(terms, (*others, part), ADD).passed for part in list_simpler_parts(evidence, effect))


def release_parameters(evidence: Evidence, terms: Terms) -> list[Terms]:
    """Return the terms with one nonlinear parameter of an effect released from its default and refined, one by one.

    Of the values of an integer, only the best is returned; none is tried if fits are slow.
    """
    released_models = []
    for old in terms[len(evidence.fits.base) :]:
        others = tuple(term for term in terms if term is not old)
        for variants in list_released_variants(old):
            if len(variants) > 1:  # of an integer
                variants = [variant for variant in variants if is_possible(variant, evidence.train.motions[old.at])]
                is_tried = variants and evidence.train.layout.has_fast_fits
                trials = try_variants(evidence.train, others, variants) if is_tried else []
                variants = [trial.terms[-1] for trial in sorted(trials, key=lambda trial: trial.fitted_rms)[:1]]
            released = [tuple(new if term is old else term for term in terms) for new in variants]
            released_models += [refine_parameters(evidence, model, old.id) for model in released]
    return released_models


def refine_parameters(evidence: Evidence, terms: Terms, id: str) -> Terms:
    """Return the terms with optimised continuous nonlinear parameters of the term `id`."""
    maker = evidence.train.maker
    return maker.refine(maker.score_terms(terms), id).terms


def refit_nonlinear(evidence: Evidence, terms: Terms) -> Terms:
    """Return the terms with continuous nonlinear parameters optimised, one term after another.

    A link with estimated states keeps its parameters.
    """
    maker = evidence.train.maker
    trial = maker.score_terms(terms)
    for term in terms:
        if any(not parameter.integer for parameter in term.free) and term.id not in evidence.train.data.link_states:
            trial = maker.refine(trial, term.id)
    return maker.fit(trial.terms, exactly=True).terms


def screen_replacements(evidence: Evidence, terms: Terms, term: Term) -> list[Terms]:
    """Return the terms with each other effect of its joint in the place of `term`, the best prediction first.

    Slow transmissions are not tried if the terms leave only noise.
    """
    others = tuple(other for other in terms if other is not term)
    excluded = [id for id, effect in evidence.library.items() if effect.at != term.at]
    if evidence.residuals.is_noise(terms):
        excluded += [id for id, effect in evidence.library.items() if effect.kind == "transmission"]
    return screen_effects(evidence, others, [term.id, *excluded])


def release_significant(evidence: Evidence, terms: Terms) -> Terms:
    """Return the terms with nonlinear parameters released, one by one, while the gain is significant and possible."""
    for looser in sorted(release_parameters(evidence, terms), key=evidence.screening_score):
        if evidence.decide(looser, terms, SWAP).passed and not evidence.fits.find_violations(looser):
            return release_significant(evidence, looser)
    return terms
