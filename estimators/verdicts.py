"""Verdicts: what the data say of every effect of the library, and which effects they cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from estimators.diagnosis import Candidate, Step, Verdict
from estimators.plausibility import HELD_OUT, objection
from estimators.screen import Trial
from estimators.search import SURPRISE, TEMPER, Search, complexity
from estimators.unnamed import IMITATORS
from pendulum_env.physics import Term

# A score is how often such a verdict is right. On 200 blind recordings those without a serious rival were right in 137
# of 140 cases, whatever their odds: what is wrong then is no near rival but something else.
MOST_SURE = 0.98
EXTRA = 2.0  # nats against each parameter more
CERTAIN = 50.0  # nats beyond which odds are no more telling, and numbers end


def judge(
    search: Search, steps: Sequence[Step], shown: Sequence[Step]
) -> tuple[list[Candidate], list[tuple[str, ...]]]:
    """Verdict on every effect of the library, and the groups that these data cannot tell apart.

    Args:
        search: trials on the data.
        steps: from the base model to the final one, fitted as rivals are.
        shown: the same steps as the user sees them, the last perhaps fitted more closely.
    """
    final = search.screen.trial(steps[-1].model.terms)
    verdicts: dict[str, Candidate] = {}
    groups: list[tuple[str, ...]] = []
    for before, after in pairwise(shown):
        chosen, *alike = _judge_selected(search, final, before, after, steps[-1])
        verdicts.update({candidate.effect: candidate for candidate in (chosen, *alike)})
        if alike:
            groups.append(tuple(candidate.effect for candidate in (chosen, *alike)))
    for trial in search.alternatives(final.terms):
        if trial.terms[-1].id not in verdicts:
            verdicts[trial.terms[-1].id] = _judge_left_out(search, trial, steps)
    for id in search.library.keys() - {term.id for term in final.terms}:
        if id not in verdicts:
            reason = "what is left is smaller than what such an effect would leave"
            verdicts[id] = Candidate(id, 0.0, Verdict.REJECTED, 1.0, reason)
    order = list(Verdict)
    return sorted(verdicts.values(), key=lambda candidate: (order.index(candidate.verdict), -candidate.score)), groups


def _judge_selected(search: Search, final: Trial, before: Step, after: Step, last: Step) -> list[Candidate]:
    """The effect added from `before` to `after`, followed by those that would do as well in its place."""
    term = next(t for t in final.terms if t.id == after.added)
    # windows, in which a link is carried along, know little of it: there motion has decided
    rivals = [] if term.link else search.rivals(final, term)
    odds = {rival.terms[-1].id: _odds(search, rival, final, term) for rival in rivals}
    total = 1.0 + sum(odds.values())

    def looks_the_same(rival: Trial) -> bool:
        simple = complexity(rival.terms[-1]) <= complexity(term)
        return simple and search.is_as_good(search.step(None, rival.terms), last)

    level = [rival for rival in rivals if search.nats(final, rival) < search.margin(final, rival)]
    alike = {r.terms[-1].id: f"fits as well as {term.id} in these data" for r in level if looks_the_same(r)}
    for rival in level:
        if search.fits(last) and search.is_called_for(rival, final):
            alike[rival.terms[-1].id] = (
                f"fits as well as {term.id} in the data that are fitted, and those held out call for it: fit both"
            )
    ratio = after.errors["holdout"].torque_rms / before.errors["holdout"].torque_rms
    reason = (
        f"lowers the held-out errors: torque {_fall(before, after, 'torque_rms')} N m, "
        f"free-running position {_fall(before, after, 'position_rms')} rad"
    )
    share = MOST_SURE * (1.0 + sum(odds[id] for id in alike)) / total
    return [
        Candidate(term.id, share, Verdict.SELECTED, ratio, reason),
        *(Candidate(id, odds[id] / total, Verdict.AMBIGUOUS, ratio, why) for id, why in alike.items()),
    ]


def _odds(search: Search, rival: Trial, final: Trial, term: Term) -> float:
    """Odds of a rival against the term in its place; a more complex one that merely contains it has small ones."""
    extra = max(0, complexity(rival.terms[-1]) - complexity(term))
    return float(np.exp(min(-search.nats(final, rival) / TEMPER - EXTRA * extra, CERTAIN)))


def _judge_left_out(search: Search, trial: Trial, steps: Sequence[Step]) -> Candidate:
    """An effect that the final model does without, from its best trial beside it."""
    *others, term = trial.terms
    ratio, excited = _held_out_ratio(search, others, term)
    nats = search.nats(trial, search.screen.trial(others))
    score = 0.5 * (1 - float(np.exp(-max(0.0, nats) / (TEMPER * SURPRISE))))
    if term.beyond:
        return Candidate(term.id, score, Verdict.NOT_EXCITED, ratio, f"{term.beyond}; it needs {term.reveal}")
    if not excited:
        reason = f"these data hardly depend on it; it needs {term.reveal}"
        return Candidate(term.id, score, Verdict.NOT_EXCITED, ratio, reason)
    return Candidate(term.id, score, Verdict.REJECTED, ratio, _why_rejected(search, trial, ratio, steps))


def _held_out_ratio(search: Search, terms: Sequence[Term], term: Term) -> tuple[float, bool]:
    """Held-out torque error with the term over that without, and whether the data depend on the term at all."""
    ratio = search.held_out_rms((*terms, term)) / search.held_out_rms(terms)
    columns, fixed = search.screen.columns([term])[0]
    phi, _ = search.screen.shared(terms)
    own = np.column_stack([columns, fixed])
    own = own[:, np.linalg.norm(own, axis=0) > 0]
    if own.shape[1] == 0:
        return ratio, False
    left = own - phi @ np.linalg.lstsq(phi, own, rcond=1e-10)[0]
    excited = float(np.max(np.linalg.norm(left, axis=0) / np.linalg.norm(own, axis=0))) > 1e-3
    return ratio, excited


def _fall(before: Step, after: Step, error: str) -> str:
    old, new = (getattr(step.errors["holdout"], error) for step in (before, after))
    return f"{old:.3g} -> {new:.3g}"


def _why_rejected(search: Search, trial: Trial, ratio: float, steps: Sequence[Step]) -> str:
    if search.unnamed is not None and trial.terms[-1].id in IMITATORS:
        return f"only imitates {search.unnamed.words}, which the library does not have"
    where = "once the selected effects are in" if len(steps) > 1 else "beside the base model"
    if ratio >= 1:
        return f"does not lower the held-out torque error {where} ({100 * (ratio - 1):+.3g} %)"
    lowered = f"lowers the held-out torque error by {100 * (1 - ratio):.1f} % {where}"
    if ratio > HELD_OUT:
        return f"{lowered}: no more than chance would"
    speaks_against = objection(search.step(trial.terms[-1].id, trial.terms), steps[-1], search.train.samples)
    return f"{lowered}, but {speaks_against or 'that is too little of what noise leaves to explain'}"
