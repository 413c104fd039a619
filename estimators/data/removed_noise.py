"""Noise that a model removes from rows of torque."""

from collections.abc import Mapping

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.weak_form.rows import Terms
from pendulum_env._typing import Array


def list_absorbed_noise(data: RegressionData, terms: Terms) -> list[tuple[slice, float]]:
    """Return, per term that filters torque, its rows and the variance of noise that it removes [(N m)^2].

    Rows of positions have none.
    """
    return data.torque.list_absorbed_noise(terms) if data.layout.predicts_torque else []


def compute_removed_noise(data: RegressionData, terms: Terms, theta: Array, inertia: Mapping[str, float]) -> Array:
    """Return the variance of encoder noise that payload changes remove from each row (R,) [(N m)^2].

    Encoder noise enters the rows times the inertia. An effect must not become likelier by removing it: where
    nothing accelerates, a payload of minus the inertia leaves torque without noise. `theta` (P,) are the
    parameters, `inertia` those of the base model by joint [kg m^2].
    """
    variance = np.zeros(len(data.layout.scored.fold))
    columns = [(term, column) for term in terms for column in term.columns]
    for (term, column), value in zip(columns, theta.tolist(), strict=True):
        if term.kind == "time-varying" and data.layout.predicts_torque and term.at in inertia:
            part, before = data.data.part(term.at), inertia[term.at]
            noise = np.repeat([w.noise.acceleration for w in part.windows], [len(w.centers) for w in part.windows])
            after = np.clip(before + value * column.mass(part.samples), 0.0, before)
            variance[data.locate_rows(term.at)] += (before**2 - after**2) * noise**2
    return variance
