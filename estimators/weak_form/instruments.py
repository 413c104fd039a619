"""Least squares with instrumental variables, which removes the bias from feedback of sensor noise.

In a closed loop the torque depends on the measured position and its noise. Regressors and errors are then correlated
and least squares is biased. Regressors Z along the controller's reference are not correlated with the errors,

    theta = (Z' phi)^-1 Z' y .

Source: Janot, Vandanjon and Gautier, Control Engineering Practice 25, 2014; Young, Recursive Estimation and Time-Series
Analysis, chapter 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.regression.least_squares import IdentificationError, solve_within_bounds
from estimators.weak_form.columns import list_bounds, mark_bounds
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.torque_windows import TorqueWindows, join_windows
from estimators.weak_form.windows import cut
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Model, Term
from pendulum_env.recording import Recording
from pendulum_env.settings import format_setting


def fit_by_reference(data: TorqueWindows, terms: Sequence[Term]) -> Model:
    """Fit the linear parameters of the terms within their bounds, with columns along the reference as instruments.

    Args:
        data: windows of recordings with `reference`.
        terms: terms that depend on motion alone, with nonlinear parameters set.

    Raises:
        IdentificationError: if a recording has no reference, the reference moves too little, or a term depends on
            other quantities than motion.
    """
    for term in terms:
        if term.has_hidden_state or term.fixed or any(column.of_torque for column in term.columns):
            raise IdentificationError(f"{term.id} depends on more than the motion: instruments cannot estimate it")
    references = [_replace_by_reference(w.recording) for w in data.windows]
    reference_windows = [
        replace(cut(reference, (len(w.kernel) // 2) / reference.rate), centers=w.centers)
        for w, reference in zip(data.windows, references, strict=True)
    ]
    equations, weights = data.equations(terms), data.weights[:, None]
    z = join_windows(reference_windows).equations(terms).phi * weights  # (R, P)
    phi, y = equations.phi * weights, equations.y * weights[:, 0]
    least, most = list_bounds(terms)

    def solve_free(theta: Array, free: Mask) -> Array:
        theta = theta.copy()
        if free.any():
            theta[free] = _invert_product(z[:, free], phi[:, free]) @ (
                z[:, free].T @ (y - phi[:, ~free] @ theta[~free])
            )
        return theta

    theta, free = solve_within_bounds(solve_free, np.clip(np.zeros(len(least)), least, most), least < most, least, most)
    std = np.zeros(len(least))
    if free.any():
        bread = _invert_product(z[:, free], phi[:, free])
        scores = np.zeros((int(data.clusters.max()) + 1, len(bread)))
        np.add.at(scores, data.clusters, z[:, free] * (y - phi @ theta)[:, None])
        std[free] = np.sqrt(np.diag(bread @ (scores.T @ scores) @ bread.T))
    return mark_bounds(Model.build(terms, theta, std))


def _invert_product(z: Array, phi: Array) -> Array:
    """Return the inverse of the product Z' phi (P, P) of instruments and regressor, (R, P) each."""
    size = [np.maximum(np.linalg.norm(x, axis=0), 1e-300) for x in (z, phi)]
    if np.linalg.cond(z.T @ phi / np.outer(*size)) > RESOLUTION.condition:
        raise IdentificationError("the reference moves too little to tell these parameters: follow a livelier one")
    return np.asarray(np.linalg.inv(z.T @ phi))


def _replace_by_reference(recording: Recording) -> Recording:
    """Replace the motion of a recording by its reference."""
    if recording.reference is None:
        raise IdentificationError(
            f"{recording.name}: has no reference, which instruments are made of: name its column, "
            f"{format_setting('columns', {'reference': 'NAME'})}"
        )
    return replace(recording, position=recording.reference, velocity=None)
