"""Fit of the torque channel: delay, filter and hold between recorded and acting torque.

A law C of the channel (`signals.channel.Channel`) gives the acting torque C u of the logged torque u. It is a term of
the torque balance, fitted by least squares over windows beside columns phi of a model, or beside columns that
approximate nearly any law of the joint,

    C u = phi theta.

These columns are functions of the motion alone, so they cannot imitate a delay.

Source: Golub and Pereyra, Inverse Problems 19(2), 2003 (variable projection); Ramsey, Journal of the Royal Statistical
Society B 31(2), 1969 (powers of the fitted values).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from estimators.checks.alignment import NO_ALIGNMENT, Alignment
from estimators.checks.channel_rows import CHANNEL, NONLINEAR_GAIN, ChannelRows
from estimators.checks.closed_loop import find_feedback, is_consistent
from estimators.decisions.criterion import Criterion
from estimators.decisions.score import Blocks, cross_validate_density
from estimators.regression.balance import Balance
from estimators.regression.least_squares import Fit, IdentificationError
from estimators.signals.channel import LONGEST, REACH, Channel
from estimators.signals.differentiation import estimate_log_noise
from estimators.weak_form.floors import compute_numerical_error
from estimators.weak_form.nonlinear import compute_nonlinear_slopes, refine_nonlinear
from pendulum_env._typing import Array
from pendulum_env.filters import filter_lag
from pendulum_env.physics import Samples, Term
from pendulum_env.recording import Recording


class LogNoise(NamedTuple):
    """White noise of a sample of the torque, and the response of the log to it.

    Attributes:
        std: standard deviation [N m].
        response: response of the log to a sample of the noise (L,).
        is_filtered: whether the noise passed the filter of the log.
    """

    std: float
    response: Array
    is_filtered: bool


class ChannelFits(ChannelRows):
    """Fits of the recorded torque under any law of the channel."""

    @cached_property
    def numerical_error(self) -> float:
        """Norm of the weighted errors of smoothing and integration."""
        return compute_numerical_error(self.rows.data.windows) * float(np.linalg.norm(self.rows.data.weights))

    @cached_property
    def delay_fit(self) -> Alignment:
        """Law with a free delay."""
        return self.fit([self.make_law(CHANNEL.zero), self.start])

    @cached_property
    def zero_shift_fit(self) -> Alignment:
        """Law without delay and lag."""
        return self.fit([Channel()], is_free=False)

    @cached_property
    def half_sample_fit(self) -> Alignment:
        """Law with a delay of half a sample."""
        return replace(self.fit([self.make_law(0.5 * self.period)], is_free=False), is_half_sample=True)

    def fit(self, laws: Iterable[Channel], is_free: bool = True) -> Alignment:
        """Fit the best of some laws: its delay and lag other than zero, unless `is_free` is false.

        A standard error is the largest by clusters of time and, of four or more recordings, by recording.
        """
        law, slopes = min(laws, key=self.compute_misfit), dict[str, Array]()
        if is_free:
            law = self._refine_law(law)
            slopes = compute_nonlinear_slopes(
                law, lambda variants: [-self.compute_torque(variant) for variant in variants]
            )
        fit, errors, predicted = self._fit_torque(self.compute_torque(law), self._list_channels(law), *slopes.values())
        stds = dict(zip(slopes, errors[self.phi.shape[1] :], strict=True))
        delay_std, lag_std = (stds.get(law.get_full_name(name), 0.0) for name in ("delay", "lag"))
        return replace(
            predicted,
            channel=law,
            delay_std=delay_std,
            lag_std=lag_std,
            joint=self.joint,
            gain=(float(fit.theta[0]), errors[0]),
            misfit=float(np.hypot(self.compute_misfit(law), self.numerical_error)),
            period=self.period,
        )

    def _list_channels(self, law: Channel) -> list[Channel]:
        """List the law of each entry of windows, if the joint has a law."""
        return [law if self.joint in ("", w.at) else Channel() for w in self.rows.data.windows]

    def _refine_law(self, law: Channel) -> Channel:
        """Find the law near another one with the least residual; of a filter, relative to the noise by that of the log.

        The residual alone would be least under a filter with too short a time constant, which amplifies less noise.
        """

        def list_residuals(variants: Iterable[Channel]) -> list[Array]:
            return [self.compute_residual(self.compute_torque(variant)) for variant in variants]

        law = refine_nonlinear(law, list_residuals)
        if law.lag <= 0 or not self._has_noise:
            return law
        noises = self._measure_noise(self._list_channels(law))

        def list_relative_residuals(variants: Sequence[Channel]) -> list[Array]:
            pairs = zip(list_residuals(variants), map(self._list_channels, variants), strict=True)
            return [residual / self.compute_amplification(own, residual, noises) for residual, own in pairs]

        return refine_nonlinear(law, list_relative_residuals)

    def fit_given(self, laws: Sequence[Alignment], delays: Sequence[Term] = ()) -> Alignment:
        """Fit the columns under given laws of late torque, one for each recording; return the first with its density.

        Torque that acts late by a law stays as logged. The effects `delays` delay the acting torque, to first order.
        """
        windows, entries = self.rows.data.windows, self.rows.data.recording_of_window
        of_windows = [laws[k if w.run is None else w.run] for k, w in enumerate(windows)]
        channels = [
            law.select_channel(1.0 / w.recording.rate) if law.is_late and law.moves(w.at) else Channel()
            for law, w in zip(of_windows, windows, strict=True)
        ]
        data = self.rows.data
        torques = np.array([data.equations([channel, *delays]).y * data.weights for channel in channels])
        torque = torques[entries, np.arange(len(entries))]
        predicted = self._fit_torque(torque, channels)[2]
        first = next((law for law in laws if law.is_late), NO_ALIGNMENT)
        return replace(first, density=predicted.density, of_block=predicted.of_block, criterion=self.criterion)

    def _fit_torque(
        self, torque: Array, channels: Sequence[Channel], *slopes: Array
    ) -> tuple[Fit, list[float], Alignment]:
        """Fit the columns and `slopes` (R,) to a weighted torque (R,), under a law for each entry of windows.

        Returns:
            The fit by clusters of time, the largest standard errors of the parameters, and the density of the log.
        """
        design = np.column_stack([self.phi, *slopes])
        limits = np.full(design.shape[1], np.inf)
        by_torque = np.zeros_like(design)
        if self.by_torque is not None:
            by_torque[:, : self.by_torque.shape[1]] = self.by_torque
        balance = Balance(design, torque, by_torque, -limits, limits, np.ones(len(design)))
        block, _, of_block = self.rows.data.blocks(self.rows.data.block)
        moved, recording = np.unique(of_block[block], return_inverse=True)
        clusters = [self.rows.data.clusters] + [recording] * (len(moved) >= CHANNEL.min_recordings)
        fits = [balance.fit(labels) for labels in clusters]
        density = cross_validate_density(balance, Blocks(block, recording, of_block, block))
        density += np.bincount(block, np.log(self.rows.data.weights))  # of the torque, not of the weighted residual
        density += np.bincount(block, np.log(self.compute_amplification(channels, fits[0].residual)))  # of the log
        predicted = replace(NO_ALIGNMENT, density=density, of_block=of_block, criterion=self.criterion)
        return fits[0], np.max([fit.std for fit in fits], axis=0).tolist(), predicted

    def fit_shifts(self) -> list[Alignment]:
        """Fit a delay, a lag and both; return those whose parameters are determined.

        A filter of the log delays slow torque by its lag less half a sample. A filter shorter than a sample cannot be
        distinguished from a delay by a share of a sample. A small share of a sample counts if it reduces the misfit.
        """
        delay, criterion = self.delay_fit, self.criterion
        is_small = abs(delay.delay) < criterion.timing.negligible * self.period
        if is_small and delay.misfit > (1 - criterion.equal_error_share) * self.zero_shift_fit.misfit:
            return []
        time, half = delay.delay, 0.5 * self.period * (delay.delay > 0)
        lag = self.fit([self.make_law(0.0, share * time + half) for share in (0.5, 1.0, 1.5)])
        laws = [delay, *[lag] * (abs(lag.lag) >= self.period)]
        if time > 0:
            both = self.fit([self.make_law(share * time, (1 - share) * time + half) for share in (0.25, 0.5, 0.75)])
            laws += [both] * (both.delay > 0 and both.lag > self.period)
        return [law for law in laws if law.is_determined and self.is_possible(law.channel)]

    def list_laws(self) -> list[Alignment]:
        """Fit the possible laws, from the simplest to the most complex; of equal ones the more plausible is first.

        Torque that is late by a quarter to half a sample is more plausibly sampled, and later torque held. A row that
        reacts to its position has the present torque, which was sampled.
        """
        sampled = replace(self, is_sampled=True).with_jump_errors()
        shifts, limits = self.fit_shifts(), self.criterion.timing
        shift, error = self.delay_fit.delay / self.period, limits.z_score * self.delay_fit.delay_std / self.period
        is_within_sample = shift <= 0.5 + error
        if shift + error >= limits.least_sampled:
            if is_within_sample and self.has_feedback:
                shifts = [law for law in shifts if not law.is_late]
            shifts += [law for law in sampled.fit_shifts() if law.is_late and law.delay]
        shifts.sort(key=lambda law: (law.penalty, law.channel.is_sampled != is_within_sample))
        return [self.zero_shift_fit, sampled.half_sample_fit, *shifts]

    def select_law(self) -> Alignment:
        """Return the simplest law that the most probable one does not beat."""
        laws = self.list_laws()
        best = max(laws, key=lambda law: float(law.density.sum()) - law.penalty)
        law = next(law for law in laws if law is best or not best.beats(law))
        if not law.is_found:  # a wide standard error, so that it does not veto the law of all recordings
            std = max(self.delay_fit.delay_std, abs(self.delay_fit.delay) / self.criterion.timing.z_score)
            return replace(law, delay_std=std, lag_std=std)
        if law.is_half_sample:
            return replace(law, delay_std=self.delay_fit.delay_std)
        filters = (each for each in laws if each.lag and not each.delay and not law.lag)
        same_hold = (each for each in filters if each.channel.is_sampled == law.channel.is_sampled)
        return replace(law, rival_lag=next((each.lag for each in same_hold if not best.beats(each)), 0.0))

    def is_consistent(self, recordings: Sequence[Recording], law: Alignment) -> bool:
        """Return whether the fit of a law to recordings is consistent; see `closed_loop.is_consistent`."""
        residual, untimed = (
            self.compute_residual(self.compute_torque(channel)) for channel in (law.channel, Channel())
        )
        return is_consistent(recordings, self.rows.data, residual, untimed, self.span.shape[1], self.criterion)

    @cached_property
    def has_feedback(self) -> bool:
        """Return whether the torque of a row reacts to its position."""
        return bool(find_feedback([w.recording for w in self.rows.data.windows], self.criterion))

    @property
    def _has_noise(self) -> bool:
        """Return whether noise of the log is known: an answer of a controller looks like it, and links follow any."""
        return not (self.has_feedback or self.rows.data.shared_columns)

    def compute_amplification(
        self, channels: Sequence[Channel], residual: Array, noises: Sequence[LogNoise] | None = None
    ) -> Array:
        """Compute the noise of each row (R,) by that of the log, relative to laws that leave the log as it is.

        The `channels` are the laws of the entries of windows, and `noises` those of their logs, by default measured
        under these laws. The noise is sqrt((rest + after) / (rest + before)), with
        that of the log under the laws and without them. The rest is the part of the weighted `residual` (R,) that
        exceeds this noise and has other causes under all laws. An inverse filter amplifies the error of the noise as
        well: its floor may differ by `equal_error_share`. Torque that changes as fast as noise looks like noise. Unless
        the noise is white without the filter, its amplification therefore excuses a residual above that of the law
        `start`, and no more. The answer of a controller to its encoder looks like noise of the log, and acts: the ratio
        is then 1, as for joints with links.
        """
        if not self._has_noise:
            return np.ones(len(residual))
        noises = noises or self._measure_noise(channels)
        power, is_white = self._compute_power(residual), np.array([noise.is_filtered for noise in noises])
        after, before = self._compute_log_power(channels, noises), self._power_of_log
        least = (1 - self.criterion.equal_error_share) ** 2 * after
        rest = np.maximum(power - least, 0.0) + compute_numerical_error(self.rows.data.windows) ** 2
        ratio = (rest + after) / np.maximum(rest + before, 1e-300)
        growth = np.maximum(power / np.maximum(self._start_power, 1e-300), 1.0)
        is_noise = is_white & (least <= power)  # no more than the residual
        amplification = np.sqrt(np.where(is_noise, ratio, np.minimum(ratio, growth)))
        return np.asarray(amplification[self.rows.data.recording_of_window])

    def _compute_power(self, residual: Array) -> Array:
        """Compute the mean square of a weighted residual (R,) in the windows of each entry [(N m)^2]."""
        entry, count = self.rows.data.recording_of_window, len(self.rows.data.windows)
        squares = np.bincount(entry, (residual / self.rows.data.weights) ** 2, count)
        return np.asarray(squares / np.maximum(np.bincount(entry, minlength=count), 1))

    @cached_property
    def _start_power(self) -> Array:
        """Mean square of the residual under the law `start` in the windows of each entry [(N m)^2]."""
        return self._compute_power(self.compute_residual(self.compute_torque(self.start)))

    @cached_property
    def _power_of_log(self) -> Array:
        """Variance of the torque in the windows of each entry by noise of the log as it is [(N m)^2]."""
        as_logged = [Channel()] * len(self.rows.data.windows)
        return self._compute_log_power(as_logged, self._measure_noise(as_logged))

    @cached_property
    def _impulse(self) -> Array:
        """Impulse of one sample, with room for the response of a filter on both sides."""
        reach = int(np.ceil(5 * REACH / self.period))
        return np.eye(1, 2 * reach + 1, reach)[0]

    def _measure_noise(self, channels: Sequence[Channel]) -> list[LogNoise]:
        """Measure the noise in the log of each entry of windows, under its law.

        A filter of the log filters its noise, too, if the noise without the filter is white.
        """
        noises, impulse = list[LogNoise](), self._impulse
        for w, law in zip(self.rows.data.windows, channels, strict=True):
            log, period = w.recording.torque, 1.0 / w.recording.rate
            is_filtered = law.has_filtered_noise(log, period)
            response = filter_lag(impulse, float(np.exp(-period / law.lag))) if is_filtered else impulse
            white = law.remove_filter(log, period) if is_filtered else log
            std = estimate_log_noise(white, w.recording.position)
            noises.append(LogNoise(std, response, is_filtered))
        return noises

    def _compute_log_power(self, channels: Sequence[Channel], noises: Sequence[LogNoise]) -> Array:
        """Compute the variance of the windows of each entry by noise of the log, under its law [(N m)^2]."""
        powers = []
        for w, law, noise in zip(self.rows.data.windows, channels, noises, strict=True):
            traced = replace(law, delay=0.0).average_torque(noise.response, 1.0 / w.recording.rate)
            response = np.convolve(traced, w.kernel)
            powers.append(float(response @ response) * noise.std**2)
        return np.array(powers)


def estimate_alignment(
    recordings: Recording | Sequence[Recording],
    terms: Sequence[Term] = (),
    criterion: Criterion = Criterion(),
    is_model: bool = False,
) -> Alignment:
    """Estimate delay and lag of the torque channel that all recordings share.

    Args:
        recordings: one or more.
        terms: effects of the joint with nonlinear parameters set, fitted together with the law. Saturation and other
            laws of the present torque without parameters are applied to it. Laws that delay the torque are left out,
            because they compete with the law of the channel.
        criterion: limits of the decisions.
        is_model: whether the base model with `terms` is that of the joint; else nearly any law of the joint is fitted.

    The laws are no shift, half a sample of sampled torque, a delay of held or of sampled torque, and a lag with or
    without a delay. The simplest one is reported that the most probable law does not beat: by the log density of
    held-out seconds, with a penalty for each free parameter. Free parameters are `timing.z_score` standard errors from
    zero. A filter that the best law does not beat is the rival of a delay. See `ChannelFits.list_laws`.

    Torque that is set n times a sample seems late by (1 - 1/n) / 2 of a sample. Laws of sampled torque with a free
    delay are therefore fitted to a delay of `timing.least_sampled` and more.

    With links, the law of one joint is kept if it predicts significantly better than one law for all.

    In a closed loop the controller reacts to each unmodelled torque, and a delay fits its reaction. A law then needs a
    residual of noise (see `closed_loop.is_consistent`), with `with_angle_columns` if these explain more.

    Returns:
        The alignment. It is `NO_ALIGNMENT` if the recordings are too short or a controller set the torque. It is also
        returned if the residual of a closed loop is not noise, or a delay replaces the inertia.
    """
    recordings = [recordings] if isinstance(recordings, Recording) else recordings
    recordings = [_apply_torque_laws(recording, terms) for recording in recordings]
    is_logged = any(r.torque.any() for r in recordings) and all(r.has_logged_torque for r in recordings)
    try:
        prepare = partial(ChannelFits.from_recordings, recordings, terms, criterion=criterion, is_model=is_model)
        fits = prepare() if is_logged else None
        if fits is not None and fits.start.delay >= REACH:  # the best delay may be longer
            fits = prepare(latest=LONGEST)
    except IdentificationError:
        fits = None
    if fits is None:
        return NO_ALIGNMENT
    if fits.rows.data.shared_columns:  # the columns of links and smooth laws follow any motion
        law, of_joint = fits.select_law(), fits.select_joint()
        own_law = law if of_joint is fits else of_joint.select_law()
        fits, law = (of_joint, own_law) if own_law.beats(law) else (fits, law)
        return law if not law.is_found or fits.is_consistent(recordings, law) else NO_ALIGNMENT
    if not is_model:
        candidates = fits, fits.with_drift(), fits.with_columns_of_torque(NONLINEAR_GAIN)
        fits = min(candidates, key=lambda candidate: candidate.delay_fit.delay_std)
    if not (law := fits.select_law()).is_found:
        return law
    if not fits.is_possible(law.channel):
        return NO_ALIGNMENT
    if not is_model and find_feedback(recordings, criterion):
        finer = fits.with_angle_columns()
        with_angle, without = (candidate.fit([law.channel], is_free=False) for candidate in (finer, fits))
        fits, law = (finer, finer.select_law()) if with_angle.beats(without) else (fits, law)
    return law if fits.is_consistent(recordings, law) else NO_ALIGNMENT


def predict_log(
    recordings: Sequence[Recording],
    models: Iterable[tuple[Sequence[Alignment], Sequence[Term]]],
    criterion: Criterion = Criterion(),
) -> list[Alignment]:
    """Predict the log of recordings by models: laws of late torque, one for each recording, and terms of the joint.

    The density of each model is that of the log in the same windows. The list is empty if these are too few, and for
    laws of the present torque, for example saturation: the density of a log that they change is not known.
    """
    predicted, given = list[Alignment](), [*models]
    latest = LONGEST if any(law.delay >= REACH for laws, _ in given for law in laws) else REACH
    for laws, terms in given:
        delays = [term for term in terms if term.delays_torque and not term.at]
        try:
            fits = ChannelFits.from_recordings(recordings, terms, latest, criterion, is_model=True)
        except IdentificationError:
            fits = None
        if fits is None or any(map(_is_torque_law, terms)):
            return []
        predicted.append(fits.fit_given(laws, delays))
    return predicted


def _is_torque_law(term: Term) -> bool:
    """Return whether a term of a pendulum is a law of the present torque without parameters, as saturation."""
    return bool(term.fixed) and not term.has_state() and not term.at


def _apply_torque_laws(recording: Recording, terms: Sequence[Term]) -> Recording:
    """Return a recording of a pendulum with torque after the laws of the present torque, for example saturation."""
    laws = [term for term in terms if _is_torque_law(term)]
    if not laws:
        return recording
    velocity = np.gradient(recording.position, recording.time)
    x = Samples(recording.time, recording.position, velocity, recording.torque)
    removed_torque = sum(column.force(x) for law in laws for column in law.fixed)
    return replace(recording, torque=recording.torque - removed_torque)


def estimate_alignments(
    recordings: Sequence[Recording],
    terms: Sequence[Term] = (),
    criterion: Criterion = Criterion(),
    is_model: bool = False,
) -> list[Alignment]:
    """Align all recordings together, or separately if they differ; see `estimate_alignment`.

    All recordings have the same actuator and log. The law of all, or of one recording, holds for all if more than half
    agree with it. A recording that contradicts it keeps its own law, unless torque acts late by that law. In closed
    loops all share the law of all recordings. If they do not determine it, each must determine its own, because a
    delay fits the controller's answer more easily with less motion.

    Returns:
        The alignment of each recording, in order.
    """
    joint = estimate_alignment(recordings, terms, criterion, is_model)
    is_closed = all(find_feedback([recording], criterion) for recording in recordings)
    if len(recordings) == 1 or (is_closed and np.isfinite(joint.delay_std)):
        return [joint] * len(recordings)
    criterion = replace(criterion, p_value=criterion.p_value / len(recordings))  # one of many is late by chance
    own_laws = [estimate_alignment([recording], terms, criterion, is_model) for recording in recordings]
    if is_closed and not all(np.isfinite(own.delay_std) for own in own_laws):
        return [joint] * len(recordings)
    for law in (joint, *sorted(own_laws, key=lambda own: own.delay_std + own.lag_std)):
        agree = [own.agrees(law) for own in own_laws]
        is_shared = law.is_found if law is joint else law.is_late and joint.agrees(law)
        if is_shared and 2 * sum(agree) > len(agree):
            return [law if agrees or _acts_late(own) else own for own, agrees in zip(own_laws, agree, strict=True)]
    laws = [joint if _acts_late(own) else own for own in own_laws]
    return laws if any(law.is_found for law in laws) else [joint] * len(laws)


def _acts_late(law: Alignment) -> bool:
    """Return whether torque acts late, a property of the actuator instead of the log."""
    return law.is_found and not law.is_late
