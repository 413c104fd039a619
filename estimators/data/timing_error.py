"""Standard errors of parameters fitted to torque with an estimated delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.checks.alignment import Alignment
from estimators.data.fit_data import FitData
from estimators.data.fits import compute_parameter_changes
from estimators.data.regression_data import RegressionData
from estimators.weak_form.windows import average_held_torque
from pendulum_env._typing import Array
from pendulum_env.physics import Model, find_link, has_link


def widen_by_timing(model: Model, data: FitData, train: RegressionData) -> Model:
    """Add the error of the timing of corrected torque to the standard errors and correlations of a model.

    By the delta method: the covariance gets d d' for each delay and each lag, with d the change of the parameters by
    one standard error of it. Recordings with one alignment change together. A delay of half a sample has the error of a
    free delay: a controller that sets the torque n times a sample is late by (1 - 1/n) / 2 samples. Delay and lag count
    as independent, which widens the errors where they compensate each other.

    Args:
        model: fitted to the windows of `train`.
        data: timed recordings.
        train: fitted rows of torque of these; the model is returned unchanged without the states of its link.
    """
    if has_link(model.terms) and find_link(model.terms).id not in train.data.link_states:
        return model
    laws = dict.fromkeys(law for law in data.alignments[: len(data.recordings)] if law.is_late)
    changes = (
        compute_parameter_changes(train, model, _change_torque(train, _list_torques(data, law, later, slower)))
        for law in laws
        for later, slower in ((law.delay_std, 0.0), (0.0, law.lag_std if law.lag > 0 else 0.0))
        if np.isfinite(later + slower) and later + slower > 0
    )
    return model.add_errors(*changes)


def _list_torques(data: FitData, law: Alignment, later: float, slower: float) -> list[Array]:
    """Return the torque of each fitted recording, (N,) or (N, J) [N m], with changes of delay and lag of one law [s].

    Recordings with another law have the torque of `data`.
    """
    excluded = {outlier.recording - 1 for outlier in data.excluded}
    untimed = (data.untimed or data).recordings
    logged = [recording for k, recording in enumerate(untimed) if k not in excluded]
    triples = zip(logged, data.recordings, data.alignments, strict=False)
    return [law.apply(raw, later, slower).torque if actual == law else timed.torque for raw, timed, actual in triples]


def _change_torque(train: RegressionData, torques: Sequence[Array]) -> RegressionData:
    """Return rows with another torque of each recording; recordings may begin as those of the rows and last longer."""
    windows = []
    for k, w in enumerate(train.data.windows):
        run, joint = (k, 0) if w.run is None else (w.run, train.data.joints.index(w.at))
        torque = torques[run].reshape(len(torques[run]), -1)[: len(w.moving), joint]
        windows.append(w.with_torque(torque, average_held_torque(torque)))
    return replace(train, data=replace(train.data, windows=tuple(windows)))
