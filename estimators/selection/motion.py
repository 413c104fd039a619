"""What free-running simulation adds to the search: models refined by the motion, and effects that only motion shows.

Windows stay clear of stick, and what happens at reversals is lost to them. A simulation goes through it.
"""

from __future__ import annotations

import numpy as np

from estimators.selection.data import Evidence, Step
from estimators.selection.search import Search, complexity, has_bristles, has_transmission, held_out_cost
from estimators.simulation import multiple_shooting, output_error
from estimators.simulation.free_running import Flights, position_noise, take_off
from estimators.simulation.link_segments import has_link
from estimators.simulation.output_error import Point
from pendulum_env.physics import Model, Term

HOP = 0.5  # [s], length of flights that are short enough for errors to grow as a linear model says
FEWEST = 2  # of these for each parameter
IN_FLIGHT = 6  # starts from which effects are fitted to the flights, of those that promise most
FINEST = 1e-3  # share of the motion, below which no initial state or integration is worth chasing


def refine(search: Search, steps: list[Step]) -> list[Step]:
    """The steps with all that motion tells: the last model refined, and effects that windows do not show."""
    if is_astray(search, steps[-1]) or any(has_bristles(term) for term in steps[-1].model.terms):
        search.progress("fitting the flights", 0.9)
        *others, last = steps
        found = better(last, search.in_motion(last))
        steps = [*others, found if not others or search.is_confirmed(found, others[-1]) else last]
    if search.unnamed is None and search.fits(steps[-1].model.terms):
        steps = grow_in_flight(search, steps)
    return steps


def better(one: Step, other: Step) -> Step:
    """The step with the smaller cost, the first if they are equal."""
    return min(one, other, key=held_out_cost)


def is_astray(search: Search, step: Step) -> bool:
    """Whether free-running simulation errs by much more than noise makes it, from whatever state it starts.

    A velocity that is badly known at the start is no fault of the model.
    """
    if has_transmission(step.model.terms):
        return False  # its impacts are too sharp to follow as closely, and other effects would only paper over that
    if not search.train.flights:
        return False
    flights, point = search.train.flights, _point(step.model)
    motion = np.concatenate([flight.position.ravel() for flight in flights])
    least, astray = FINEST * float(np.std(motion)), search.criterion.astray
    if step.errors["train"].position_rms <= astray * max(least, position_noise(flights, point.terms, point.theta)):
        return False
    noise = max(least, output_error.noise(flights, point))
    return output_error.rms(flights, point, output_error.evenly(flights)) > astray * noise


def sharpen(search: Search, steps: list[Step], start: Model | None = None) -> list[Step]:
    """The steps with the last model fitted to all there is to know, where held-out data bear that out.

    Windows lose what happens near reversals, and much of what a coarse encoder tells. What a link does is watched.

    Args:
        search: with the data.
        steps: the last of which is fitted anew.
        start: where to look for a model with a link first, if not where windows have it.
    """
    *others, last = steps
    if search.linked is not None and search.linked.model.terms == last.model.terms:
        found = better(last, search.linked)
    elif has_link(last.model.terms):
        found = _with_link(search, last, start or last.model)
    elif search.fits(last.model.terms):
        found = _likeliest(search, last)
    else:
        return steps
    if others and not search.is_confirmed(found, others[-1]):
        return steps
    return [*others, found]


def _likeliest(search: Search, last: Step) -> Step:
    """The model at its largest likelihood, if that is known better, and held-out innovations are no larger for it."""
    start = _point(last.model)
    flights, checks = (_hops(part) for part in (search.train, search.holdout))
    if sum(len(flight.first) for flight in flights) < FEWEST * len(start.values):
        return last
    found = search.with_errors(last.added, output_error.likeliest(flights, start))
    filters, evenly = output_error.innovations(checks, start), output_error.evenly(checks)
    old, new = (output_error.rms(checks, point, evenly, filters) for point in (start, _point(found.model)))
    return found if new <= old and _is_surer(found, last) else last


def _hops(part: Evidence) -> list[Flights]:
    return [take_off(w, HOP) for w in part.data.windows]


def _is_surer(one: Step, other: Step) -> bool:
    """Whether standard errors are smaller on average of what has one in both: not what is known or at its bound."""
    pairs = [(one.model.estimates[name].std, known.std) for name, known in other.model.estimates.items()]
    told = np.array([pair for pair in pairs if min(pair) > 0])
    return len(told) > 0 and float(np.mean(np.log(told[:, 0] / told[:, 1]))) < 0


def _with_link(search: Search, last: Step, start: Model) -> Step:
    """The watched step, or that of a model fitted along with its link's motion if that lowers held-out errors."""
    shot = multiple_shooting.estimate(search.train.data.windows, start)
    models = [shot, *([start] if start is not last.model else [])]
    steps = [search.with_errors(last.added, model) for model in models]
    no_worse = [step for step in steps if step.errors["holdout"].torque_rms <= last.errors["holdout"].torque_rms]
    return min(last, *no_worse, key=held_out_cost) if no_worse else last


def relink(search: Search, steps: list[Step]) -> list[Step]:
    """The steps, or those to another transmission alone where the one in the model does not fit and that does better.

    A link that is carried along the measured motion is soon lost behind a wide play, so that an elastic transmission,
    and what patches it up, may leave less torque. Watched, the loose one shows.
    """
    last, base = steps[-1], steps[0].model.terms
    if not has_link(last.model.terms) or search.fits(last.model.terms):
        return steps
    present = {term.id for term in last.model.terms}
    found = last
    for kind in (kind for kind in search.library.values() if kind.link and kind.id not in present):
        search.progress(f"watching the link of {kind.id}", 0.94)
        trial = search.best(base, kind)
        if trial is not None:
            step = search.step(kind.id, trial.terms)
            found = better(found, _with_link(search, step, step.model))
    return [steps[0], found] if found is not last and search.is_confirmed(found, steps[0]) else steps


def grow_in_flight(search: Search, steps: list[Step]) -> list[Step]:
    """Add effects that free-running simulation calls for where the torque is too noisy to show them."""
    while len(steps) <= search.criterion.most and is_astray(search, steps[-1]):
        found = _best_in_flight(search, steps[-1])
        if found is None:
            break
        steps = [*steps, found]
    return steps


def _best_in_flight(search: Search, last: Step) -> Step | None:
    """The step to the effect with which the flights err least; it has to beat the same terms fitted in the same way."""
    flights = search.train.flights
    before = search.in_motion(last)
    start = _point(before.model)
    weights = output_error.weigh(flights, start)
    ranked = []
    for point in _starts(search, last, start):
        ranked.append((output_error.promise(flights, point, weights), complexity(point.terms[-1]), point))
    ranked.sort(key=lambda entry: entry[:2])
    best, least = None, np.inf
    for promised, _, point in ranked[:IN_FLIGHT]:
        if promised > least:
            break  # what another has left already is less
        search.progress(f"fitting the flights with {point.terms[-1].id}", 0.9)
        point = output_error.fit(flights, point.terms, point.theta)
        error = output_error.rms(flights, point, weights)
        if error >= least:
            continue
        gain, share = search.flight_gain(Model.build(point.terms, point.theta), before.model)
        if gain.chance <= search.criterion.chance and share > search.criterion.share:
            step = search.with_errors(point.terms[-1].id, output_error.model(flights, point))
            if search.is_confirmed(step, better(before, last)):
                best, least = step, error
    return best


def _starts(search: Search, last: Step, start: Point) -> list[Point]:
    """Points with one more effect from which flights are fitted."""
    terms = last.model.terms
    points: list[Point] = []
    for kind in search.library.values():
        if kind.rugged or kind.id in {term.id for term in terms}:
            continue
        search.progress(f"flying {kind.id}", len(points) / (2 * len(search.library)))
        trial = search.best(terms, kind)
        variants: list[Term] = [trial.terms[-1]] if trial is not None else []
        if kind.kind == "dissipative" and kind.shapes:  # friction near reversals, which windows hardly see
            variants += list(kind.grid(search.train.samples, search.screen.residual(terms)))[::2]
        points += [Point((*start.terms, v), np.append(start.theta, np.zeros(len(v.columns)))) for v in variants]
    return points


def _point(model: Model) -> Point:
    return Point(model.terms, np.asarray(model.theta, dtype=float))
