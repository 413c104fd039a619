"""Predictions of recordings by a model at each sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from estimators.data.fit_data import FitData
from estimators.data.preparation import find_preparation
from estimators.data.regression_data import RegressionData
from estimators.regression.least_squares import IdentificationError
from estimators.simulation.free_running import Segments, simulate_errors
from estimators.weak_form import links
from estimators.weak_form.blocks import list_recordings
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import TorqueWindows, join_windows
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Model, Samples
from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.recording import Recording
from pendulum_env.units import JointUnits

QUANTITIES = ("position", "torque", "predicted_torque", "residual", "simulated_position")


@dataclass(frozen=True, eq=False)
class Prediction:
    """A recording of N samples and its prediction by a model.

    Arrays are (N,), for n joints with links (N, n). A sample without a value is NaN.

    Attributes:
        name: name of the recording.
        time: instants (N,) [s].
        position: measured position (N,) [rad].
        torque: measured torque, averaged over a short window about each sample (N,) [N m]. NaN if the joint sticks or
            reverses within the window, and near gaps.
        predicted_torque: torque of the model for the measured motion, averaged over the same windows (N,) [N m].
        simulated_position: position of free-running simulations of one second, each from the measured state (N,) [rad].
            With a controller, the whole recording is simulated from its reference. Links are not simulated.
            `position_rms` leaves out seconds in which a small error grows tenfold.
        is_counted: mask of the samples in `torque_rms`, half a window apart (N,).
        is_held_out: mask of the samples that were not fitted (N,); None in a comparison.
        units: units of each joint; `units[""].unit("N m")` is the unit of torque of a pendulum.
    """

    name: str
    time: Array
    position: Array
    torque: Array
    predicted_torque: Array
    simulated_position: Array
    is_counted: Mask
    is_held_out: Mask | None
    units: Mapping[str, JointUnits]

    @property
    def residual(self) -> Array:
        """Measured minus predicted torque (N,) [N m]."""
        return self.torque - self.predicted_torque

    @property
    def columns(self) -> dict[str, Array]:
        """Return time and all quantities by name, (N,) each; those of several joints by joint (`torque_elbow`)."""
        named = {"time": self.time}
        for quantity in QUANTITIES:
            for at, values in zip(self.units, getattr(self, quantity).reshape(len(self.time), -1).T, strict=True):
                named[f"{quantity}_{at}" if at else quantity] = values
        return named

    def __repr__(self) -> str:
        shares = (f"{np.mean(np.isfinite(values)):.0%}" for values in (self.residual, self.simulated_position))
        return "<Prediction of {}: {} samples, torque of {} and position of {} predicted>".format(
            self.name, len(self.time), *shares
        )


def predict_recordings(model: Model, data: FitData | None) -> tuple[Prediction, ...]:
    """Predict the fitted, then the held-out recordings of a result.

    Raises:
        IdentificationError: if the result has no data.
    """
    if data is None:
        raise IdentificationError("the result has no data: compare its model with the recordings")
    predictions = [_make_empty_prediction(model, recording) for recording in data.all_recordings]
    loop = find_preparation(data.all_recordings).simulate(model, data.all_recordings)
    if data.is_comparison:
        predictions = [replace(prediction, is_held_out=None) for prediction in predictions]
    with suppress(*[IdentificationError] * bool(loop)):  # a joint may move too little for a regression of its torque
        fitted, held_out = data.parts
        _predict(model, fitted, predictions[: len(data.recordings)], False)
        if not data.is_comparison:
            _predict(model, held_out, predictions[len(data.recordings) if data.holdout else 0 :], True)
    if loop:
        for k, recording in enumerate(data.all_recordings):
            predictions[k].simulated_position[:] = loop.select_recording(k).interpolate(recording)
    return tuple(predictions)


def _make_empty_prediction(model: Model, recording: Recording) -> Prediction:
    """Make a prediction with NaN for torques and simulated positions; no sample is counted or held out."""
    shape = recording.position.shape
    torque, predicted, simulated = (np.full(shape, np.nan) for _ in range(3))
    units = {at: model.mechanism.units(at, recording.units) for at in recording.names}
    counted, held_out = np.zeros(shape, dtype=bool), np.zeros(len(recording.time), dtype=bool)
    time, position = recording.time, recording.position
    return Prediction(recording.name, time, position, torque, predicted, simulated, counted, held_out, units)


def _predict(model: Model, data_part: RegressionData, predictions: Sequence[Prediction], is_held_out: bool) -> None:
    """Fill in the predictions of recordings, or of a part of each, from windows about every sample.

    The windows of the fit replace those about the same samples, which are counted. Simulated positions need a known
    inertia.
    """
    data_part = data_part.with_link_states(model)
    data = data_part.data
    runs = list_recordings(data.windows)
    for run, prediction in enumerate(predictions):
        windows = [w for k, w in zip(runs, data.windows, strict=True) if k == run]
        if all(w.stick.is_clear.any() for w in windows):
            link_states = {id: [states[run]] for id, states in data.link_states.items()}
            dense = _make_windows_at_samples(model, windows, link_states)
            _write_torque(
                prediction, dense.windows, dense.torque.applied, TorqueRows(dense).residual(model.terms, model.theta)
            )
    ends = np.cumsum([len(w.centers) for w in data.windows])[:-1]
    coarse = (np.split(values, ends) for values in (data.torque.applied, data_part.residual(model.terms, model.theta)))
    for run, w, torque, residual in zip(runs, data.windows, *coarse, strict=True):
        prediction = predictions[run]
        _write_torque(prediction, [w], torque, residual)
        begin, joint = _locate_windows(prediction, w)
        _split_by_joint(prediction.is_counted)[begin + w.centers, joint] = True
        if prediction.is_held_out is not None:
            prediction.is_held_out[begin + w.first : begin + w.stop] |= is_held_out
    simulated = data_part.segments if model.has_known_inertia else ()
    for prediction, segments in zip(predictions, simulated, strict=False):
        _simulate(model, segments, prediction.simulated_position)


def _make_windows_at_samples(
    model: Model, windows: Sequence[Windows], link_states: Mapping[str, Sequence[Samples]]
) -> TorqueWindows:
    """Make the equations of one recording about every sample that is clear of stick."""
    dense = [w.center_at_every_sample() for w in windows]
    if isinstance(model.mechanism, LinkedMechanism):
        return links.join_recording(dense, model.terms)
    return replace(join_windows(dense), link_states=link_states)


def _split_by_joint(values: Array) -> Array:
    """Return a view (N, n) of values (N,) or (N, n)."""
    return values.reshape(len(values), -1)


def _locate_windows(prediction: Prediction, w: Windows) -> tuple[int, int]:
    """Return the index of the first sample of windows in a recording, and the index of their joint."""
    return int(np.searchsorted(prediction.time, w.recording.time[0])), list(prediction.units).index(w.at)


def _write_torque(prediction: Prediction, windows: Sequence[Windows], torque: Array, residual: Array) -> None:
    """Fill in torque and predicted torque at the centres of windows of one recording, from torque and residual (R,)."""
    n_rows = 0
    for w in windows:
        rows = slice(n_rows, n_rows := n_rows + len(w.centers))
        begin, joint = _locate_windows(prediction, w)
        _split_by_joint(prediction.torque)[begin + w.centers, joint] = torque[rows]
        _split_by_joint(prediction.predicted_torque)[begin + w.centers, joint] = torque[rows] - residual[rows]


def _simulate(model: Model, segments: Segments, position: Array) -> None:
    """Fill in free-running simulations of segments; of overlapping segments, the later."""
    path = segments.position + simulate_errors(segments, model.terms, model.theta)
    index = segments.first + np.arange(len(path))[:, None]
    position[segments.first] = path[0]
    position[index[1:].T.ravel()] = path[1:].T.ravel()
