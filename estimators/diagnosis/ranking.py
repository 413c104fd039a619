"""Verdicts on each effect of the library, and groups of effects that the data cannot distinguish."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from estimators.decisions.decision import Decision
from estimators.decisions.errors import ErrorFall, Step, Terms, compute_error_fall, get_error_at
from estimators.decisions.gate import FailedGates, Gate, explain_rejection
from estimators.diagnosis.result import Candidate
from estimators.diagnosis.small_effect import select_small_effect
from estimators.diagnosis.untested import UntestedRange, find_untested_range
from estimators.findings import Finding, Verdict
from estimators.selection.candidates import can_reproduce, needs_all_parts, screen_library, screen_replacements
from estimators.selection.evidence import Evidence
from estimators.selection.policies import ADD, CONFIRM, DETERMINE_LAG, EXCITE, FOLLOW_MOTION, NEED, REPLACE, SWAP, Rule
from estimators.selection.search import SearchResult
from estimators.selection.state import remove_term
from estimators.selection.tables import ExplainingTable, remove_table
from estimators.weak_form.contacts import count_contacts
from pendulum_env.physics import Model, Term, is_hidden


@dataclass(frozen=True)
class Tie(Finding):
    """Effects that look the same in these data, the selected one first."""

    effects: tuple[str, ...]


@dataclass(frozen=True)
class Imitation(Finding):
    """Effect that imitates another `effect` or term in these data; without an id, several others explain more."""

    effect: str = ""


def rank_effects(
    result: SearchResult, final: Terms, doubts: Sequence[Finding] = (), has_contacts: bool = False
) -> tuple[list[Candidate], list[tuple[str, ...]]]:
    """Return the verdict on each effect of the library, in the order of `Verdict`, and groups of indistinguishable ids.

    Selected effects are compared with the table of the search in the model, others without. The selected effect comes
    first in its group.

    Args:
        result: result of the search; its last step may be refitted.
        final: terms of the final model, see `Trial.terms`.
        doubts: findings on effects that imitate a term of the model, which are not rejected.
        has_contacts: whether contacts with a stop were tried, which tests the ends of the range.
    """
    verdicts: dict[str, Candidate] = {}
    groups: list[tuple[str, ...]] = []
    for before, after in pairwise(result.steps):
        chosen, *tied = _rank_selected(result, final, before, after)
        verdicts.update({candidate.effect: candidate for candidate in (chosen, *tied)})
        if tied:
            groups.append(tuple(candidate.effect for candidate in (chosen, *tied)))
    library = screen_library(result.evidence, final)
    screened_models = [screened.terms for screened in library.values() if screened.terms is not None]
    for longer in sorted(screened_models, key=result.evidence.screening_score):
        if longer[-1].id not in verdicts:
            verdicts[longer[-1].id] = _rank_other(result, longer, has_contacts)
    for id, (_, decision) in sorted(library.items()):
        if id not in verdicts:
            untested = _find_untested_range(result.evidence, result.evidence.library[id], has_contacts)
            reason = untested or explain_rejection(decision.gates) or Imitation()
            verdict = Verdict.REJECTED if untested is None else Verdict.NOT_EXCITED
            verdicts[id] = Candidate(id, 0.0, verdict, 1.0, reason, decision=decision)
    for id, imitated in (doubt.rivals for doubt in doubts if doubt.rivals is not None):
        if id in verdicts and verdicts[id].verdict is Verdict.REJECTED:
            demoted = replace(verdicts.pop(id), verdict=Verdict.NOT_EXCITED, reason=Imitation(imitated))
            verdicts[id] = demoted
    order = list(Verdict)
    return sorted(verdicts.values(), key=lambda candidate: (order.index(candidate.verdict), -candidate.score)), groups


def widen_by_rivals(model: Model, evidence: Evidence, candidates: Sequence[Candidate]) -> Model:
    """Add the error of the choice among effects to the standard errors of a model.

    Rivals of the model have another effect that the data cannot distinguish, or a further effect that predicts better
    and is too small. The variance of each parameter that the models share grows by the squared difference of a rival's
    estimate, times the probability of the rival.
    """
    chosen = {candidate.effect: candidate for candidate in candidates if candidate.verdict is Verdict.SELECTED}
    rivals = list[tuple[Terms, Terms, float]]()  # terms of the model and of its rival, and probability of the rival
    for rival in candidates:
        if isinstance(tie := rival.reason, Tie) and (selected := chosen[tie.effects[0]]).score:
            rivals.append((selected.terms, rival.terms, rival.score / selected.score))
    if (small := select_small_effect(candidates)) is not None and small.gain is not None:
        rivals.append((small.terms[:-1], small.terms, 1.0 - small.gain.p_value))
    changes = list[dict[str, float]]()
    for *models, probability in rivals:
        own, other = (evidence.fits.fit_model(terms).estimates for terms in models)
        root = float(np.sqrt(probability))
        changes.append({name: root * (other[name].value - own[name].value) for name in own.keys() & other.keys()})
    return model.add_errors(*changes)


def _rank_selected(result: SearchResult, final: Terms, before: Step, after: Step) -> list[Candidate]:
    """Return the verdicts on the effect added from `before` to `after`, then on effects that tie with it.

    The score is the probability of the effect, or of its group, times the explained share of the residual of the other
    terms, since an unknown law may cause the rest; it is at most `Criterion.max_score`. Effects with hidden states have
    no competitors, since the motion has decided; nor has a stop in data with contacts.
    """
    evidence = result.evidence
    final = (*final, result.table) if result.table is not None else final
    term = next(term for term in final if term.id == after.added)
    others = remove_term(final, term)
    is_met = term.has_impacts and evidence.train.layout.predicts_torque and count_contacts(evidence.train.data) > 0
    odds = {term.id: 1.0} if is_hidden(term) or is_met else compute_alternatives(evidence, final, term)
    share = 1.0 if evidence.residuals.is_noise(final) else max(0.0, evidence.shares.compute(final, others))
    rivals = {rival[-1].id: rival for rival in screen_replacements(evidence, final, term)} if len(odds) > 1 else {}
    least = evidence.criterion.tie_probability
    tied = sorted((id for id in odds if id != term.id and odds[id] > least), key=lambda id: -odds[id])
    score = evidence.criterion.max_score * share
    if evidence.train.segments or before.errors["holdout"].is_of_motion:
        error_with, error_without = (step.errors["holdout"].get_joint_error(term.at) for step in (after, before))
        reason = compute_error_fall(before, after)
    else:  # without a simulation
        error_with, error_without = (_compute_held_out_rms(evidence, terms, term.at) for terms in (final, others))
        reason = ErrorFall(joint=term.at, ratio=error_with / error_without)
    confirmed = evidence.decide(after, before, CONFIRM)
    decision = confirmed if is_hidden(term) else decide_finally(evidence, final, others).join(confirmed)
    best_gain = None if is_hidden(term) else evidence.best_gain(final, others)
    n_compared = 1 if is_hidden(term) else evidence.count_compared_variants(final, others)
    ratio, total = error_with / error_without, score * sum(odds[id] for id in (term.id, *tied))
    found_tied = []
    for id in tied:
        tie = Decision((Gate("tie_probability", odds[id], least, True),))
        of_rival = decide_finally(evidence, rivals[id], others).join(tie)
        gain, variants = evidence.best_gain(rivals[id], others), evidence.count_compared_variants(rivals[id], others)
        ties = Tie((term.id, id))
        found_tied.append(
            Candidate(id, score * odds[id], Verdict.AMBIGUOUS, ratio, ties, gain, variants, of_rival, rivals[id])
        )
    selected = Candidate(term.id, total, Verdict.SELECTED, ratio, reason, best_gain, n_compared, decision, final)
    return [selected, *found_tied]


def _rank_other(result: SearchResult, longer: Terms, has_contacts: bool) -> Candidate:
    """Return the verdict on the last of some terms, an effect that the final model lacks, in its best variant.

    The score is half of the probability of a gain. An effect is not excited if its range was not tested or its torque
    is too small; but if a term of the model contains it, it is rejected. Other effects are rejected, by their gates.
    """
    evidence, (*other_terms, term) = result.evidence, longer
    others = tuple(other_terms)
    gain, variants = evidence.best_gain(longer, others), evidence.count_compared_variants(longer, others)
    ratio = _compute_error_ratio(evidence, longer, others, term.at)
    decision = decide_finally(evidence, longer, others)
    if decision.passed and not evidence.residuals.is_noise(longer):
        decision = decide_finally(evidence, longer, others, NEED)
    untested, verdict = _find_untested_range(evidence, type(term), has_contacts), Verdict.NOT_EXCITED
    reason: Finding
    if untested is not None and not evidence.decide(longer, others, SWAP).passed:
        reason = untested
    elif not (excited := evidence.decide(longer, others, EXCITE)).passed:
        reason, decision = FailedGates(excited.gates), excited
        if containing := [other.id for other in others if can_reproduce(evidence, other, term)]:
            verdict, reason = Verdict.REJECTED, Imitation(containing[0])
    else:
        verdict, decision = Verdict.REJECTED, excited.join(decision)
        if decision.passed:
            step = evidence.fits.fit_with_std(longer, added=term.id)
            decision = decision.join(evidence.decide(step, result.steps[-1], CONFIRM))
        selected = [step.added for step in result.steps if step.added is not None]
        reason = explain_rejection(decision.gates, selected) or Imitation()
        verdict = Verdict.NOT_EXCITED if "frequencies" in [gate.name for gate in decision.gates] else verdict
        if result.table is not None and term.kind == result.table.kind:
            reason = ExplainingTable.from_table(result.table)
    return Candidate(term.id, 0.5 * (1 - gain.p_value), verdict, ratio, reason, gain, variants, decision, longer)


def _find_untested_range(evidence: Evidence, kind: type[Term], has_contacts: bool) -> UntestedRange | None:
    """Return the finding on the range of an effect beyond which no motion went; None without any."""
    if has_contacts:
        return None
    return find_untested_range(kind(), *evidence.train.get_range(kind.at), evidence.train.units(kind.at))


def decide_finally(evidence: Evidence, after: Terms, before: Terms, policy: Rule = ADD) -> Decision:
    """Return the decision of the search on a larger model, then that on its lag or delay in a closed loop."""
    decision = evidence.decide(after, before, policy)
    return decision.join(evidence.decide(after, before, DETERMINE_LAG)) if decision.passed else decision


def _compute_error_ratio(evidence: Evidence, after: Terms, before: Terms, at: str) -> float:
    """Return the held-out error at a joint over that of other terms; 1 if both are zero."""
    new, old = (_compute_held_out_rms(evidence, terms, at) for terms in (after, before))
    return new / old if old > 0 else 1.0


def _compute_held_out_rms(evidence: Evidence, terms: Terms, at: str) -> float:
    """Return the held-out RMS torque error, at the joints of a place, of the terms fitted to training data [N m]."""
    error = evidence.holdout.equations(terms, by_noise=True).error(evidence.train.solve(terms))
    return get_error_at(evidence.holdout.layout.compute_joint_errors(error), at, np.nan)


def compute_alternatives(evidence: Evidence, terms: Terms, term: Term) -> dict[str, float]:
    """Return the probability that the model with each effect, by id, in the place of `term` has the highest density.

    The bootstrap redraws the blocks of data. The first entry is `term` itself.

    Excluded are laws that contain the term, laws with a sufficient simpler part, and likely laws that
    `can_replace` refuses.
    """
    others = tuple(other for other in terms if other is not term)
    rivals = [
        rival
        for rival in screen_replacements(evidence, terms, term)
        if not can_reproduce(evidence, rival[-1], term) and needs_all_parts(evidence, rival)
    ]
    decisions, least = dict[Terms, bool](), evidence.criterion.tie_probability
    while True:
        odds = evidence.densities.bootstrap.probabilities(
            [evidence.densities.compute(model) for model in (terms, *rivals)]
        )
        likely = [rival for rival, share in zip(rivals, odds[1:], strict=True) if share > least]
        decisions |= {rival: can_replace(evidence, rival, terms, others) for rival in likely if rival not in decisions}
        refuted = [rival for rival in likely if not decisions[rival]]
        if not refuted:
            return dict(zip((term.id, *(rival[-1].id for rival in rivals)), odds.tolist(), strict=True))
        rivals = [rival for rival in rivals if rival not in refuted]


def can_replace(evidence: Evidence, rival: Terms, terms: Terms, others: Terms) -> bool:
    """Return whether a rival of `terms` keeps the base of the `others` and lowers their held-out errors.

    In addition, `terms` must not follow the motion significantly better. Tables are removed from all models.
    """
    rival, terms, others = (remove_table(evidence, model) for model in (rival, terms, others))
    return evidence.decide(rival, others, REPLACE).passed and evidence.decide(rival, terms, FOLLOW_MOTION).passed
