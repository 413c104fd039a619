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
from estimators.weak_form.dataset import Dataset, dataset
from estimators.weak_form.windows import cut
from pendulum_env.physics import Model, Term
from pendulum_env.recording import Recording

HOPELESS = 1e8  # condition number


def fit_by_reference(data: Dataset, terms: Sequence[Term]) -> Model:
    """Linear parameters of the terms, with the terms' columns along the reference as instruments.

    Args:
        data: windows of recordings with `reference`, which the motion follows.
        terms: with their shape parameters set; all linear, none with memory or columns of torque. Parameters that
            would leave their bounds stay there, and those that are known are so.

    Raises:
        IdentificationError: if a recording has no reference, one that moves too little, or a term is no function of
            motion alone.
    """
    for term in terms:
        if term.remembers or term.fixed or any(column.of_torque for column in term.columns):
            raise IdentificationError(f"{term.id} depends on more than the motion: instruments cannot estimate it")
    followed = [_followed(w.recording) for w in data.windows]
    along = [
        replace(cut(own, (len(w.kernel) // 2) / own.rate), centers=w.centers)
        for w, own in zip(data.windows, followed, strict=True)
    ]
    equations, weights = data.equations(terms), data.weights[:, None]
    z = dataset(along).equations(terms).phi * weights  # (R, P)
    phi, y = equations.phi * weights, equations.y * weights[:, 0]
    columns = [column for term in terms for column in term.columns]
    least, most = (np.array([getattr(column, end) for column in columns]) for end in ("least", "most"))
    theta, free = np.clip(np.zeros(len(columns)), least, most), least < most
    while free.any():
        own, instruments = phi[:, free], z[:, free]
        # scaled to equal columns
        size = [np.maximum(np.linalg.norm(x, axis=0), 1e-300) for x in (instruments, own)]
        if np.linalg.cond(instruments.T @ own / np.outer(*size)) > HOPELESS:
            raise IdentificationError("the reference moves too little to tell these parameters: follow a livelier one")
        bread = np.linalg.inv(instruments.T @ own)
        theta[free] = bread @ (instruments.T @ (y - phi[:, ~free] @ theta[~free]))
        bounded = np.clip(theta, least, most)
        if (bounded == theta).all():
            break
        theta, free = bounded, free & (bounded == theta)
    std = np.zeros(len(columns))
    if free.any():
        scores = np.zeros((int(data.clusters.max()) + 1, len(bread)))
        np.add.at(scores, data.clusters, instruments * (y - phi @ theta)[:, None])
        std[free] = np.sqrt(np.diag(bread @ (scores.T @ scores) @ bread.T))
    return Model.build(terms, theta, std)


def _followed(recording: Recording) -> Recording:
    """The recording as if the joint had followed the reference."""
    if recording.reference is None:
        raise IdentificationError(
            f"{recording.name}: has no reference, which instruments are made of: name its column with --columns "
            "reference=NAME"
        )
    return replace(recording, position=recording.reference, velocity=None)
