"""Dry friction that shows in free motion: windows of torque leave out rest and reversals, where it acts in full.

Friction that differs at rest decides when a joint sticks and breaks away. A fit to simulated motion starts from the
best of several variants and sizes of an effect, since the windows determine neither.
"""

from itertools import groupby

import numpy as np

from estimators.decisions.errors import Terms
from estimators.search_hints import is_possible, make_grid
from estimators.selection.evidence import Evidence
from estimators.simulation import output_error
from estimators.weak_form.point import Point
from pendulum_env._typing import Array
from pendulum_env.physics import Model, Samples, Term, is_dry, list_ids
from pendulum_env.physics.effect_texts import name_effect

SHARES = (0.1, 0.3, 1.0, -0.1, -0.3)  # of the dry friction of the model, sizes of an effect in the best start


def screen_dry_friction(evidence: Evidence, terms: Terms) -> list[Terms]:
    """Return the terms plus each possible effect of dry friction, fitted to free motion, the largest gain first.

    The list is empty without segments, or if the terms are no misfit to the motion.
    """
    if not evidence.motion.has_misfit(terms):
        return []
    ids, models = list_ids(terms), list[Terms]()
    for id, kind in evidence.library.items():
        if id in ids or not is_dry(kind()):
            continue
        evidence.progress(f"fitting {name_effect(id)} to the motion", 0.5)
        x = evidence.train.motions[kind.at]
        starts = list_starts(evidence, terms, make_grid(kind, x, np.zeros_like(x.torque)), x)
        if starts:
            models.append(evidence.fits.fit_to_motion(Model.build(*choose_start(evidence, starts)), id).model.terms)
    possible = [longer for longer in models if is_possible(longer[-1], evidence.train.motions[longer[-1].at])]
    return sorted(possible, key=lambda longer: -evidence.motion.compare(longer, terms)[0].total)


def list_starts(evidence: Evidence, terms: Terms, variants: list[Term], x: Samples) -> list[Point]:
    """Return points with each variant of an effect, each of its columns in several sizes, and the terms.

    The terms have their parameters of the fit to torque, or of that to motion. `x` are samples of the motion.
    """
    fitted = evidence.fits.fit(terms)
    others = [Point.from_model(step.model) for step in (fitted, evidence.fits.refit_to_motion(fitted))]
    starts = []
    for variant in variants:
        largest = [float(np.max(np.abs(np.broadcast_to(column.dry(x), x.time.shape)))) for column in variant.columns]
        for other in others:
            friction = abs(other.linear_values.get("coulomb", 0.0))
            for k, of_column in enumerate(largest):
                for size in friction / max(of_column, 1e-300) * np.array(SHARES) if of_column else ():
                    sizes = np.where(np.arange(len(largest)) == k, size, 0.0)
                    point = Point.from_parameters((*other.terms, variant), np.append(other.theta, sizes))
                    if point.theta[len(other.theta) + k] == size:  # within its bounds
                        starts.append(point)
    return starts


def choose_start(evidence: Evidence, starts: list[Point]) -> Point:
    """Return the point with the least errors of free motion, by the mean logarithm over training segments.

    Variants of a table differ in the number of parameters; those with the same number are simulated as one batch.
    """
    sizes = list[float]()
    for _, batch in groupby(starts, key=lambda start: len(start.theta)):
        errors, segment = output_error.compute_errors(evidence.train.segments, list(batch))
        squares: list[Array] = [np.bincount(segment, series**2) / np.bincount(segment) for series in errors.T]
        sizes += [float(np.mean(np.log(segment_squares + 1e-24))) for segment_squares in squares]
    return starts[int(np.argmin(sizes))]
