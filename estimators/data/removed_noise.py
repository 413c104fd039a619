"""Noise that a model removes from rows of torque."""

from collections.abc import Mapping

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.weak_form.rows import Terms
from pendulum_env._typing import Array
from pendulum_env.physics.joints import Links


def list_absorbed_noise(data: RegressionData, terms: Terms) -> list[tuple[slice, float]]:
    """Return, per term that filters torque, its rows and the variance of noise that it removes [(N m)^2].

    Rows of positions have none.
    """
    return data.torque.list_absorbed_noise(terms) if data.layout.predicts_torque else []


def compute_removed_noise(data: RegressionData, terms: Terms, theta: Array, inertia: Mapping[str, float]) -> Array:
    """Return the variance of encoder noise that a model removes from each row (R,) [(N m)^2].

    Encoder noise enters the rows times the inertia. A model must not become likelier by removing it: without inertia,
    or where a payload of minus the inertia leaves none, the torque has no such noise. `theta` (P,) are the parameters,
    `inertia` those of the base model by joint [kg m^2].
    """
    variance = np.zeros(len(data.layout.scored.fold))
    if not data.layout.predicts_torque:
        return variance
    columns = [(term, column) for term in terms for column in term.columns]
    has_links = any(isinstance(term, Links) for term in terms)
    for at, before in inertia.items():
        part, after = data.data.part(at), np.full(1, before if has_links else 0.0)
        for (term, column), value in zip(columns, theta.tolist(), strict=True):
            if term.at == at and not isinstance(term, Links) and np.any(mass := column.mass(part.samples)):
                after = after + value * mass
        if np.any(after < before):
            noise = np.concatenate([w.noise.acceleration * w.row_scale for w in part.windows])
            variance[data.locate_rows(at)] = (before**2 - np.clip(after, 0.0, before) ** 2) * noise**2
    return variance
