"""Standard errors of parameters fitted to torque with an estimated delay."""

from collections.abc import Iterator

import numpy as np

from estimators.data.fit_data import FitData
from estimators.data.fits import compute_parameter_changes
from estimators.data.regression_data import RegressionData
from pendulum_env._typing import Array
from pendulum_env.physics import Model, find_link, has_link
from pendulum_env.physics.actuation import ActuatorLag


def widen_by_timing(model: Model, data: FitData, train: RegressionData) -> Model:
    """Add the error of the timing of corrected torque to the standard errors and correlations of a model.

    By the delta method, the covariance gets d d' for each delay and each lag: d is the change of the parameters by one
    standard error. Recordings with one alignment change together. A delay of half a sample has the error of a free
    delay. A controller that sets the torque n times a sample is late by (1 - 1/n) / 2 samples. Delay and lag count as
    independent, which widens the errors where they compensate each other.

    Args:
        model: fitted to the windows of `train`.
        data: timed recordings.
        train: fitted rows of torque of these; the model is returned unchanged without the states of its link.
    """
    if has_link(model.terms) and find_link(model.terms).id not in train.data.link_states:
        return model
    changes = (compute_parameter_changes(train, model, change) for change in _list_torque_changes(data, train))
    return model.add_errors(*changes)


def _list_torque_changes(data: FitData, train: RegressionData) -> Iterator[Array]:
    """Yield the change of the torque of all rows (R,) [N m] by one standard error of each delay and each lag.

    The acting torque tau of the logged torque u changes by tau' per second of the delay, and by u' = (tau - u) / lag
    per second of the lag.
    """
    windows, laws = train.data.windows, data.alignments
    counts = [len(w.centers) for w in windows]
    for law in dict.fromkeys(law for law in laws[: len(data.recordings)] if law.is_late):
        is_timed = np.repeat([laws[k if w.run is None else w.run] == law for k, w in enumerate(windows)], counts)
        if 0 < law.delay_std < np.inf:
            rates = np.concatenate([w.rates.narrow @ w.samples.torque for w in windows])
            yield law.delay_std * rates * is_timed
        if law.lag > 0 and 0 < law.lag_std < np.inf:
            yield law.lag_std / law.lag * train.data.columns([ActuatorLag(law.lag)])[0][1] * is_timed
