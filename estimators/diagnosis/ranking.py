"""Verdicts on each effect of the library, and groups of effects that the data cannot distinguish."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from estimators.data.variants import compute_unique_share
from estimators.decisions.errors import Step, Terms, compute_error_fall, get_error_at
from estimators.decisions.gate import Gate, explain_rejection
from estimators.diagnosis.result import Candidate
from estimators.findings import Finding, Kind, Quantity, Verdict
from estimators.selection.candidates import can_reproduce, needs_all_parts, screen_library, screen_replacements
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.moves import remove_term
from estimators.selection.search import SearchResult
from estimators.selection.tables import explain_table, remove_table
from estimators.weak_form.contacts import count_contacts
from pendulum_env.physics import SIGNIFICANT, Term, is_hidden
from pendulum_env.physics.terms import find_untested_ends


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
    library = screen_library(result.evaluator, final)
    screened_models = [screened.terms for screened in library.values() if screened.terms is not None]
    for longer in sorted(screened_models, key=result.evaluator.screening_score):
        if longer[-1].id not in verdicts:
            verdicts[longer[-1].id] = _rank_other(result, longer, has_contacts)
    for id, (_, gates) in sorted(library.items()):
        if id not in verdicts:
            untested = _find_untested_ends(result.evaluator, result.evaluator.library[id], has_contacts)
            reason = untested or explain_rejection(gates) or Finding(Kind.OTHERS_BETTER)
            verdict = Verdict.REJECTED if untested is None else Verdict.NOT_EXCITED
            verdicts[id] = Candidate(id, 0.0, verdict, 1.0, reason, gates=gates)
    for id, imitated in (doubt.rivals for doubt in doubts if doubt.rivals is not None):
        if id in verdicts and verdicts[id].verdict is Verdict.REJECTED:
            reason = Finding(Kind.IMITATES, effects=(imitated,))
            verdicts[id] = replace(verdicts.pop(id), verdict=Verdict.NOT_EXCITED, reason=reason)
    order = list(Verdict)
    return sorted(verdicts.values(), key=lambda candidate: (order.index(candidate.verdict), -candidate.score)), groups


def _rank_selected(result: SearchResult, final: Terms, before: Step, after: Step) -> list[Candidate]:
    """Return the verdicts on the effect added from `before` to `after`, then on effects that tie with it.

    The score is the probability of the effect, or of its group, times the explained share of the residual of the other
    terms, since an unknown law may cause the rest; it is at most `Criterion.max_score`. Effects with hidden states have
    no competitors, since the motion has decided; nor has a stop in data with contacts.
    """
    evaluator = result.evaluator
    final = (*final, result.table) if result.table is not None else final
    term = next(term for term in final if term.id == after.added)
    others = remove_term(final, term)
    is_met = term.has_impacts and evaluator.train.layout.predicts_torque and count_contacts(evaluator.train.data) > 0
    odds = {term.id: 1.0} if is_hidden(term) or is_met else compute_alternatives(evaluator, final, term)
    share = 1.0 if evaluator.residuals.is_noise(final) else max(0.0, evaluator.explained_share(final, others))
    rivals = {rival[-1].id: rival for rival in screen_replacements(evaluator, final, term)} if len(odds) > 1 else {}
    least = evaluator.criterion.tie_probability
    tied = sorted((id for id in odds if id != term.id and odds[id] > least), key=lambda id: -odds[id])
    score = evaluator.criterion.max_score * share
    if evaluator.train.segments or before.errors["holdout"].is_in_loop:
        error_with, error_without = (step.errors["holdout"].get_joint_error(term.at) for step in (after, before))
        reason = compute_error_fall(before, after)
    else:  # without a simulation
        error_with, error_without = (_compute_held_out_rms(evaluator, terms, term.at) for terms in (final, others))
        reason = Finding(Kind.ERROR_FALLS_AT_JOINT, {"share": Quantity(error_with / error_without)}, joints=(term.at,))
    final_gates = [] if is_hidden(term) else make_final_gates(evaluator, final, others)
    gates = (*final_gates, *evaluator.make_confirmation_gates(after, before))
    best_gain = None if is_hidden(term) else evaluator.evidence(final, others)
    n_compared = 1 if is_hidden(term) else evaluator.count_compared_variants(final, others)
    ratio, total = error_with / error_without, score * sum(odds[id] for id in (term.id, *tied))
    found_tied = []
    for id in tied:
        rival_gates = (*make_final_gates(evaluator, rivals[id], others), Gate("tie_probability", odds[id], least, True))
        gain, variants = evaluator.evidence(rivals[id], others), evaluator.count_compared_variants(rivals[id], others)
        ties = Finding(Kind.TIES, effects=(term.id,))
        found_tied.append(
            Candidate(id, score * odds[id], Verdict.AMBIGUOUS, ratio, ties, gain, variants, rival_gates, rivals[id])
        )
    selected = Candidate(term.id, total, Verdict.SELECTED, ratio, reason, best_gain, n_compared, gates, final)
    return [selected, *found_tied]


def _rank_other(result: SearchResult, longer: Terms, has_contacts: bool) -> Candidate:
    """Return the verdict on the last of some terms, an effect that the final model lacks, in its best variant.

    The score is half of the probability of a gain. An effect is not excited if its range was not tested or its torque
    is too small; but if a term of the model contains it, it is rejected. Other effects are rejected, by their gates.
    """
    evaluator, (*other_terms, term) = result.evaluator, longer
    others = tuple(other_terms)
    gain, variants = evaluator.evidence(longer, others), evaluator.count_compared_variants(longer, others)
    ratio = _compute_held_out_rms(evaluator, longer, term.at) / _compute_held_out_rms(evaluator, others, term.at)
    gates = make_final_gates(evaluator, longer, others)
    if all(gate.passed for gate in gates) and not evaluator.residuals.is_noise(longer):
        gates = make_final_gates(evaluator, longer, others, evaluator.criterion.needed_share)
    untested, verdict = _find_untested_ends(evaluator, type(term), has_contacts), Verdict.NOT_EXCITED
    if untested is not None and not evaluator.is_significant(longer, others):
        reason = untested
    elif not (excited := make_excitation_gate(evaluator, longer)).passed:
        reason, gates = Finding(Kind.NOT_EXCITED, effects=(term.id,)), [excited]
        if containing := [other.id for other in others if can_reproduce(evaluator, other, term)]:
            verdict, reason = Verdict.REJECTED, Finding(Kind.IMITATES, effects=(containing[0],))
    else:
        verdict, gates = Verdict.REJECTED, [excited, *gates]
        if all(gate.passed for gate in gates):
            step = evaluator.fit_with_std(longer, added=term.id)
            gates += evaluator.make_confirmation_gates(step, result.steps[-1])
        selected = [step.added for step in result.steps if step.added is not None]
        reason = explain_rejection(gates, selected) or Finding(Kind.OTHERS_BETTER)
        verdict = Verdict.NOT_EXCITED if "frequencies" in [gate.name for gate in gates] else verdict
        if result.table is not None and term.kind == result.table.kind:
            reason = explain_table(Kind.IMITATES_TABLE, result.table)
    return Candidate(term.id, 0.5 * (1 - gain.p_value), verdict, ratio, reason, gain, variants, tuple(gates), longer)


def _find_untested_ends(evaluator: ModelEvaluator, kind: type[Term], has_contacts: bool) -> Finding | None:
    """Return the finding on ends of the range of an effect beyond which no motion went; None without any."""
    ends = find_untested_ends(kind(), *evaluator.train.get_range(kind.at), evaluator.train.units(kind.at))
    return Finding(Kind.NOT_TESTED, ends, effects=(kind.id,)) if ends and not has_contacts else None


def make_final_gates(
    evaluator: ModelEvaluator, after: Terms, before: Terms, least_share: float | None = None
) -> list[Gate]:
    """Return the gates of a final model over a smaller one, with that of a lag or delay in a closed loop."""
    gates = evaluator.make_gates(after, before, least_share)
    is_open = all(gate.passed for gate in gates)
    return [*gates, *evaluator.residuals.make_loop_gates(after, before)] if is_open else gates


def _compute_held_out_rms(evaluator: ModelEvaluator, terms: Terms, at: str) -> float:
    """Return the held-out RMS torque error, at the joints of a place, of the terms fitted to training data [N m]."""
    error = evaluator.holdout.equations(terms, by_noise=True).error(evaluator.train.solve(terms))
    return get_error_at(evaluator.holdout.layout.compute_joint_errors(error), at, np.nan)


def compute_alternatives(evaluator: ModelEvaluator, terms: Terms, term: Term) -> dict[str, float]:
    """Return the probability that the model with each effect, by id, in the place of `term` has the highest density.

    The bootstrap redraws the blocks of data. The first entry is `term` itself.

    Excluded are laws that contain the term, laws with a sufficient simpler part, and likely laws that
    `can_replace` refuses.
    """
    others = tuple(other for other in terms if other is not term)
    rivals = [
        rival
        for rival in screen_replacements(evaluator, terms, term)
        if not can_reproduce(evaluator, rival[-1], term) and needs_all_parts(evaluator, rival)
    ]
    decisions, least = dict[Terms, bool](), evaluator.criterion.tie_probability
    while True:
        odds = evaluator.bootstrap.probabilities([evaluator.density(model) for model in (terms, *rivals)])
        likely = [rival for rival, share in zip(rivals, odds[1:], strict=True) if share > least]
        decisions |= {rival: can_replace(evaluator, rival, terms, others) for rival in likely if rival not in decisions}
        refuted = [rival for rival in likely if not decisions[rival]]
        if not refuted:
            return dict(zip((term.id, *(rival[-1].id for rival in rivals)), odds.tolist(), strict=True))
        rivals = [rival for rival in rivals if rival not in refuted]


def can_replace(evaluator: ModelEvaluator, rival: Terms, terms: Terms, others: Terms) -> bool:
    """Return whether a rival of `terms` keeps the base of the `others` and lowers their held-out errors.

    In addition, `terms` must not follow the motion significantly better. Tables are removed from all models.
    """
    rival, terms, others = (remove_table(evaluator, model) for model in (rival, terms, others))
    is_confirmed = evaluator.keeps_base(rival, others) and evaluator.lowers_errors(rival, others)
    if not (is_confirmed and all(gate.passed for gate in evaluator.residuals.make_loop_gates(rival, others))):
        return False
    return evaluator.explained_shares_of_motion(terms, rival)[0] <= evaluator.criterion.explained_share


def make_excitation_gate(evaluator: ModelEvaluator, longer: Terms) -> Gate:
    """Return a gate on the excitation of the last of some terms.

    It is the recorded torque over the smallest significant torque of the term. N rows with residual s show a torque of
    which a share u is outside the span of the other terms with a standard error of s / (u sqrt(N)).
    """
    *others, term = longer
    train, rows, least = evaluator.train, evaluator.train.locate_rows(term.at), evaluator.criterion.least_excitation
    residual, recorded = train.residual(tuple(others))[rows], train.equations(others).y[rows]
    if not recorded.any():  # a free swing
        recorded = train.data.torque.applied[rows]
    noise, torque = (float(np.sqrt(np.mean(series**2))) for series in (residual, recorded))
    share = compute_unique_share(train, others, term)
    value = torque * share * len(residual) ** 0.5 / max(SIGNIFICANT * noise, 1e-300)
    return Gate("excitation", value, least, value > least)
