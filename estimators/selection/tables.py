"""Tables that compete with effects: nonparametric functions, of which some effects are mere imitations."""

from collections.abc import Iterable, Iterator

from estimators.selection.left import Terms
from estimators.selection.models import Models
from estimators.selection.moves import best, candidates, settle
from pendulum_env.physics import Term
from pendulum_env.physics.table import ByTime, Table
from pendulum_env.physics.term import loads
from pendulum_env.physics.terms import ids, parameters


def owned(models: Models, base: Terms, terms: Terms) -> tuple[Terms, Table | None]:
    """The terms without effects that only imitate a table, with those that it reveals, and that table.

    Effects imitate a table that, with the effects still needed, predicts significantly better and explains most of
    their residual, or that is simpler and leaves only noise as well.
    """
    unsettled = not models.left.fits(terms)
    if len(terms) == len(base) and not unsettled:
        return terms, None
    leads: list[tuple[float, Terms]] = []  # and the terms with the table
    for left in with_tables(models, base, terms):
        # a function of time is refitted to each recording, and so are its competitors
        density = models.fitted_anew if isinstance(table_of(models, left), ByTime) else models.density
        lead = models.bootstrap.gain(density(left), density(terms), models.penalty(left, terms))
        if unsettled:
            takes_over = (
                lead.chance <= models.criterion.chance and models.left.explained(left, terms) > models.criterion.needed
            )
        else:  # effects that leave only noise are replaced by a simpler table
            simpler = parameters(left) < parameters(terms)
            level = models.bootstrap.probabilities([density(left), density(terms)])[0] > models.criterion.rival
            takes_over = simpler and level and models.left.fits(left)
        if takes_over:
            leads.append((lead.total, left))
    if not leads:
        return terms, None
    *_, likeliest = max(leads, key=lambda entry: entry[0])
    same = [left for _, left in leads if table_of(models, left).id == table_of(models, likeliest).id]
    level = [left for left in same if models.is_level(left, likeliest)]  # a table may contain an effect
    grown = grown_beside(models, base, min([likeliest, *level], key=len))
    return named(models, grown), table_of(models, grown)


def with_tables(models: Models, base: Terms, terms: Terms) -> Iterator[Terms]:
    """The terms with each table: instead of all effects, or beside those still needed."""
    open_at = {at for at in models.left.joints if not models.left.is_noise_at(at, terms)}
    for table in models.tables:
        if table.at and table.at not in open_at | {at for term in terms[len(base) :] for at in loads(term.at)}:
            continue  # no structure and no effect at this joint
        for others in dict.fromkeys((base, terms)):
            trial = best(models, others, table)
            if trial is not None:
                yield pruned(models, base, trial.terms)


def grown_beside(models: Models, base: Terms, terms: Terms) -> Terms:
    """The terms, one of them a table, with further effects that explain most of their residual.

    Other tables compete: no further effect is named if one of them predicts significantly better, or if the same table
    in more pieces predicts as well.
    """
    while len(terms) - len(base) <= models.criterion.most and not models.left.fits(terms):
        needed = (
            longer for longer in candidates(models, terms)[: models.criterion.tried] if is_needed(models, longer, terms)
        )
        longer = next(needed, None)
        if longer is None:
            break
        others = [best(models, terms, table) for table in models.tables if table.id not in ids(terms)]
        if any(trial is not None and models.is_significant(trial.terms, longer) for trial in others):
            break
        if any(models.is_level(finer, longer) for finer in in_other_forms(models, terms)):
            break
        terms = settle(models, longer)
    return terms


def in_other_forms(models: Models, terms: Terms) -> list[Terms]:
    """The terms with each other form of their table, of more or fewer pieces."""
    table = table_of(models, terms)
    kind = next(kind for kind in models.tables if kind.id == table.id)
    others = tuple(term for term in terms if term is not table)
    return [trial.terms for trial in models.screen.variants(others, kind) if trial.terms[-1] != table]


def pruned(models: Models, base: Terms, terms: Terms) -> Terms:
    """The terms without effects that explain less than is left unexplained, or that their table makes unnecessary."""
    while named(models, terms) != terms or not models.left.fits(terms):
        effects = named(models, terms)[len(base) :]
        withouts = [settle(models, tuple(t for t in terms if t is not term)) for term in effects]
        idle = [without for without in withouts if not is_needed(models, terms, without)]
        if not idle:
            break
        terms = min(idle, key=models.promise)
    return terms


def named(models: Models, terms: Terms) -> Terms:
    """The terms without the table that competes with effects."""
    competing = {table.id for table in models.tables}
    return tuple(term for term in terms if term.id not in competing)


def table_of(models: Models, terms: Terms) -> Table:
    """The table among the terms that competes with effects."""
    return next(term for term in terms[len(models.base) :] if isinstance(term, Table))


def is_needed(models: Models, terms: Terms, without: Terms) -> bool:
    """Whether an effect gains significantly and explains more than is left; else it may belong to that rest."""
    return models.is_significant(terms, without) and models.left.explained(terms, without) > models.criterion.needed


def explaining(models: Models, terms: Terms, laws: Iterable[type[Term]]) -> str | None:
    """The id of the law that would best explain the residual of the terms; None if none explains enough."""
    trials = [best(models, terms, law) for law in laws if law.id not in ids(terms)]
    found = [trial.terms for trial in trials if trial is not None and is_needed(models, trial.terms, terms)]
    return min(found, key=models.promise)[-1].id if found else None
