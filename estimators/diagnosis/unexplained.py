"""What the final model of a joint leaves unexplained, in torque or in motion: where it is, and what is said of it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.diagnosis.reasons import describe_violations
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.motion import is_misfit
from estimators.selection.physical import violations
from estimators.selection.prepared import Comparable
from estimators.selection.search import SearchResult
from estimators.signals.motion import SLOWEST
from estimators.signals.residual import Region, everywhere, stand_out
from pendulum_env._typing import Array
from pendulum_env.physics import Term
from pendulum_env.words import listing


def unexplained(found: SearchResult) -> list[Region]:
    """Regions that the final model leaves unexplained, in torque or else in free-running motion, fitted or held out."""
    evaluator, last = found.evaluator, found.steps[-1]
    wrong = describe_violations(violations(last.model, evaluator.train.motions))
    if wrong:
        text = (
            f"the best fit has {listing(wrong)}, which no body has: check the signs of torque and position, "
            "or record a motion of more than one frequency"
        )
        return [everywhere(text)]
    left = evaluator.train.with_link_states(last.model).residual(last.model.terms, last.model.theta)
    is_noise = found.table is None and evaluator.residuals.is_noise_in(evaluator.train, left)
    regions = [] if is_noise else stand_out(evaluator.train.samples, left, evaluator.residuals.noise_floor())
    if found.table is not None:
        place = next((own for own in regions if own.axis == found.table.axis), None)
        text = f"{found.table.told} would explain most of it, and no effect of the library is such a law"
        if place is None:
            return [everywhere(text, evaluator.train.samples), *regions]
        return [replace(place, text=f"{text}; {place.text}"), *(own for own in regions if own is not place)]
    if not is_noise:
        return regions or _nowhere(evaluator, evaluator.train, left)
    unseen = evaluator.residuals.holdout_residual(last.model.terms)
    if not evaluator.residuals.is_noise_in(evaluator.holdout, unseen):
        beyond = stand_out(evaluator.holdout.samples, unseen, evaluator.residuals.noise_floor(evaluator.holdout))
        unlike = f"in what was held out ({held_out(evaluator)})"
        beyond = beyond or _nowhere(evaluator, evaluator.holdout, unseen)
        return [replace(region, text=f"{unlike} {region.text}") for region in beyond]
    if not is_misfit(evaluator, last):
        return []
    error = last.errors["train"].position_rms
    text = (
        f"the torque fits where the joint moves freely, but free-running simulation errs by {error:.2g} rad: "
        "something acts near reversals or at rest, where velocity is close to zero"
    )
    return [Region("velocity", -SLOWEST, SLOWEST, 0.0, 0.0, text)]


def of_held_out(evaluator: ModelEvaluator, final: Sequence[Term]) -> str | None:
    """What is said where held-out data alone show more."""
    return fit_that(evaluator) if evaluator.residuals.is_noise_by_part(tuple(final)) == (True, False) else None


def fit_that(evaluator: ModelEvaluator) -> str:
    """What is said where what was fitted is explained, and what was held out is not."""
    return f"what was fitted is explained, and what was held out ({held_out(evaluator)}) is not: fit that, too"


def held_out(evaluator: ModelEvaluator) -> str:
    """Names of the held-out recordings."""
    return listing(list(dict.fromkeys(recording.name for recording in evaluator.holdout.recordings)))


def _nowhere(evaluator: ModelEvaluator, part: Comparable, left: Array) -> list[Region]:
    """What is said of a residual (R,) that stands out nowhere: nothing, unless it is too much for noise."""
    size, floor = float(np.sqrt(np.mean(left**2))), evaluator.residuals.noise_floor(part)
    if size <= evaluator.criterion.misfit * floor:
        return []
    text = (
        f"{size:.2g} N m of torque are left, {size / floor:.2g} times what the sensors' noise gives, at no one speed, "
        "angle or time: something faster than can be resolved here, or now and then"
    )
    return [everywhere(text, part.samples, size, floor)]
