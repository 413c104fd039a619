"""What free-running simulation adds to the search: models refined by the motion, and effects that only motion shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators import output_error, shooting
from estimators.diagnosis import Step
from estimators.free_running import position_noise, take_off
from estimators.search import MOST, PLAIN, Search, complexity, has_transmission
from estimators.shots import has_link
from pendulum_env.physics import Model, Term

BETTER = 0.8  # share of the held-out position error to which a refinement has to lower it
NO_WORSE = 1.02  # ratio of held-out torque errors within which an effect may stay that only flights show
SIMILAR = 1.25  # product of the ratios of both held-out errors that a refinement may cost, where it is the better fit
HALF = 0.5  # share of the held-out error, whatever the state at the start, to which it then has to lower it
ASTRAY = 2.5  # times the position error that noise gives
LEAST_POSITION = 1e-3  # and of this share of the motion, which no initial state or integration is worth chasing below
FLIGHT = 0.93  # share of the error of flights, fitted and held out, to which an effect has to lower it
SURE = 3.5  # standard errors by which flights have to gain
HOP = 0.5  # [s], length of flights that are short enough for errors to grow as a linear model says
FEWEST = 2  # of these for each parameter
IN_FLIGHT = 6  # starts from which they are fitted, of those that promise most


def strays(search: Search, step: Step) -> bool:
    """Whether free-running simulation from the measured state errs by much more than noise makes it."""
    if has_transmission(step.model.terms):
        return False  # its impacts are too sharp to follow as closely, and other effects would only paper over that
    noise = position_noise(search.train.flights, step.model.terms, step.model.theta)
    return step.errors["train"].position_rms > ASTRAY * max(_least_position(search), noise)


def is_astray(search: Search, step: Step) -> bool:
    """Whether it errs so from any state: a velocity that is badly known at the start is no fault of the model."""
    if not strays(search, step):
        return False
    flights, point = search.train.flights, output_error.Point(step.model.terms, step.model.theta)
    noise = max(_least_position(search), output_error.noise(flights, point))
    return output_error.rms(flights, point, output_error.evenly(flights)) > ASTRAY * noise


def _least_position(search: Search) -> float:
    motion = np.concatenate([flight.position.ravel() for flight in search.train.flights])
    return LEAST_POSITION * float(np.std(motion))


def hides(search: Search, step: Step) -> bool:
    """Whether the motion goes astray for something that the torque does not show."""
    return search.unnamed is None and search.fits(step) and is_astray(search, step)


def fly(search: Search, steps: list[Step]) -> list[Step]:
    """The steps with the last model refined by free-running simulation, if held-out flights gain much by it.

    Two cases in which the held-out errors may stay as they are: the model has a state that nobody measures, which
    windows know from the measured motion only, and a simulation carries along; or the gain shows once the state at
    the start of each flight is free, and is buried by what the measured velocity there is uncertain.
    """
    last, flights, checks = steps[-1], search.train.flights, search.holdout.flights
    start = output_error.Point(last.model.terms, last.model.theta)
    point = output_error.fit(flights, start.terms, start.theta)
    refined = search.with_errors(last.added, output_error.model(flights, point))
    torque = refined.errors["holdout"].torque_rms / last.errors["holdout"].torque_rms
    position = position_error(refined) / position_error(last)
    if position < BETTER and torque < NO_WORSE:
        return [*steps[:-1], refined]
    old, new = (output_error.rms(checks, one, output_error.evenly(checks)) for one in (start, point))
    if torque * position < SIMILAR and (has_hidden_state(start.terms) or new < HALF * old):
        return [*steps[:-1], refined]
    return steps


def sharpen(search: Search, steps: list[Step], start: Model | None = None) -> list[Step]:
    """The steps with the last model fitted to all there is to know, where held-out data bear that out.

    Windows lose what happens near reversals, and much of what a coarse encoder tells. What a link does is watched.

    Args:
        search: with the data.
        steps: the last of which is fitted anew.
        start: where to look for a model with a link first, if not where windows have it.
    """
    *others, last = (_watched(search, step) for step in steps)
    if has_link(last.model.terms):
        found = _with_link(search, last, start or last.model)
    elif search.fits(last):
        found = _likeliest(search, last)
    else:
        return steps
    if others and not search.is_confirmed(found, others[-1]):
        return steps
    return [*others, found]


def _watched(search: Search, step: Step, model: Model | None = None) -> Step:
    """A step, perhaps with another model, with the errors that its model has if the link is watched."""
    model = step.model if model is None else model
    if not has_link(model.terms):
        return step
    parts = {"train": search.train, "holdout": search.holdout}
    return Step(step.added, model, {name: part.watching(model).errors(model) for name, part in parts.items()})


def _likeliest(search: Search, last: Step) -> Step:
    """The model at its largest likelihood, if that is known better, and held-out innovations are no larger for it."""
    start = output_error.Point(last.model.terms, last.model.theta)
    flights, checks = ([take_off(w, HOP) for w in part.data.windows] for part in (search.train, search.holdout))
    if sum(len(flight.first) for flight in flights) < FEWEST * len(start.values):
        return last
    found = search.with_errors(last.added, output_error.likeliest(flights, start))
    filters, evenly = output_error.innovations(checks, start), output_error.evenly(checks)
    points = (start, output_error.Point(found.model.terms, found.model.theta))
    old, new = (output_error.rms(checks, point, evenly, filters) for point in points)
    torque = found.errors["holdout"].torque_rms / last.errors["holdout"].torque_rms
    return found if new <= old and torque < NO_WORSE and _uncertainty(found) < _uncertainty(last) else last


def _uncertainty(step: Step) -> float:
    """Mean logarithm of the standard errors."""
    return float(np.mean([np.log(max(estimate.std, 1e-300)) for estimate in step.model.estimates.values()]))


def _with_link(search: Search, last: Step, start: Model) -> Step:
    """The watched step, or that of a model fitted along with its link's motion if that lowers held-out errors."""
    models = [shooting.estimate(search.train.data.windows, start), *([start] if start is not last.model else [])]
    return min(last, *(_watched(search, last, model) for model in models), key=_product)


def _product(step: Step) -> float:
    """Product of both held-out errors [N m rad]."""
    return step.errors["holdout"].torque_rms * step.errors["holdout"].position_rms


def relink(search: Search, steps: list[Step]) -> list[Step]:
    """The steps, or those to another transmission alone where the one in the model does not fit and that does better.

    A link that is carried along the measured motion is soon lost behind a wide play, so that an elastic transmission,
    and what patches it up, may leave less torque. Watched, the loose one shows.
    """
    last = steps[-1]
    if not has_link(last.model.terms) or search.fits(last):
        return steps
    present, base = {term.id for term in last.model.terms}, steps[0].model.terms
    found = last
    for kind in (kind for kind in search.library.values() if kind.link and kind.id not in present):
        search.progress(f"watching the link of {kind.id}", 0.94)
        trial = search.screen.best(base, kind)
        if trial is not None:
            step = search.step(kind.id, trial.terms)
            found = min(found, _with_link(search, _watched(search, step), step.model), key=_product)
    better = _product(found) < BETTER * _product(last) and search.is_confirmed(found, steps[0])
    return [steps[0], found] if better else steps


def grow_in_flight(search: Search, steps: list[Step]) -> list[Step]:
    """Add effects that free-running simulation calls for where the torque is too noisy to show them.

    Such an effect may leave the torque as it is beside the same terms fitted in the same way, but it has to lower
    both errors of the step before.
    """
    while len(steps) <= MOST and is_astray(search, steps[-1]):
        found = _best_in_flight(search, steps[-1])
        if found is None or (is_astray(search, found) and position_error(found) > PLAIN * position_error(steps[-1])):
            break  # a small repair of a motion that lacks more than that
        steps = [*steps, found]
    return steps


def _best_in_flight(search: Search, last: Step) -> Step | None:
    flights, checks = search.train.flights, search.holdout.flights
    # the effect has to beat the same terms fitted in the same way
    start = output_error.fit(flights, last.model.terms, last.model.theta)
    refitted = search.with_errors(last.added, Model.build(start.terms, start.theta))
    weights, check_weights = output_error.weigh(flights, start), output_error.weigh(checks, start)
    before = output_error.rms(flights, start, weights), output_error.rms(checks, start, check_weights)
    ranked = []
    missing = [e for e in search.library.values() if not e.rugged and e.id not in {t.id for t in last.model.terms}]
    for done, kind in enumerate(missing):
        search.progress(f"flying {kind.id}", done / len(missing))
        trial = search.screen.best(last.model.terms, kind)
        variants = [trial.terms[-1]] if trial is not None else []
        if kind.kind == "dissipative" and kind.shapes:  # friction near reversals, which windows hardly see
            variants += list(kind.grid(search.train.samples, search.screen.residual(last.model.terms)))[::2]
        points = [
            output_error.Point((*start.terms, v), np.append(start.theta, np.zeros(len(v.columns)))) for v in variants
        ]
        promises = [output_error.promise(flights, point, weights) for point in points]
        for i in np.argsort(promises)[:2]:
            ranked.append((promises[i], complexity(variants[i]), points[i]))
    ranked.sort(key=lambda entry: entry[:2])
    best, error = None, FLIGHT * before[0]
    for _, _, point in ranked[:IN_FLIGHT]:
        search.progress(f"fitting the flights with {point.terms[-1].id}", 0.9)
        point = output_error.fit(flights, point.terms, point.theta)
        trained, checked = output_error.rms(flights, point, weights), output_error.rms(checks, point, check_weights)
        if trained < error and checked < FLIGHT * before[1] and _beats(search, point, start):
            step = search.with_errors(point.terms[-1].id, output_error.model(flights, point))
            if search.is_confirmed(step, refitted, NO_WORSE) and search.is_confirmed(step, last, torque=1.0):
                best, error = step, trained
    return best


def _beats(search: Search, point: output_error.Point, start: output_error.Point) -> bool:
    """Whether flights err less by far more than they scatter, fitted and held-out ones taken together."""
    flights = (*search.train.flights, *search.holdout.flights)
    gains = np.log(output_error.sizes(flights, start) / output_error.sizes(flights, point))
    return float(gains.mean()) > SURE * float(gains.std(ddof=1)) / np.sqrt(len(gains))


def has_hidden_state(terms: Sequence[Term]) -> bool:
    """Whether the motion depends on a state of bristles, which nobody measures."""
    return any(term.kind == "dissipative" and term.remembers for term in terms)


def position_error(step: Step) -> float:
    """Held-out error of free-running simulation [rad]."""
    return step.errors["holdout"].position_rms
