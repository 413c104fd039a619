"""What speaks against an effect: held-out errors that do not fall, and parameters that no body has."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.selection.errors import Step
from estimators.weak_form.shapes import continuous
from pendulum_env._typing import Array
from pendulum_env.physics import Column, Model, NonlinearParameter, Samples, Term, effects
from pendulum_env.physics.table import Table
from pendulum_env.physics.term import LOAD, loads
from pendulum_env.physics.terms import forms
from pendulum_env.words import listing

SELDOM = 0.1  # share of the samples at which friction may come out as negative
CIRCLE = np.linspace(-np.pi, np.pi, 48, endpoint=False)  # [rad], where friction has to be that of a body, seen or not


def impossible(model: Model, motions: Mapping[str, Samples]) -> list[str]:
    """What no body has of a model fitted to a motion: phrases such as "negative inertia"; empty if all is well.

    One kind of friction alone may come out negative where the others outweigh it at every speed that was seen.

    Args:
        model: with parameters.
        motions: samples of each joint, by its name.
    """
    here = replace(model, terms=tuple(term for term in model.terms if not motions.keys().isdisjoint(loads(term.at))))
    found = [f"{column.name} = {value:.3g} {column.unit}" for column, value in beyond(here.terms, here.theta)]
    found += [
        f"{term.full(shape.name)} = {shape.high:.3g} {shape.unit}, the most that it may be"
        for term, shape in at_their_most(here.terms)
    ]
    for at, x in motions.items():
        own = replace(model, terms=tuple(term for term in model.terms if term.at == at))
        found += _impossible(own, x, any(at in loads(term.at) for term in model.terms if term.at != at))
    return found


def _impossible(model: Model, x: Samples, is_coupled: bool) -> list[str]:
    """The same of what is at one joint; where it is coupled, only the power of both joints is known."""
    found = []
    inertia = model.estimates.get("inertia")
    if inertia is not None and inertia.value <= 0 and not inertia.is_unknown:
        found.append("negative inertia")
    rubbing = [(term, column, value) for term, column, value in _parts(model) if term.kind == "dissipative"]
    power = sum((value * column.power(x) for term, column, value in rubbing if not term.hides), np.zeros_like(x.time))
    if np.mean(power < 0) > SELDOM and not is_coupled:
        found.append("friction that drives")
    pushing = [(column, value) for term, column, value in _parts(model) if _pushes(term)]
    pushed = sum((value * column.force(x) for column, value in [(LOAD, 1.0), *pushing]), np.zeros_like(x.time))
    limit = float(np.abs(x.torque - pushed).max())
    dry = _dry_over_a_turn([(column, value) for term, column, value in rubbing if not column.of_torque], x)
    if (
        x.torque.any() and dry.max() > limit and not any(term.at for term in model.terms)
    ):  # links move the joints of an arm as well
        found.append(f"dry friction of {dry.max():.2g} N m, more than the {limit:.2g} N m that moved the joint")
    return found


def _pushes(term: Term) -> bool:
    """Whether a term can set a joint in motion that the motor leaves alone, as its weight; a stop only ends motion."""
    return term.kind in ("potential", "time-varying") and term.id != "hard_stop"


def _parts(model: Model) -> list[tuple[Term, Column, float]]:
    columns = [(term, column) for term in model.terms for column in term.columns]
    return [(*own, float(value)) for own, value in zip(columns, model.theta, strict=True)]


def _dry_over_a_turn(parts: Sequence[tuple[Column, float]], x: Samples) -> Array:
    """Dry friction at angles all around, at usual speed, in the middle of the recording [N m]."""
    still = np.zeros_like(CIRCLE)
    speed, middle = float(np.median(np.abs(x.velocity))), float(np.median(x.time))
    turn = Samples(still + middle, CIRCLE, still + speed, still)
    return sum((value * (column.dry(turn) + still) for column, value in parts), still)


def beyond(terms: Sequence[Term], theta: Array) -> list[tuple[Column, float]]:
    """Linear parameters theta (P,) that no body has so, whatever else it has."""
    columns = [column for term in terms for column in term.columns]
    return [(column, value) for column, value in zip(columns, theta.tolist(), strict=True) if not column.allows(value)]


def at_their_most(terms: Sequence[Term]) -> list[tuple[Term, NonlinearParameter]]:
    """Nonlinear parameters that a fit drove to the upper end of their range: what it looks for is another law.

    A lag of seconds leaves nothing of the torque but its mean, which a controller's answer to all else is no part of.
    At the lower end there is nothing of the effect, and a limit that a user set is no end.
    """
    found = []
    for term in terms:
        shapes = {shape.name: shape for shape in effects().get(term.id, type(term)).nonlinear_parameters}
        own = (shapes[shape.name] for shape in continuous(term))
        found += [(term, shape) for shape in own if term.nonlinear_values[shape.name] >= shape.high]
    return found


def driving_friction(model: Model) -> list[str]:
    """A word on dry or viscous friction that surely came out negative, whatever other effects outweigh it.

    Beside a table of friction it is no friction of its own.
    """
    tables = any(isinstance(term, Table) and term.kind == "dissipative" for term in model.terms)
    names = [name for name in model.estimates if name.split("@")[0] in ("viscous", "coulomb")]
    wrong = [name for name in names if surely_negative(model, name) and not tables]
    return [f"{listing(wrong)} came out negative, and no friction drives: it has another law"] if wrong else []


def surely_negative(model: Model, name: str) -> bool:
    """Whether an estimate is."""
    return sure_sign(model, name) < 0


def sure_sign(model: Model, name: str) -> int:
    """Sign of an estimate; 0 if it may be noise, is unknown, or was fixed by a user, without a standard error."""
    estimate = model.estimates.get(name)
    if estimate is None or estimate.is_unknown or not abs(estimate.value) > 3 * estimate.std > 0:
        return 0
    return int(np.sign(estimate.value))


def objection(after: Step, before: Step, motions: Mapping[str, Samples]) -> str | None:
    """What speaks against an added effect, None if nothing does.

    Args:
        after: the step with the effect.
        before: the step without it.
        motions: samples of each joint of the training data.
    """
    new, old = after.errors["holdout"], before.errors["holdout"]
    kept = forms(after.model.terms) & forms(before.model.terms)
    others = [term for step in (after, before) for term in step.model.terms if forms([term]).isdisjoint(kept)]
    changed = {joint for term in others for joint in loads(term.at)} or set(motions)
    wrong = impossible(after.model, {at: motions[at] for at in motions if at in changed})
    if wrong:
        return f"would mean {listing(wrong)}, which no body has"
    turns = sure_sign(after.model, "gravity") * sure_sign(before.model, "gravity") < 0
    if turns and "gravity_tilt" not in after.model.estimates:  # beside a tilt, gravity alone has any sign
        return "would turn gravity round: the two cancel, in place of a law that is neither"
    if new.in_loop >= old.in_loop:
        return f"does not lower the held-out error in the loop ({old.in_loop:.3g} -> {new.in_loop:.3g} rad)"
    if new.position_rms >= old.position_rms:
        return (
            f"does not lower the held-out error of free-running simulation "
            f"({old.position_rms:.3g} -> {new.position_rms:.3g} rad)"
        )
    for at in motions:
        if at not in changed:
            continue
        less, more = (one.at(at) for one in (new, old))
        if less >= more:
            told = f" of {at}" if at else f" ({more:.3g} -> {less:.3g} N m)"
            return f"does not lower the held-out torque error{told}"
    return None
