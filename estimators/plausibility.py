"""What speaks against an effect: held-out errors that do not fall, and parameters that no body has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.diagnosis import Step
from pendulum_env._typing import Array
from pendulum_env.physics import Column, Model, Samples, Term

HELD_OUT = 0.96  # share of the held-out torque error to which an effect has to lower it
NOTHING = 1.5  # standard errors, within which a parameter may as well be zero
SELDOM = 0.1  # share of the samples at which friction may come out as negative


def impossible(model: Model, x: Samples) -> list[str]:
    """What came out negative though no body has it so: inertia, or the power that friction takes along the samples.

    One kind of friction alone may come out negative where the others outweigh it at every speed that was seen.
    """
    inertia = model.estimates["inertia"].value if "inertia" in model.estimates else 1.0
    power, first = np.zeros_like(x.velocity), 0
    for term in model.terms:
        theta, first = model.theta[first : first + len(term.columns)], first + len(term.columns)
        if term.kind == "dissipative" and not term.remembers:
            power += sum(value * column.power(x) for value, column in zip(theta, term.columns, strict=True))
    negative = ["friction"] if np.mean(power < 0) > SELDOM else []
    return ["inertia", *negative] if inertia <= 0 else negative


def beyond(terms: Sequence[Term], theta: Array) -> list[tuple[Column, float]]:
    """Linear parameters theta (P,) that no body has so, whatever else it has."""
    columns = [column for term in terms for column in term.columns]
    return [(column, value) for column, value in zip(columns, theta.tolist(), strict=True) if not column.allows(value)]


def wrong_signs(model: Model) -> list[str]:
    """A word on parameters whose sign says that a column of the recording has another sign, or another zero."""
    inertia, gravity = (model.estimates.get(name) for name in ("inertia", "gravity"))
    if inertia is not None and inertia.value < -3 * inertia.std:
        return ["inertia came out negative: torque and position have opposite signs, turn one of them round"]
    if gravity is not None and gravity.value < -3 * gravity.std:
        return ["gravity came out negative: position 0 seems to be the upright position, it should hang down"]
    return []


def turned_round(model: Model) -> str | None:
    """What to do if every parameter of the base model came out negative, as where the torque is logged turned round."""
    values = [model.estimates[name] for name in ("inertia", "gravity", "viscous", "coulomb") if name in model.estimates]
    clear = [estimate.value < -3 * estimate.std for estimate in values]
    if len(values) < 3 or sum(clear) < 3 or not clear[0] or any(estimate.value > 0 for estimate in values):
        return None
    return wrong_signs(model)[0]


def is_nothing(model: Model, term: Term) -> bool:
    """Whether every linear parameter of a term is as good as zero by its own standard error."""
    own = [model.estimates[column.name] for column in term.columns]
    return bool(own) and all(abs(estimate.value) < NOTHING * estimate.std for estimate in own)


def objection(after: Step, before: Step, x: Samples, torque: float = HELD_OUT) -> str | None:
    """What speaks against an added effect, None if nothing does.

    Args:
        after: the step with the effect.
        before: the step without it.
        x: samples of the training data.
        torque: share of the held-out torque error to which it has to lower it.
    """
    new, old = after.errors["holdout"], before.errors["holdout"]
    wrong = impossible(after.model, x)
    if wrong:
        return f"makes {' and '.join(wrong)} negative"
    for column, value in beyond(after.model.terms, after.model.theta):
        return f"would have {column.name} = {value:.3g} {column.unit}, which no body has"
    if new.position_rms >= old.position_rms:
        return (
            f"does not lower the held-out error of free-running simulation "
            f"({old.position_rms:.3g} -> {new.position_rms:.3g} rad)"
        )
    if new.torque_rms >= torque * old.torque_rms:
        return f"does not clearly lower the held-out torque error ({old.torque_rms:.3g} -> {new.torque_rms:.3g} N m)"
    return None
