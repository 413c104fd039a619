"""Verdicts: what the data say of every effect of the library, and which effects they cannot tell apart."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from estimators.diagnosis.result import Candidate, Verdict
from estimators.regression.least_squares import outside
from estimators.schemes.identifiability import Doubt
from estimators.selection.errors import Step, error_at
from estimators.selection.left import Terms
from estimators.selection.models import Models
from estimators.selection.moves import candidates, rivals
from estimators.selection.physical import objection
from estimators.selection.score import Bootstrap, Gain
from estimators.selection.search import Selection
from estimators.selection.tables import named
from estimators.simulation import output_error
from pendulum_env.physics import Model, Term
from pendulum_env.physics.terms import complexity, has_transmission, ids, is_hidden, untested_range
from pendulum_env.words import number_text

SAME = 1e-6  # of a torque, numerical difference of equal laws


def judge(
    found: Selection, final: Terms, doubts: Sequence[Doubt] = ()
) -> tuple[list[Candidate], list[tuple[str, ...]]]:
    """Verdict on every effect of the library, and groups that these data cannot tell apart, a selected one first.

    Those in the model are judged beside the table that was found, if there is one; those left out, without it.

    Args:
        found: with the steps as the user sees them: the last perhaps fitted more closely.
        final: terms of the final model, as they were searched for.
        doubts: what the data cannot tell: an effect that would pass for a term of the model is not rejected.
    """
    models, steps = found.models, found.steps
    verdicts: dict[str, Candidate] = {}
    groups: list[tuple[str, ...]] = []
    for before, after in pairwise(steps):
        chosen, *alike = _judge_selected(found, final, before, after)
        verdicts.update({candidate.effect: candidate for candidate in (chosen, *alike)})
        if alike:
            groups.append(tuple(candidate.effect for candidate in (chosen, *alike)))
    for longer in candidates(models, final):
        if longer[-1].id not in verdicts:
            verdicts[longer[-1].id] = _judge_left_out(found, longer)
    for id in sorted(models.library.keys() - ids(final)):  # in the same order every time
        if id not in verdicts:
            reason = "what is left is smaller than what such an effect would leave, or no body would have it so"
            verdicts[id] = Candidate(id, 0.0, Verdict.REJECTED, 1.0, reason)
    return doubted(by_verdict(verdicts.values()), doubts), groups


def doubted(candidates: Sequence[Candidate], doubts: Sequence[Doubt]) -> list[Candidate]:
    """Candidates of which those are not rejected that would pass for a term of the model, as these data are."""
    alike = {doubt.rivals[0]: doubt.text for doubt in doubts if doubt.rivals is not None}
    return by_verdict(
        replace(one, verdict=Verdict.NOT_EXCITED, reason=alike[one.effect])
        if one.verdict is Verdict.REJECTED and one.effect in alike
        else one
        for one in candidates
    )


def by_verdict(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Candidates by what became of them, the likelier first."""
    order = list(Verdict)
    return sorted(candidates, key=lambda candidate: (order.index(candidate.verdict), -candidate.score))


def _judge_selected(found: Selection, final: Terms, before: Step, after: Step) -> list[Candidate]:
    """The effect added from `before` to `after`, followed by those that may as well be in its place.

    The score is the probability of the effect, or of one of its group, among all that the library has, times the share
    that it explains of what the others leave: what is left may be of a law that the library lacks, and so may it be.
    """
    models = found.models
    final = (*final, found.table) if found.table is not None else final  # beside it, what it hides shows
    term = next(term for term in final if term.id == after.added)
    # windows, in which a link is carried along, know little of it: there motion has decided
    odds = {term.id: 1.0} if is_hidden(term) else alternatives(models, final, term)
    others = tuple(other for other in final if other is not term)
    known = 1.0 if models.left.fits(final) else max(0.0, models.left.explained(final, others))
    others_of = {rival[-1].id: rival for rival in rivals(models, final, term)} if len(odds) > 1 else {}
    alike = [id for id, probability in odds.items() if id != term.id and probability > models.criterion.rival]
    share = models.criterion.certain * known
    total = sum(odds[id] for id in (term.id, *alike))
    if models.train.segments or before.errors["holdout"].is_in_loop:
        less, more = (step.errors["holdout"].at(term.at) for step in (after, before))
        ratio, reason = less / more, _falls(before, after)
    else:  # no simulation follows: windows tell it of the final model, as they tell the score
        less, more = (_held_out_rms(models, terms, term.at) for terms in (final, others))
        ratio, reason = less / more, f"lowers the held-out torque error of {term.at} to {less / more:.1%}"
    windowed = (None, 1) if is_hidden(term) else _gained(models, final, others)
    imitates = f"predicts as well as {term.id}, or nearly"
    return [
        Candidate(term.id, share * total, Verdict.SELECTED, ratio, reason, *windowed),
        *(
            Candidate(id, share * odds[id], Verdict.AMBIGUOUS, ratio, imitates, *_gained(models, others_of[id], others))
            for id in sorted(alike, key=lambda id: -odds[id])
        ),
    ]


def _judge_left_out(found: Selection, longer: Terms) -> Candidate:
    """An effect that the final model does without, from its best variant beside it."""
    models, (*others, term) = found.models, longer
    gain, variants = _gained(models, longer, tuple(others))
    ratio = _held_out_rms(models, longer, term.at) / _held_out_rms(models, tuple(others), term.at)
    left_open, verdict = untested_range(type(term)(), *models.train.reach(term.at)), Verdict.NOT_EXCITED
    if left_open and not models.is_significant(longer, tuple(others)):
        reason = f"{left_open}; it needs {term.description.informative_experiment}"
    elif not is_excited(models, longer):
        reason = f"these data hardly depend on it; it needs {term.description.informative_experiment}"
    else:
        verdict, side = Verdict.REJECTED, "better" if gain.total > 0 else "worse"
        told = f"predicts {side} by {abs(gain.total):.3g} ± {gain.error:.2g} nats"
        reason = f"{told}: {_why_rejected(found, longer)}"
    return Candidate(term.id, 0.5 * (1 - gain.chance), verdict, ratio, reason, gain, variants)


def _gained(models: Models, after: Terms, before: Terms) -> tuple[Gain, int]:
    """What a candidate predicts better than its absence, and the number of variants that it is the best of."""
    return models.gain(after, before), models.variants(after, before)


def _held_out_rms(models: Models, terms: Terms, at: str) -> float:
    """Torque error on the held-out data of the terms fitted to the training data [N m]."""
    error = models.holdout.regression.equations(terms).error(models.regression.solve(terms))
    return error_at(models.holdout.data.errors(error), at, np.nan)


def alternatives(models: Models, terms: Terms, term: Term) -> dict[str, float]:
    """Probability of each effect in the place of one of the terms, itself first, by id.

    A more complex law that contains the term, as a spring contains an offset, does not compete, nor does one that would
    not lower the held-out errors.
    """
    others = tuple(other for other in terms if other is not term)
    open_to = [rival for rival in rivals(models, terms, term) if not contains(models, rival[-1], term)]
    known: dict[Terms, bool] = {}
    while True:
        odds = models.bootstrap.probabilities([models.density(one) for one in (terms, *open_to)])
        likely = [rival for rival, share in zip(open_to, odds[1:], strict=True) if share > models.criterion.rival]
        known |= {rival: may_replace(models, rival, terms, others) for rival in likely if rival not in known}
        refuted = [rival for rival in likely if not known[rival]]
        if not refuted:
            return dict(zip((term.id, *(rival[-1].id for rival in open_to)), odds.tolist(), strict=True))
        open_to = [rival for rival in open_to if rival not in refuted]


def may_replace(models: Models, rival: Terms, terms: Terms, others: Terms) -> bool:
    """Whether a rival lowers both errors of the others, and the terms do not follow the motion significantly better."""
    rival, terms, others = (named(models, one) for one in (rival, terms, others))
    if not models.lowers_errors(rival, others):
        return False
    if has_transmission(rival) or has_transmission(terms) or not models.train.segments:
        return True  # segments with a transmission soon diverge
    first, second = (models.in_motion(models.step(None, one)).model for one in (terms, rival))
    gain, share = simulation_gain(models, first, second)
    return gain.chance > models.criterion.chance or share <= models.criterion.share


def simulation_gain(models: Models, after: Model, before: Model) -> tuple[Gain, float]:
    """Gain of one model over another on all segments, and the share of squared error removed on fitted ones.

    The score is that of the windows. Errors within a segment are fully correlated, so the gain is the logarithm of
    their ratio; noise is added to both, since errors below it carry no information.
    """
    parts = (models.train.segments, models.holdout.segments)
    points = [output_error.Point.of(model) for model in (after, before)]
    new, old = (np.concatenate([output_error.sizes(part, one) ** 2 for part in parts]) for one in points)
    counts = [sum(len(segment.first) for segment in part) for part in parts]
    owner = np.repeat(np.arange(2), counts)
    noise = np.array([output_error.noise(part, points[1]) ** 2 for part in parts])[owner]
    gain = Bootstrap(owner, np.random.default_rng(0)).gain(-0.5 * np.log(new + noise), -0.5 * np.log(old + noise))
    had, left = (float(np.mean((squares - noise)[: counts[0]])) for squares in (old, new))
    return gain, (had - left) / had if had > 0 else 0.0


def contains(models: Models, larger: Term, term: Term) -> bool:
    """Whether a term with more parameters can reproduce any torque of another."""
    if complexity(larger) <= complexity(term) or not term.columns:
        return False
    (own,), (other,) = models.regression.columns([term]), models.regression.columns([larger])
    left = own.linear - other.linear @ np.linalg.lstsq(other.linear, own.linear, rcond=None)[0]
    return bool(np.linalg.norm(left) < SAME * np.linalg.norm(own.linear))


def is_excited(models: Models, longer: Terms) -> bool:
    """Whether the data depend on the last of some terms in a way that the others cannot imitate."""
    *others, term = longer
    (columns,) = models.regression.columns([term])
    own = models.regression.placed([term], [np.column_stack([columns.linear, columns.fixed])])
    own = own[:, np.linalg.norm(own, axis=0) > 0]
    if own.shape[1] == 0:
        return False
    own = own * models.regression.weights(others)[:, None]
    frame = models.regression.frame(others)
    left = outside(frame, own)
    return float(np.max(np.linalg.norm(left, axis=0) / np.linalg.norm(own, axis=0))) > models.criterion.seen


def _falls(before: Step, after: Step) -> str:
    """How held-out errors fell, in words."""
    old, new = before.errors["holdout"], after.errors["holdout"]
    if new.is_in_loop:
        return f"lowers the held-out error in the loop: {old.in_loop:.3g} -> {new.in_loop:.3g} rad"
    torque = f"torque {old.torque_rms:.3g} -> {new.torque_rms:.3g} N m"
    position = f", free-running position {number_text(old.position_rms, 3)} -> {new.position_rms:.3g} rad"
    return f"lowers the held-out errors: {torque}{'' if np.isnan(new.position_rms) else position}"


def _why_rejected(found: Selection, longer: Terms) -> str:
    models, steps = found.models, found.steps
    others = longer[:-1]
    where = "once the selected effects are in" if len(steps) > 1 else "beside the base model"
    if found.table is not None and longer[-1].kind == found.table.kind:
        return f"only imitates {found.table.told}, which the library does not have"
    if not models.is_significant(longer, others):
        return f"no more than chance may give {where}"
    if not models.left.explains(longer, others):
        share = max(0.0, models.left.explained(longer, others))
        return f"explains {share:.0%} of what is left {where}, too little to be it"
    speaks_against = objection(models.report(longer[-1].id, longer), steps[-1], models.train.motions)
    return speaks_against or "others explain it better"
