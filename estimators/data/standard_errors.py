"""Standard errors by an estimated delay of the torque, by its constant, and of the ends of a hard stop."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.checks.alignment import NO_ALIGNMENT
from estimators.data.fit_data import FitData
from estimators.data.fits import compute_parameter_changes, fit_terms, linearise
from estimators.data.regression_data import RegressionData
from estimators.data.settings import DATA
from estimators.findings import Finding, Quantity
from estimators.free_swings import remove_unit_inertia
from estimators.regression.least_squares import project_out
from estimators.signals.channel import Channel
from estimators.signals.differentiation import estimate_encoder_noise
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env._typing import Array
from pendulum_env.physics import SIGNIFICANT, Estimate, Model, find_link, has_link
from pendulum_env.physics.actuation import ActuatorLag
from pendulum_env.recording import Recording, TorqueConstant
from pendulum_env.units import is_of_torque


def widen_by_timing(model: Model, data: FitData, train: RegressionData) -> Model:
    """Add the error of the timing of the torque to the standard errors and correlations of a model.

    By the delta method, the covariance gets d d' for each delay and each lag: d is the change of the parameters by one
    standard error, or by the rival law if a delay and a filter explain the torque equally. Recordings with one
    alignment change together. A delay of half a sample has the error of a free delay. A controller that sets the torque
    n times a sample is late by (1 - 1/n) / 2 samples. Delay and lag count as independent, which widens the errors where
    they compensate each other. Logged torque that is not corrected may be late by a sample, as far as the residual
    allows, unless a term of the model delays it.

    Args:
        model: fitted to the windows of `train`.
        data: timed recordings.
        train: fitted rows of torque of these; the model is returned unchanged without the states of its link.
    """
    if has_link(model.terms) and find_link(model.terms).id not in train.data.link_states:
        return model
    changes = (compute_parameter_changes(train, model, change) for change in _list_torque_changes(model, data, train))
    return model.add_errors(*changes)


def _list_torque_changes(model: Model, data: FitData, train: RegressionData) -> Iterator[Array]:
    """Yield the change of the torque of all rows (R,) [N m] by each error of the timing.

    The acting torque tau of the logged torque u changes by tau' per second of the delay, and by u' = (tau - u) / lag
    per second of the lag.
    """
    windows, laws = train.data.windows, data.timing.alignments or (NO_ALIGNMENT,) * len(data.recordings)
    counts = [len(w.centers) for w in windows]
    of_windows = [
        law if law.is_late and law.moves(w.at) else None
        for w, law in ((w, laws[k if w.run is None else w.run]) for k, w in enumerate(windows))
    ]
    rates = np.concatenate([w.rates.narrow @ w.samples.torque for w in windows])
    is_open = [law is None and w.recording.has_logged_torque for w, law in zip(windows, of_windows, strict=True)]
    if any(is_open) and not any(term.delays_torque for term in model.terms):
        change = rates * np.repeat(is_open, counts)
        yield _bound_delay(model, train, change) * change
    for law in dict.fromkeys(law for law in of_windows if law is not None):
        is_timed = np.repeat([own == law for own in of_windows], counts)
        if 0 < law.delay_std < np.inf:
            yield law.delay_std * rates * is_timed
        if law.lag > 0 and 0 < law.lag_std < np.inf:
            yield law.lag_std / law.lag * train.data.columns([ActuatorLag(law.lag)])[0][1] * is_timed
        if law.rival_lag:  # by the law that undoes the delay and applies the filter, to first order
            rival = Channel(-law.delay, law.rival_lag)
            yield train.data.columns([rival])[0][1] * is_timed


def _bound_delay(model: Model, train: RegressionData, rates: Array) -> float:
    """Return the standard error of an unknown delay of the torque [s]: a sample, unless the residual allows less.

    `rates` (R,) are the derivatives of the torque by the delay. Their noise is no information, but scatters the delay.
    """
    rows, period = linearise(train, model), max(1.0 / recording.rate for recording in train.recordings)
    unexplained = project_out(np.linalg.qr(rows.slopes)[0], rates * rows.weights)
    noise = np.concatenate([w.row_scale * w.noise.torque_rate for w in train.data.windows])
    total = float(unexplained @ unexplained)
    signal = max(total - float(np.sum((noise * (rates != 0) * rows.weights) ** 2)), 0.0)
    information = signal**2 / max(total * float(np.mean(rows.residual**2)), 1e-300)
    return period / np.sqrt(1.0 + information * period**2)


def add_torque_constant(model: Model, data: TorqueWindows) -> Model:
    """Add the torque constant, and the standard errors it causes, to a model.

    Args:
        model: fitted to the data, in the unit of their torque.
        data: windows of recordings with a constant. Without a constant, the model is converted to their units.
    """
    recording = data.windows[0].recording
    constant = recording.torque_constant
    if constant is None:
        return remove_unit_inertia(model.convert_units(recording.units))
    theta, changed = (
        fit_terms(RegressionData(own), model.terms)[0].theta
        for own in (data, data.with_torque(1 + constant.std / constant.value))
    )
    return widen_by_constant(model, constant, changed - theta)


def widen_by_constant(model: Model, constant: TorqueConstant, change: Array | None = None) -> Model:
    """Add the error of the torque constant to standard errors and correlations of a model, and set the constant.

    `change` (P,) is that of the linear parameters by one standard error of the constant. By default they change as the
    nonlinear ones: those in a unit of torque by the relative error of the constant.
    """
    share = constant.std / constant.value
    changes = {name: share * e.value for name, e in model.estimates.items() if is_of_torque(e.unit)}
    if change is not None:
        changes |= dict(zip((column.name for column in model.columns), change.tolist(), strict=True))
    known = Estimate(constant.value, constant.std, constant.unit)
    return replace(model.add_errors(changes), torque_constant=known)


def widen_ends(model: Model, recordings: Sequence[Recording]) -> Model:
    """Return the model with standard errors of a stop's ends of at least the step of the motion across them.

    The force of a stop begins at an angle between two samples. A few contacts have no scatter that would show this
    error: the least error of an end is the RMS step of the position across it, over the root of the number of contacts.
    The end of a stop of unknown stiffness lies between its estimate and the farthest position.
    """
    changed = dict[str, Estimate]()
    for term in (term for term in model.terms if term.has_impacts):
        for name in {parameter.name for parameter in term.free} & {"lower", "upper"}:
            end = model.estimates[term.get_full_name(name)]
            steps = np.concatenate([_list_steps(recording, end.value) for recording in recordings])
            if len(steps):  # two for each contact
                least = float(np.sqrt(np.mean(steps**2) / (0.5 * len(steps))))
                if model.estimates[term.columns[0].name].is_unknown:
                    std = max(least, float(_list_depths(recordings, name, end.value).max()))
                else:
                    std = max(end.std, least)
                changed[term.get_full_name(name)] = replace(end, std=std)
    return replace(model, estimates={**model.estimates, **changed}) if changed else model


@dataclass(frozen=True)
class StiffStop(Finding):
    """Stop with a stiffness that the recordings do not determine.

    Attributes:
        effect: id of the stop.
        parameters: its undetermined parameters.
        angle: one of its ends.
        depth: largest depth beyond an end.
    """

    effect: str
    parameters: tuple[str, ...]
    angle: Quantity
    depth: Quantity

    @property
    def withheld(self) -> tuple[str, ...]:
        """Names of the undetermined parameters."""
        return self.parameters


def find_stiff_stops(model: Model, recordings: Sequence[Recording]) -> list[StiffStop]:
    """Return a finding on each stop with a stiffness that the recordings do not determine.

    The depths at each end vary by at most 3 standard errors of the end, as under one torque at rest, or if the stop
    yields too little. Nine tenths of the samples show the variation: a crossing of the end is short.
    """
    findings, widened = list[StiffStop](), widen_ends(model, recordings)
    for term in (term for term in model.terms if term.has_impacts and not term.at):
        names = [parameter.name for parameter in term.free]
        ends = {name: widened.estimates[term.get_full_name(name)] for name in names if name in ("lower", "upper")}
        depths = {name: _list_depths(recordings, name, end.value) for name, end in ends.items()}
        ranges = {name: np.ptp(np.quantile(depths[name], [0.1, 1.0])) for name in ends}
        if ends and all(ranges[name] <= SIGNIFICANT * end.std for name, end in ends.items()):
            unknown = [term.columns[0].name, *(term.get_full_name(name) for name in names if name not in ends)]
            unit = model.units().unit("rad")
            angle = Quantity(next(iter(ends.values())).value, unit=unit)
            depth = Quantity(max(float(depths_at_end.max()) for depths_at_end in depths.values()), unit=unit)
            findings.append(StiffStop(term.id, tuple(unknown), angle, depth))
    return findings


def _list_depths(recordings: Sequence[Recording], name: str, end: float) -> Array:
    """List the depths of all samples beyond the `lower` or `upper` end of the range [rad], and 0."""
    sign = 1.0 if name == "upper" else -1.0
    depths = np.concatenate([np.zeros(1), *(sign * (recording.position - end) for recording in recordings)])
    return np.asarray(depths[depths >= 0])


def _list_steps(recording: Recording, end: float) -> Array:
    """Return the steps of the position across an angle, in both directions [rad]; noise crosses it by smaller steps."""
    is_beyond, steps = recording.position > end, np.diff(recording.position)
    steps[[start - 1 for start in recording.starts if start]] = 0.0  # gaps
    is_large = np.abs(steps) > DATA.crossing * estimate_encoder_noise(recording)
    return np.asarray(steps[(is_beyond[1:] != is_beyond[:-1]) & is_large])
