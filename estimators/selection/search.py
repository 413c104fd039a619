"""Search for missing effects: one loop that adds, swaps and drops effects by one score.

The score is the log predictive density of held-out blocks (`score`). An effect is added if its gain is significant, if
it explains enough of the residual structure, if its parameters are physically possible, and if both held-out errors
fall; then each effect is compared with every other in its place, and with its own absence.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, permutations

from estimators.selection.errors import Step
from estimators.selection.left import Terms
from estimators.selection.models import Models, held_out_cost
from estimators.selection.moves import best, candidates, freer, refined, rivals, settle
from estimators.selection.tables import owned, pruned
from estimators.simulation import multiple_shooting
from estimators.weak_form.shapes import bound
from pendulum_env.physics import Term
from pendulum_env.physics.table import Table
from pendulum_env.physics.terms import forms, has_link, ids, parameters


@dataclass(frozen=True)
class Selection:
    """Result of a search.

    Attributes:
        models: data and scores at the end of the search.
        steps: from the base model to the final one.
        table: nonparametric function that replaces effects, if one does.
    """

    models: Models
    steps: list[Step]
    table: Table | None = None

    @property
    def terms(self) -> Terms:
        """Those of the final model."""
        return self.steps[-1].model.terms


def select(models: Models) -> Selection:
    """The effects that the base model lacks.

    If the most promising first effect leaves structure in the end, the search is repeated from the next ones.
    """
    start = settle(models, models.base)
    models, terms = grow(models, start, start)
    if not models.left.fits(terms):
        begun, firsts = ids(terms), candidates(models, start)
        for first in firsts[: models.criterion.beam]:
            if first[-1].id not in begun and models.is_significant(first, start) and models.is_level(first, firsts[0]):
                tried, other = grow(models, settle(models, first), start)
                gain = models.bootstrap.gain(tried.density(other), models.density(terms), models.penalty(other, terms))
                if gain.chance <= models.criterion.chance and are_confirmed(tried, ladder(tried, start, other)):
                    models, terms = tried, other
    terms, law = owned(models, start, pruned(models, start, terms))
    return Selection(models, confirmed(models, start, terms), law)


def confirmed(models: Models, base: Terms, terms: Terms) -> list[Step]:
    """Steps to the terms, or to those of them that lower both errors one after the other."""
    steps = ladder(models, base, terms)
    while not are_confirmed(models, steps):
        steps = ladder(models, base, steps[-2].model.terms)
    return steps


def grow(models: Models, terms: Terms, base: Terms) -> tuple[Models, Terms]:
    """Add effects while they gain; after each, swap and drop."""
    seen = {forms(terms)}
    while len(terms) - len(base) < models.criterion.most:
        found = add(models, terms)
        if found is None:
            break
        models, longer = found
        revised = revise(models, longer, base)
        if forms(revised) in seen:  # avoids a cycle; an effect too many is pruned in the end
            revised = longer
        follows = forms(revised) == forms(longer) or are_confirmed(models, ladder(models, base, revised))
        terms = revised if follows else longer
        if forms(terms) in seen:
            break
        seen.add(forms(terms))
    return models, terms


def revise(models: Models, terms: Terms, base: Terms) -> Terms:
    """Drop effects that are not needed beside the others, and swap those with a significantly better competitor."""
    for _ in range(2 * models.criterion.most):
        changed = challenged(models, terms, base)
        if changed is None:
            break
        terms = settle(models, changed)
    return terms


def challenged(models: Models, terms: Terms, base: Terms) -> Terms | None:
    """The terms with one effect less, or another in its place, if that is as good or better; else None."""
    withouts = [tuple(t for t in terms if t is not term) for term in terms[len(base) :]]
    tighter = [
        refined(models, tuple(new if t is old else t for t in terms), old.id)
        for old in terms[len(base) :]
        for new in bound(old)
    ]
    for without in sorted(withouts + tighter, key=models.promise):
        if not (models.is_significant(terms, without) and models.left.explains(terms, without)):
            return without
        if len(base) < len(without) < len(terms):
            term = next(term for term in terms if term not in without)
            for rival in rivals(models, terms, term)[:1]:
                if models.is_significant(rival, terms):
                    return rival
    return None


def add(models: Models, terms: Terms) -> tuple[Models, Terms] | None:
    """The terms with one more effect: the simplest of those that are confirmed and predict alike.

    Where none is, the best two effects that show only together, see `paired`.
    """
    confirmed: list[Terms] = []
    firsts = candidates(models, terms)
    for longer in sorted(firsts + freer(models, terms), key=models.promise)[: models.criterion.tried]:
        if confirmed and not models.is_level(longer, confirmed[0]):
            break
        if not (models.is_significant(longer, terms) and models.left.explains(longer, terms)):
            continue
        longer = settle(models, longer)
        models.progress(f"confirming {', '.join(sorted(one[0] for one in forms(longer) - forms(terms)))}", 0.9)
        if not has_link(longer) or has_link(terms) or models.train.in_loop:
            if models.lowers_errors(longer, terms) or refines(models, longer, terms):
                confirmed.append(longer)
        elif not confirmed and (watched := linked(models, longer, terms)) is not None:
            return watched
    if confirmed:
        return models, min(confirmed, key=parameters)  # the simplest of several
    pair = paired(models, terms, firsts[: models.criterion.beam])
    return None if pair is None else (models, pair)


def paired(models: Models, terms: Terms, firsts: Sequence[Terms]) -> Terms | None:
    """The terms with two effects of a joint that explain it only together; None if no two do.

    What one effect leaves of another may vary so much from block to block that neither shows alone, as Stribeck
    friction beside friction that grows with the load.
    """
    room = len(terms) + 2 - len(models.base) <= models.criterion.most
    if not room or models.left.fits(terms) or models.train.in_loop:  # in the loop each takes seconds
        return None
    found = []
    for first in (one for one in firsts if not has_link(one)):  # which are watched first, see `add`
        elsewhere = [id for id, effect in models.library.items() if effect.at != first[-1].at]
        for pair in [one for one in candidates(models, first, elsewhere) if not has_link(one)][:1]:
            others = first, (*terms, pair[-1])
            if (
                all(models.is_significant(pair, other) for other in (terms, *others))
                and models.left.explains(pair, terms)
                and models.lowers_errors(pair, terms)
            ):
                found.append(settle(models, pair))
    return min(found, key=models.promise, default=None)


def refines(models: Models, longer: Terms, terms: Terms) -> bool:
    """Whether terms differ from others in the form of one effect alone, and predict more torque.

    It is the effect that has to lower both errors: a simulation that its torque makes chaotic says little of its form.
    """
    changed = {id for id, *_ in forms(longer) ^ forms(terms)}
    if ids(longer) != ids(terms) or len(changed) != 1 or models.train.in_loop:
        return False
    at = next(term.at for term in longer if term.id in changed)
    after, before = (models.step(None, one).errors["holdout"].at(at) for one in (longer, terms))
    return after < before and models.lowers_errors(longer, tuple(term for term in longer if term.id not in changed))


def linked(models: Models, longer: Terms, terms: Terms) -> tuple[Models, Terms] | None:
    """A model with a link; where it leaves structure, the best of both kinds of link, alone or beside another effect.

    Behind a wide play, the link's state propagated along the measured motion is soon lost, so that an elastic
    transmission may promise less torque. With estimated states, the loose one fits better. On which side of the play
    the link lies is up to all that acts: fitted without an offset of the torque, play is found where there is none.
    """
    found = watch(models, longer, terms)
    if found is None or found[0].left.fits(found[1]):
        return found
    kinds = [kind for kind in models.library.values() if kind.link and kind.id != longer[-1].id]
    trials = [trial.terms for trial in (best(models, terms, kind) for kind in kinds) if trial is not None]
    for alone in (longer, *trials):
        trials += [more for more in candidates(models, alone)[:1] if models.is_significant(more, alone)]
    others = [watch(models, trial, terms) for trial in trials]
    return min([found, *(one for one in others if one is not None)], key=lambda one: one[0].cost_with_link)


def watch(models: Models, longer: Terms, terms: Terms) -> tuple[Models, Terms] | None:
    """A model with a link, fitted together with the link's states; None if it is not confirmed.

    Beside the smaller model fitted to the motion, its cost decides: the position behind a play is chaotic, so that a
    model that leaves ten times the torque may end closer to it.
    """
    step, before = models.step(longer[-1].id, longer), models.step(None, terms)
    models.progress(f"watching the link of {step.added}", 0.9)
    shot = models.with_errors(step.added, multiple_shooting.estimate(models.train.data.windows, step.model))
    found = [one for one in (shot, step) if models.is_confirmed(one, before)]
    if not found or held_out_cost(found[0]) >= held_out_cost(models.in_motion(before)):
        return None
    linked = min(found, key=held_out_cost)
    return models.watching(linked), linked.model.terms


def are_confirmed(models: Models, steps: Sequence[Step]) -> bool:
    """Whether every step is confirmed, or all at once if they leave only noise and none can be left out."""
    if all(models.is_confirmed(after, before) for before, after in pairwise(steps)):
        return True
    base, terms = steps[0].model.terms, steps[-1].model.terms
    withouts = [tuple(t for t in terms if t is not term) for term in terms if term.id not in ids(base)]
    return (
        models.left.fits(terms)
        and models.is_confirmed(steps[-1], steps[0])
        and (len(withouts) == 1 or all(models.lowers_errors(terms, without) for without in withouts))
    )


def ladder(models: Models, base: Terms, terms: Terms) -> list[Step]:
    """Steps from the base to the final terms, in an order in which each lowers both errors if there is one.

    The effect that the final model needs most comes first. With a large unexplained residual, the errors may fall only
    with the parameters fitted to the motion.
    """
    order: list[Term] = []
    left = terms
    while len(left) > len(base):
        withouts = [tuple(t for t in left if t is not term) for term in left[len(base) :]]
        kept = max(withouts, key=lambda terms: float(models.density(terms).sum()))
        order.insert(0, next(term for term in left if term not in kept))
        left = kept
    orders = list(permutations(order)) if len(order) <= models.criterion.ordered else [tuple(order)]
    made: dict[Terms, Step] = {}

    def course(one: Sequence[Term], view: Callable[[Step], Step]) -> list[Step]:
        steps = []
        for count in range(len(one) + 1):
            present = tuple(term for term in terms if term.id in ids(base) or term in one[:count])
            if present not in made:
                made[present] = models.report(None, present)
            steps.append(view(replace(made[present], added=one[count - 1].id if count else None)))
        return steps

    views: list[Callable[[Step], Step]] = [lambda step: step, models.in_motion]
    for view in views if len(order) and models.train.segments else views[:1]:
        for one in orders:
            steps = course(one, view)
            if are_confirmed(models, steps):
                return steps
    return course(orders[0], views[0])
