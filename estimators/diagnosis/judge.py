"""Verdicts: what the data say of every effect of the library, and which effects they cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TypedDict

import numpy as np

from estimators.checks.physical import objection
from estimators.diagnosis.result import Candidate, Verdict
from estimators.selection.data import Step
from estimators.selection.foils import words
from estimators.selection.score import Gain
from estimators.selection.search import Search, Terms, is_hidden

SEEN = 1e-3  # share of an effect's torque that the other terms cannot imitate, below which the data do not show it


class _Gained(TypedDict, total=False):
    gain: Gain
    variants: int


def judge(search: Search, final: Terms, steps: Sequence[Step]) -> tuple[list[Candidate], list[tuple[str, ...]]]:
    """Verdict on every effect of the library, and groups that these data cannot tell apart, a selected one first.

    Those in the model are judged beside the law without a name, if there is one; those left out, without it.

    Args:
        search: with the data.
        final: terms of the final model, as they were searched for.
        steps: to them, as the user sees them: the last perhaps fitted more closely.
    """
    verdicts: dict[str, Candidate] = {}
    groups: list[tuple[str, ...]] = []
    for before, after in pairwise(steps):
        chosen, *alike = _judge_selected(search, final, before, after)
        verdicts.update({candidate.effect: candidate for candidate in (chosen, *alike)})
        if alike:
            groups.append(tuple(candidate.effect for candidate in (chosen, *alike)))
    for longer in search.candidates(final):
        if longer[-1].id not in verdicts:
            verdicts[longer[-1].id] = _judge_left_out(search, longer, steps)
    for id in search.library.keys() - {term.id for term in final}:
        if id not in verdicts:
            reason = "what is left is smaller than what such an effect would leave, or no body would have it so"
            verdicts[id] = Candidate(id, 0.0, Verdict.REJECTED, 1.0, reason)
    order = list(Verdict)
    return sorted(verdicts.values(), key=lambda candidate: (order.index(candidate.verdict), -candidate.score)), groups


def _judge_selected(search: Search, final: Terms, before: Step, after: Step) -> list[Candidate]:
    """The effect added from `before` to `after`, followed by those that may as well be in its place.

    The score is the probability of the effect, or of one of its group, among all that the library has, times the share
    that it explains of what the others leave: what is left may be of a law that the library lacks, and so may it be.
    """
    final = (*final, search.unnamed) if search.unnamed is not None else final  # beside it, what it hides shows
    term = next(term for term in final if term.id == after.added)
    # windows, in which a link is carried along, know little of it: there motion has decided
    odds = {term.id: 1.0} if is_hidden(term) else search.alternatives(final, term)
    others = tuple(other for other in final if other is not term)
    known = 1.0 if search.fits(final) else max(0.0, search.explained(final, others))
    rivals = {rival[-1].id: rival for rival in search.rivals(final, term)} if len(odds) > 1 else {}
    alike = [id for id, probability in odds.items() if id != term.id and probability > search.criterion.rival]
    share = search.criterion.certain * known
    total = sum(odds[id] for id in (term.id, *alike))
    ratio = after.errors["holdout"].torque_rms / before.errors["holdout"].torque_rms
    reason = _falls(before, after, term.at)
    windowed: _Gained = {} if is_hidden(term) else _gained(search, final, others)
    return [
        Candidate(term.id, share * total, Verdict.SELECTED, ratio, reason, **windowed),
        *(
            Candidate(
                id,
                share * odds[id],
                Verdict.AMBIGUOUS,
                ratio,
                f"predicts as well as {term.id}, or nearly",
                **_gained(search, rivals[id], others),
            )
            for id in sorted(alike, key=lambda id: -odds[id])
        ),
    ]


def _judge_left_out(search: Search, longer: Terms, steps: Sequence[Step]) -> Candidate:
    """An effect that the final model does without, from its best variant beside it."""
    *others, term = longer
    gained = _gained(search, longer, tuple(others))
    gain = gained["gain"]
    ratio = _held_out_rms(search, longer) / _held_out_rms(search, tuple(others))
    score = 0.5 * (1 - gain.chance)
    left_open = type(term)().beyond(*search.train.reach)
    if left_open and not search.is_sure(longer, tuple(others)):
        return Candidate(term.id, score, Verdict.NOT_EXCITED, ratio, f"{left_open}; it needs {term.reveal}", **gained)
    if not is_excited(search, longer):
        reason = f"these data hardly depend on it; it needs {term.reveal}"
        return Candidate(term.id, score, Verdict.NOT_EXCITED, ratio, reason, **gained)
    told = f"predicts better by {gain.total:.3g} ± {gain.error:.2g} nats"
    return Candidate(
        term.id, score, Verdict.REJECTED, ratio, f"{told}: {_why_rejected(search, longer, steps)}", **gained
    )


def _gained(search: Search, after: Terms, before: Terms) -> _Gained:
    """What a candidate predicts better than its absence, and the number of variants that it is the best of."""
    return {"gain": search.gain(after, before), "variants": search.variants(after, before)}


def _held_out_rms(search: Search, terms: Terms) -> float:
    """Torque error on the held-out data of the terms fitted to the training data [N m]."""
    error = search.held_out.equations(terms).error(search.screen.solve(terms))
    return float(np.sqrt(np.mean(error**2)))


def is_excited(search: Search, longer: Terms) -> bool:
    """Whether the data depend on the last of some terms in a way that the others cannot imitate."""
    *others, term = longer
    (columns,) = search.screen.columns([term])
    own = search.screen.placed([term], [np.column_stack([columns.linear, columns.fixed])])
    own = own[:, np.linalg.norm(own, axis=0) > 0]
    if own.shape[1] == 0:
        return False
    own = own * search.screen.weights(others)[:, None]
    frame = search.screen.frame(others)
    left = own - frame @ (frame.T @ own)
    return float(np.max(np.linalg.norm(left, axis=0) / np.linalg.norm(own, axis=0))) > SEEN


def _falls(before: Step, after: Step, at: str) -> str:
    """How held-out errors fell, in words."""
    old, new = before.errors["holdout"], after.errors["holdout"]
    torque = f"torque {old.joints.get(at, old.torque_rms):.3g} -> {new.joints.get(at, new.torque_rms):.3g} N m"
    if np.isnan(new.position_rms):
        return f"lowers the held-out error: {torque}"
    position = f"free-running position {old.position_rms:.3g} -> {new.position_rms:.3g} rad"
    return f"lowers the held-out errors: {torque}, {position}"


def _why_rejected(search: Search, longer: Terms, steps: Sequence[Step]) -> str:
    others = longer[:-1]
    where = "once the selected effects are in" if len(steps) > 1 else "beside the base model"
    if search.unnamed is not None and longer[-1].kind == search.unnamed.kind:
        return f"only imitates {words(search.unnamed)}, which the library does not have"
    if not search.is_sure(longer, others):
        return f"no more than chance may give {where}"
    if not search.explains(longer, others):
        return f"explains {max(0.0, search.explained(longer, others)):.0%} of what is left {where}, too little to be it"
    speaks_against = objection(search.step(longer[-1].id, longer), steps[-1], search.train.motions)
    return speaks_against or "others explain it better"
