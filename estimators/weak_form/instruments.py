"""Least squares by instruments: what a controller's torque owes to the sensor's noise does not bias the parameters.

In a closed loop torque answers the measured position, noise and disturbances included, so that regressors and error are
correlated and least squares is biased. The reference that the controller follows is not: the same regressors evaluated
along it, Z, are correlated with the motion alone,

    theta = (Z' phi)^-1 Z' y .

Source: Janot, Vandanjon and Gautier, Control Engineering Practice 25, 2014; Young, Recursive Estimation and Time-Series
Analysis, chapter 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.regression.equations import IdentificationError
from estimators.weak_form.dataset import dataset, prepare
from estimators.weak_form.windows import cut
from pendulum_env.physics import Model, Term
from pendulum_env.recording import Recording

HOPELESS = 1e8  # condition number


def fit_by_reference(recordings: Sequence[Recording], terms: Sequence[Term]) -> Model:
    """Linear parameters of the terms, with the terms' columns along the reference as instruments.

    Args:
        recordings: with `reference`, which the motion follows.
        terms: with their shape parameters set; all linear, none with memory or columns of torque.

    Raises:
        IdentificationError: if a recording has no reference, one that moves too little, or a term is no function of
            motion alone.
    """
    for term in terms:
        if term.remembers or term.fixed or any(column.of_torque for column in term.columns):
            raise IdentificationError(f"{term.id} depends on more than the motion: instruments cannot estimate it")
    followed = [_followed(recording) for recording in recordings]
    data = prepare(recordings)
    along = [
        replace(cut(own, (len(w.kernel) // 2) / own.rate), centers=w.centers)
        for w, own in zip(data.windows, followed, strict=True)
    ]
    equations, weights = data.equations(terms), data.weights[:, None]
    z = dataset(along).equations(terms).phi * weights  # (R, P)
    phi, y = equations.phi * weights, equations.y * weights[:, 0]
    # scaled to equal columns
    size = [np.maximum(np.linalg.norm(x, axis=0), 1e-300) for x in (z, phi)]
    if np.linalg.cond(z.T @ phi / np.outer(*size)) > HOPELESS:
        raise IdentificationError("the reference moves too little to tell these parameters: follow a livelier one")
    bread = np.linalg.inv(z.T @ phi)
    theta = bread @ (z.T @ y)
    scores = np.zeros((int(data.clusters.max()) + 1, len(theta)))
    np.add.at(scores, data.clusters, z * (y - phi @ theta)[:, None])
    covariance = bread @ (scores.T @ scores) @ bread.T
    return Model.build(terms, theta, np.sqrt(np.diag(covariance)))


def _followed(recording: Recording) -> Recording:
    """The recording as if the joint had followed the reference."""
    if recording.reference is None:
        raise IdentificationError(
            f"{recording.name}: has no reference, which instruments are made of: name its column with --columns "
            "reference=NAME"
        )
    return replace(recording, position=recording.reference, velocity=None)
