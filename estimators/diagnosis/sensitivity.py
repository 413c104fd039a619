"""Sensitivity of a diagnosis: the smallest effects that the data would show."""

from collections.abc import Mapping

import numpy as np

from estimators.diagnosis.experiment import make_typical_effect
from estimators.diagnosis.result import Detectable
from estimators.selection.errors import Terms
from estimators.selection.evaluator import ModelEvaluator
from estimators.signals.residual import makes_whole_turns
from pendulum_env.physics import Term

TOLD = ("stribeck", "quadratic_drag", "load_dependent_friction", "cogging", "spring")  # as long as they are known
CLEAR = 2.0  # times what counts as structure: windows next to each other share about half of it
DOUBT = 3.0  # times the gain that chance may give, which is then found nearly always


def find_detectable_size(evaluator: ModelEvaluator, terms: Terms, kind: type[Term]) -> float | None:
    """Find the smallest detectable size of an effect added to the terms, in the unit of its first parameter.

    An effect whose torque has a root mean square r after a fit of the terms gains about N/2 log(1 + r^2 / s^2) nats
    over N windows whose noise is s; and r has to be structure, not noise, which N windows may be too few to tell. None
    if no size would do, or the data do not depend on it.
    """
    term, theta = make_typical_effect(kind)
    if not len(theta):
        return None
    (columns,) = evaluator.train.columns([term])
    torque, phi = columns.linear @ theta, evaluator.train.equations(terms).phi
    left = torque - phi @ np.linalg.lstsq(phi, torque, rcond=1e-10)[0]
    shown = float(np.sqrt(np.mean(left**2)))
    if shown < 1e-9 * float(np.sqrt(np.mean(torque**2))) or shown == 0.0:
        return None
    noise = max(evaluator.residuals.noise_floor(), float(np.sqrt(np.mean(evaluator.train.residual(terms) ** 2))))
    correlated = (
        CLEAR * evaluator.criterion.z_score / float(np.sqrt(len(left)))
    )  # r^2 / (r^2 + s^2) that is significantly shared
    if correlated >= 1.0:
        return None
    nats = DOUBT * evaluator.penalty((*terms, term), terms)
    least = max(
        noise * float(np.sqrt(np.expm1(2 * nats / len(left)))),
        noise * float(np.sqrt(correlated / (1.0 - correlated))),
        CLEAR * evaluator.criterion.noise_ratio * evaluator.residuals.noise_floor(),
    )
    return float(np.linalg.norm(theta)) * least / shown


def find_detectable_effects(
    evaluator: ModelEvaluator, terms: Terms, library: Mapping[str, type[Term]]
) -> tuple[Detectable, ...]:
    """Find the smallest detectable size of effects in addition to the terms."""
    sizes = {id: find_detectable_size(evaluator, terms, library[id]) for id in TOLD if id in library}
    units = evaluator.train.units()
    found = [
        Detectable(id, size, units.unit(make_typical_effect(library[id])[0].columns[0].unit))
        for id, size in sizes.items()
        if size is not None
    ]
    stop = Detectable("hard_stop", unit=units.unit("rad"), between=evaluator.train.get_range())
    return tuple(found) if makes_whole_turns(evaluator.train.samples.position) else (*found, stop)
