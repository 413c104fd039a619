"""Models that a search tries: with one effect more, another in its place, or another shape."""

from collections.abc import Iterable

from estimators.search_hints import hints_of, is_possible
from estimators.selection.left import Terms
from estimators.selection.models import Models
from estimators.selection.prepared import Trial
from estimators.weak_form.shapes import freed
from pendulum_env.physics import Term
from pendulum_env.physics.terms import has_transmission, ids


def candidates(models: Models, terms: Terms, barred: Iterable[str] = ()) -> list[Terms]:
    """The terms with the best variant of each further effect, the best prediction first."""
    present = ids(terms) | set(barred)
    missing = [effect for id, effect in models.library.items() if id not in present]
    if has_transmission(terms):  # a joint has one
        missing = [effect for effect in missing if effect.kind != "transmission"]
    missing.sort(key=lambda effect: effect.kind == "transmission")  # last: they take long to search
    found: list[Terms] = []
    for done, effect in enumerate(missing):
        if (
            effect.kind == "transmission"
            and not models.train.in_loop
            and (len(terms) > len(models.base) or any(models.left.fits(other) for other in (terms, *found)))
        ):
            continue  # something simpler explains all; or a transmission would have been added first
        models.progress(f"screening {effect.id}", done / len(missing))
        trial = promising(models, terms, effect)
        if trial is not None and models.is_possible(trial.terms):
            found.append(trial.terms)
    return sorted(found, key=models.promise)


def promising(models: Models, terms: Terms, effect: type[Term]) -> Trial | None:
    """The best variant of an effect; for one with little gain or share, only the best of a coarse grid."""
    if not hints_of(effect).multimodal:
        ranked = models.screen.ranked(terms, effect)
        if not ranked:
            return None
        alike = len({len(trial.terms[-1].columns) for trial in ranked}) == 1  # else the richest comes first
        if alike and (
            models.gain(ranked[0].terms, terms).chance > models.criterion.unlikely
            or models.left.explained(ranked[0].terms, terms) < models.criterion.glimpse
        ):
            return ranked[0]
    return best(models, terms, effect)


def best(models: Models, terms: Terms, effect: type[Term]) -> Trial | None:
    """The best variant of an effect, with as few free shape parameters as the data allow; None if there is none.

    One that turns gravity round, as a straight spring in the place of one that hardens, gives way to one that does not.
    """
    trials = models.screen.variants(terms, effect)
    if not trials:
        return None
    simplest, *others = trials
    pull = {name: own.value for name, own in models.model(terms).estimates.items() if others and "gravity" in name}

    def turns(trial: Trial) -> bool:
        return [*pull] == ["gravity"] and pull["gravity"] * models.model(trial.terms).estimates["gravity"].value < 0

    for trial in others:
        if models.is_significant(trial.terms, simplest.terms) or (
            turns(simplest) and not turns(trial) and models.is_significant(trial.terms, terms)
        ):
            simplest = trial
    return simplest


def freer(models: Models, terms: Terms) -> list[Terms]:
    """The terms with one more shape parameter of an effect released from its usual value, one by one."""
    found = []
    for old in terms[len(models.base) :]:
        others = tuple(term for term in terms if term is not old)
        for variants in freed(old):
            if len(variants) > 1:  # of whole numbers the best, where there is time to compare them
                variants = [v for v in variants if is_possible(v, models.train.motions[old.at])]
                trials = [] if models.train.in_loop or not variants else models.screen.trials(others, variants)
                variants = [trial.terms[-1] for trial in sorted(trials, key=lambda trial: trial.fitted_rms)[:1]]
            longer = [tuple(new if term is old else term for term in terms) for new in variants]
            found += [refined(models, one, old.id) for one in longer]
    return found


def refined(models: Models, terms: Terms, id: str) -> Terms:
    """The terms with the shape parameters of one term, by its id, fitted."""
    return models.screen.refine(models.screen.trial(terms), id).terms


def rivals(models: Models, terms: Terms, term: Term) -> list[Terms]:
    """The terms with the best variant of every other effect in the place of one, the best prediction first."""
    others = tuple(other for other in terms if other is not term)
    barred = [id for id, effect in models.library.items() if effect.at != term.at]  # an effect acts where it is
    if models.left.fits(terms):
        barred += [id for id, effect in models.library.items() if effect.kind == "transmission"]  # which are slow
    return candidates(models, others, [term.id, *barred])


def settle(models: Models, terms: Terms) -> Terms:
    """Refit every shape parameter with all terms present."""
    trial = models.screen.trial(terms)
    for term in terms:
        if any(not shape.integer for shape in term.free) and term.id not in models.train.data.watched:
            trial = models.screen.refine(trial, term.id)
    return models.regression.settle(trial.terms)
