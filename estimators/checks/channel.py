"""Fit of the torque channel: gain, delay, filter and hold between recorded and acting torque.

A law C of the channel (`signals.channel.Channel`) gives the acting torque C u of the logged torque u. It is fitted by
least squares over windows:

    C u = (1/K) (dI q'' + dmgl sin q) + phi theta.

If a current is logged, the torque of the known loads is a column with the parameter 1/K, K the torque constant. If
torque is logged, the torque of the known loads is subtracted. The other columns approximate nearly any law of the
joint. They are functions of the motion alone, so they cannot imitate a delay.

Source: Golub and Pereyra, Inverse Problems 19(2), 2003 (variable projection); Ramsey, Journal of the Royal Statistical
Society B 31(2), 1969 (powers of the fitted values).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from scipy.special import fdtrc

from estimators.checks.alignment import CHANNEL, NO_ALIGNMENT, Alignment, make_moved_torque
from estimators.checks.channel_rows import (
    FRICTION_SLOPE,
    MOTOR_FRICTION,
    ChannelRows,
    list_torque_dependent,
    make_angle_columns,
    make_channel_rows,
)
from estimators.checks.closed_loop import find_feedback, is_consistent
from estimators.regression.balance import Balance, place_columns
from estimators.regression.gauss_newton import LocalErrors, StopRule, choose_least, gauss_newton
from estimators.regression.least_squares import IdentificationError, project_out, solve_least_squares
from estimators.selection.score import cross_validate_density
from estimators.signals.channel import Channel
from estimators.weak_form.windows import scale_by_jumps
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Samples, Term
from pendulum_env.recording import NEWTON_METRE, Recording

DESCENT = StopRule(iterations=20, dampings=(0.0, 1.0, 10.0), of_cost=1e-9)


@dataclass(frozen=True, eq=False)
class ChannelFits(ChannelRows):
    """Fits of the recorded torque under any law of the channel.

    Attributes:
        by_torque: derivatives of the columns by the torque (R, P).
        is_sampled: whether torque is sampled instead of held.
        torques: cache of `torque` by law.
    """

    by_torque: Array
    is_sampled: bool = False
    torques: dict[Channel, Array] = field(default_factory=dict)

    @classmethod
    def from_recordings(cls, recordings: Sequence[Recording], terms: Sequence[Term] = ()) -> ChannelFits | None:
        """Prepare fits of recordings; None if too few rows are far enough from the ends of segments.

        Args:
            recordings: with known torque. The joints of an arm share one law of the channel.
            terms: effects of the joint; for an arm all terms of the model, the links first.

        Raises:
            IdentificationError: if too little of the motion is clear of stick.
        """
        rows = make_channel_rows(recordings, terms)
        if rows is None:
            return None
        of_torque = list_torque_dependent(terms)
        fits = cls(**vars(rows), by_torque=np.zeros_like(rows.phi))
        return fits.with_columns_of_torque(partial(fits._compute_torque_columns, of_torque)) if of_torque else fits

    def with_columns(self, columns: Array, by_torque: Array | None = None) -> ChannelFits:
        """Return the fits with additional columns (R, P), and their derivatives by the torque (R, P)."""
        weighted = columns * self.data.weights[self.rows, None]
        slopes = np.zeros_like(columns) if by_torque is None else by_torque
        phi, by_torque = np.column_stack([self.phi, weighted]), np.column_stack([self.by_torque, slopes])
        return replace(self, phi=phi, by_torque=by_torque)

    def _compute_torque_columns(self, terms: Sequence[Term], torque: Array) -> Array:
        """Compute columns (R, P) of torque-dependent terms for a torque (R,) [N m], interpolated in time."""
        windows, first = [], 0
        for w in self.data.windows:
            last = first + len(w.centers)
            known = slice(*np.searchsorted(self.rows, (first, last)))
            centers, first = w.centers[self.rows[known] - first], last
            instants = np.arange(len(w.moving), dtype=float)
            acting = np.interp(instants, centers, torque[known]) if len(centers) else 0.0 * instants
            windows.append(w.with_torque(w.recording.torque, acting))
        data = replace(self.data, windows=tuple(windows))
        parts = [(data.locate_rows(term.at), data.columns([term])[0][0]) for term in terms]
        return place_columns(len(self.data.weights), parts)[self.rows]

    def with_motor_friction(self) -> ChannelFits:
        """Return the fits with friction that depends on the motor torque."""
        parts = [
            self.data.averages.column(column, self.data.averages.samples)[self.rows, None]
            for column in (MOTOR_FRICTION, FRICTION_SLOPE)
        ]
        return self.with_columns(*parts)

    def with_columns_of_torque(self, columns: Callable[[Array], Array]) -> ChannelFits:
        """Return the fits with columns (R, P) that are a function of the fitted torque (R,) [N m].

        The torque is that with the delay `start`. Each of `CHANNEL.torque_iterations` replaces the columns by those of
        the last fit.
        """
        torque, weights, fits = self.torque(self.channel(self.start)), self.data.weights[self.rows], self
        for _ in range(CHANNEL.torque_iterations):
            fitted = (torque - fits.residual(torque)) / weights + self.carried[self.rows]
            fits = self.with_columns(columns(fitted))
        return fits

    def with_nonlinear_gain(self) -> ChannelFits:
        """Return the fits with columns |tau| sign(v), tau^2 and tau^3 of the fitted torque tau."""
        sign = np.sign(self.data.samples.velocity[self.rows])
        return self.with_columns_of_torque(
            lambda torque: np.column_stack([np.abs(torque) * sign, torque**2, torque**3])
        )

    def with_jump_errors(self) -> ChannelFits:
        """Return the fits with weights for jumps of sampled torque: their time within a sample is unknown."""
        scales = []
        for w in self.data.windows:
            moved = make_moved_torque(w.recording, np.array([0.0, 1.0, 0.0]), True)
            scale = scale_by_jumps(replace(w.recording, moved=moved), w.kernel, w.torque_noise)
            scales.append(np.ones(len(w.centers)) if scale is None else scale[w.centers])
        factor = np.concatenate(scales)
        data = replace(self.data, weights=self.data.weights * factor)
        return replace(self, data=data, phi=self.phi * factor[self.rows, None], torques={})

    def with_drift(self) -> ChannelFits:
        """Return the fits with parameters of the base model that change linearly along each recording."""
        time_share = np.concatenate([2 * w.centers / len(w.recording) - 1 for w in self.data.windows])
        return self.with_columns(self.base_columns * time_share[self.rows, None])

    @cached_property
    def base_columns(self) -> Array:
        """Return the columns of the base model (R, 4), not weighted."""
        return np.column_stack([self.data.columns([term])[0][0] for term in BASE])[self.rows]

    def keeps_inertia(self, law: Alignment) -> bool:
        """Return whether the inertia of the base model stays above `CHANNEL.kept_inertia` of itself under a law.

        The speed of a joint with inertia J and viscous friction b follows torque with the lag J/b. A late action can
        imitate this inertia.
        """
        columns = self.base_columns * self.data.weights[self.rows, None]
        logged, corrected = (
            solve_least_squares(columns, self.torque(channel))[0] for channel in (Channel(), law.channel)
        )
        return bool(corrected >= CHANNEL.kept_inertia * logged)

    def with_angle_columns(self) -> ChannelFits:
        """Return the fits with columns of cogging, of all orders that the number of equations allows."""
        count = (len(self.rows) // CHANNEL.min_equations - self.phi.shape[1]) // 2
        return self if count < 1 else self.with_columns(make_angle_columns(self.data, count)[self.rows])

    @cached_property
    def span(self) -> Array:
        """Return an orthonormal basis of the columns (R, P)."""
        basis, singular, _ = np.linalg.svd(self.phi / np.maximum(np.linalg.norm(self.phi, axis=0), 1e-300), False)
        return np.asarray(basis[:, singular > 1e-9 * singular[0]])

    @property
    def columns(self) -> tuple[Array, Array]:
        """Return the fitted columns (R, P), and their derivatives by the torque.

        They are those of `phi` if a gain or a torque-dependent column is fitted, else an orthonormal basis.
        """
        has_parameters = self.by_torque.any() or self.data.windows[0].recording.torque_unit != NEWTON_METRE
        return (self.phi, self.by_torque) if has_parameters else (self.span, np.zeros_like(self.span))

    @cached_property
    def start(self) -> Array:
        """Return delay and shift (2,), see `channel`: the best of `CHANNEL.starts` delays without a filter."""
        delays = CHANNEL.reach * np.linspace(-1.0, 1.0, CHANNEL.starts)
        return min(np.outer(delays, [1.0, 0.0]), key=lambda x: float(np.linalg.norm(self.misfit(x))))

    def select_most_precise(self) -> ChannelFits:
        """Return these fits, those with drift, or with nonlinear gain: those with the most precise delay."""
        return min((self, self.with_drift(), self.with_nonlinear_gain()), key=lambda fits: fits.delay_fit.delay_std)

    @cached_property
    def delay_fit(self) -> Alignment:
        """Return the law with a free delay."""
        return self.fit([np.zeros(2), self.start], (0,))

    @property
    def period(self) -> float:
        """Return the sampling period [s]."""
        return 1.0 / max(w.recording.rate for w in self.data.windows)

    def channel(self, x: Array) -> Channel:
        """Return the law of x = (delay, shift) (2,) [s], where the filter delays slow torque by `shift`.

        shift = period / (exp(period / lag) - 1) if positive; a negative shift is the lag.
        """
        delay, shift = (float(value) for value in x)
        lag = shift if shift <= 0 else self.period / float(np.log1p(self.period / shift))
        return Channel(delay, lag, self.is_sampled)

    def torque(self, channel: Channel) -> Array:
        """Return the weighted acting torque (R,) of the windows without that of known loads, cached in `torques`."""
        if channel in self.torques:
            return self.torques[channel]
        parts = []
        for w in self.data.windows:
            bounds = pairwise((*w.recording.starts, len(w.recording)))
            acting = [
                channel.average_torque(w.samples, w.recording.torque[a:b], 1.0 / w.recording.rate) for a, b in bounds
            ]
            parts.append(w.average(np.concatenate(acting)))
        net = np.concatenate(parts) - self.carried
        self.torques[channel] = net[self.rows] * self.data.weights[self.rows]
        return self.torques[channel]

    def residual(self, torque: Array) -> Array:
        """Return the residual of a weighted torque (R, ...) on the columns."""
        return project_out(self.span, torque)

    def misfit(self, x: Array) -> Array:
        """Return the weighted residual of the torque (R,)."""
        return self.residual(self.torque(self.channel(x)))

    def slopes(self, x: Array, directions: Array) -> Array:
        """Compute derivatives (R, F) of the torque along directions (F, 2)."""
        pairs = [
            [self.torque(self.channel(x + sign * CHANNEL.difference * direction)) for sign in (1, -1)]
            for direction in directions
        ]
        derivatives = [(after - before) / (2 * CHANNEL.difference) for after, before in pairs]
        return np.reshape(derivatives, (len(directions), len(self.rows))).T

    def fit(self, starts: Iterable[Array], free: Sequence[int] = (), low: float = -CHANNEL.reach) -> Alignment:
        """Fit the law from the best start.

        Args:
            starts: delay and shift (2,) each [s], see `channel`.
            free: indices of the fitted parameters, 0 for the delay and 1 for the shift; the others stay at the start.
            low: lower limit of delay and shift [s]; the upper limit is `CHANNEL.reach`.
        """
        clipped = (np.clip(start, low, CHANNEL.reach) for start in starts)
        x = min(clipped, key=lambda start: float(np.linalg.norm(self.misfit(start))))
        directions = np.eye(2)[list(free)]
        if free:
            lower, upper = low - directions @ x, CHANNEL.reach - directions @ x

            def linearise(place: Array) -> LocalErrors[Array]:
                error = self.misfit(x + place @ directions)
                slopes = self.residual(self.slopes(x + place @ directions, directions))
                return LocalErrors(place, float(error @ error), error, slopes, place <= lower, place >= upper)

            def choose_step(local: LocalErrors[Array], steps: list[Array]) -> tuple[Array, float]:
                places = [_move_within(local.known, step, lower, upper) for step in steps]
                costs = [float(np.sum(self.misfit(x + place @ directions) ** 2)) for place in places]
                return choose_least(places, costs)

            x = x + gauss_newton(np.clip(0.0 * lower, lower, upper), linearise, choose_step, DESCENT) @ directions
        channel, slopes = self.channel(x), self.slopes(x, directions)
        columns, by_torque = self.columns
        design, count = np.column_stack([columns, -slopes]), columns.shape[1]
        by_torque, infinite = np.column_stack([by_torque, 0 * slopes]), np.full(design.shape[1], np.inf)
        balance = Balance(design, self.torque(channel), by_torque, -infinite, infinite, np.ones(len(design)))
        fits = [balance.fit(clusters) for clusters in self.clusters]
        errors = np.max([fit.std for fit in fits], axis=0)
        delay_std, lag_std = (float(std) for std in errors[count:] @ directions)
        if channel.lag > 0:  # d lag / d shift, infinite without a filter
            slope = channel.lag**2 / (x[1] * (x[1] + self.period))
            lag_std = min(slope * lag_std, self.channel(x + np.array([0.0, lag_std])).lag)
        gain = float(fits[0].theta[0]), float(errors[0])
        density = cross_validate_density(balance, self.where)
        noise_bonus = np.log(self.compute_noise_gain(channel)) * np.bincount(self.where.block)
        return Alignment(channel, delay_std, lag_std, gain=gain, density=np.stack([density, density + noise_bonus]))

    def select_law(self) -> Alignment:
        """Return the simplest law that predicts significantly better than the others.

        A filter shorter than a sample cannot be distinguished from a delay by a share of a sample.
        """
        no_shift, delay = self.fit([np.zeros(2)]), self.delay_fit
        delay_time = delay.delay
        lag = self.fit([np.array([0.0, share * delay_time]) for share in (0.5, 1.0, 1.5)], (1,))
        if not delay.is_supported(no_shift) or self.is_negligible(delay_time):  # a filter also shows as a delay
            # an insignificant delay gets a wide standard error, so that it does not veto the joint estimate
            stds = (
                max(delay.delay_std, abs(delay_time) / CHANNEL.z_limit),
                max(lag.lag_std, abs(lag.lag) / CHANNEL.z_limit),
            )
            return replace(no_shift, delay_std=stds[0], lag_std=stds[1])
        if delay_time > 0:
            delay_and_lag = self.fit(
                [delay_time * np.array([share, 1 - share]) for share in (0.25, 0.5, 0.75)], (0, 1), low=0.0
            )
            if (
                delay_and_lag.is_supported(no_shift)
                and delay_and_lag.lag > self.period
                and delay_and_lag.beats(delay)
                and delay_and_lag.beats(lag)
            ):
                return delay_and_lag
        is_filter = lag.predicts_better(delay) and lag.is_supported(no_shift) and abs(lag.lag) >= self.period
        law, other = (lag, delay) if is_filter else (delay, lag)
        return law if law.beats(other) or not other.is_supported(no_shift) else replace(law, rival=other.channel)

    def is_negligible(self, delay: float) -> bool:
        """Return whether a delay [s] is a small share of a sample and does not reduce the error significantly."""
        # errors of smoothing and integration
        exactness = self.data.compute_numerical_error() * float(np.linalg.norm(self.data.weights[self.rows]))
        errors = [np.linalg.norm(self.misfit(np.array([shift, 0.0]))) for shift in (0.0, delay)]
        before, after = np.hypot(errors, exactness)
        return bool(abs(delay) < CHANNEL.negligible * self.period and after > (1 - CHANNEL.error_margin) * before)

    def is_consistent(self, recordings: Sequence[Recording], law: Alignment) -> bool:
        """Return whether the fit of a law to recordings is consistent; see `closed_loop.is_consistent`."""
        residual, untimed = (self.residual(self.torque(channel)) for channel in (law.channel, Channel()))
        return is_consistent(recordings, self.data, residual, untimed, self.span.shape[1])

    def explains_more(self, fits: ChannelFits, law: Alignment) -> bool:
        """Return whether these columns explain significantly more torque than the fewer columns of `fits`: F-test."""
        n_added, independent = self.span.shape[1] - fits.span.shape[1], len(self.rows) // 2  # windows overlap by half
        freedom = independent - self.span.shape[1]
        if n_added < 1 or freedom < 1:
            return False
        before, after = (float(np.sum(fit.residual(fit.torque(law.channel)) ** 2)) for fit in (fits, self))
        ratio = (before - after) / n_added / max(after / freedom, 1e-300)
        return bool(fdtrc(n_added, freedom, ratio) < CHANNEL.p_value)

    def compute_noise_gain(self, channel: Channel) -> float:
        """Compute the largest ratio of white noise in the windows with and without the inverse filter."""
        factors, reach = [], int(np.ceil(5 * CHANNEL.reach / self.period))
        impulse = np.eye(1, 2 * reach + 1, reach)[0]
        for w in self.data.windows:
            laws, period = (replace(channel, delay=0.0), Channel()), 1.0 / w.recording.rate
            responses = [np.convolve(law.average_torque(w.samples, impulse, period), w.kernel) for law in laws]
            after, before = (float(np.linalg.norm(response)) for response in responses)
            factors.append(after / before)
        return max(factors)


def _move_within(place: Array, step: Array, lower: Array, upper: Array) -> Array:
    """Move by a step (F,) and stop at the first bound.

    The direction is kept, since delay and shift compensate each other.
    """
    room, is_moved = np.where(step < 0, lower - place, upper - place), step != 0
    share = min([1.0, *(room[is_moved] / step[is_moved])])
    return np.asarray(np.clip(place + share * step, lower, upper))


def align(recordings: Recording | Sequence[Recording], terms: Sequence[Term] = ()) -> Alignment:
    """Estimate delay and lag of the torque channel that all recordings share.

    Args:
        recordings: one or more.
        terms: effects of the joint with nonlinear parameters set, fitted together with the law. Saturation and other
            laws of the present torque without parameters are applied to it. Laws that delay the torque are left out,
            because they compete with the law of the channel.

    A law is reported if its delay or lag is `CHANNEL.z_limit` standard errors from zero, and if it predicts held-out
    seconds significantly better. A delay below `CHANNEL.negligible` of a sample counts as zero if torque is predicted
    equally without it. A filter is distinguished from a delay if it predicts significantly better; else both are
    reported.

    Torque that is set n times a sample seems late by (1 - 1/n) / 2 of a sample. Torque that seems late by a quarter to
    half a sample counts as sampled unless held torque predicts significantly better. It counts as sampled if it reacts
    to the position of its row: the log then has the present torque, which a controller changes before the next row.
    Later torque counts as held unless sampled torque predicts significantly better. Sampled torque is late by half a
    sample unless another delay predicts significantly better. Half a sample need not predict significantly better than
    no delay.

    In a closed loop the controller reacts to each unmodelled torque, and a delay fits its reaction. A law then needs a
    residual of noise (see `closed_loop.is_consistent`), with `with_angle_columns` if these explain more.

    Returns:
        The alignment. It is `NO_ALIGNMENT` if the recordings are too short, the residual of a closed loop is not noise,
        a delay replaces the inertia, or a drive requested the torque.
    """
    recordings = [recordings] if isinstance(recordings, Recording) else recordings
    recordings = [_apply_torque_laws(recording, terms) for recording in recordings]
    is_logged = any(r.torque.any() for r in recordings) and all(r.has_logged_torque for r in recordings)
    try:
        fits = ChannelFits.from_recordings(recordings, terms) if is_logged else None
    except IdentificationError:
        fits = None
    if fits is None:
        return NO_ALIGNMENT
    if fits.data.shared_columns:  # the columns of links and smooth laws follow any motion
        law = _choose_hold(fits)
        return law if not law.is_found or fits.is_consistent(recordings, law) else NO_ALIGNMENT
    fits = fits.select_most_precise()
    if not (law := _choose_hold(fits)).is_found:
        return law
    if not (law.is_late or fits.keeps_inertia(law)):
        return NO_ALIGNMENT
    if find_feedback(recordings) and (finer := fits.with_angle_columns()).explains_more(fits, law):
        fits, law = finer, _choose_hold(finer)
    return law if fits.is_consistent(recordings, law) else NO_ALIGNMENT


def _apply_torque_laws(recording: Recording, terms: Sequence[Term]) -> Recording:
    """Return a recording of a pendulum with torque after the laws of the present torque, for example saturation."""
    laws = [term for term in terms if term.fixed and not term.has_state() and not term.at]
    if not laws:
        return recording
    velocity = np.gradient(recording.position, recording.time)
    x = Samples(recording.time, recording.position, velocity, recording.torque)
    removed_torque = sum(column.force(x) for law in laws for column in law.fixed)
    return replace(recording, torque=recording.torque - removed_torque)


def _choose_hold(fits: ChannelFits) -> Alignment:
    """Return the law of held or of sampled torque, chosen by the rules of `align`."""
    law, sampled = fits.select_law(), replace(fits, is_sampled=True)
    free_delay = fits.delay_fit
    if not (law.is_late or (free_delay.is_significant and not law.is_found)):
        return law
    half_sample = sampled.fit([np.array([0.5 * fits.period, 0.0])])
    if not law.is_late:
        is_half = (
            half_sample.agrees(free_delay) and half_sample.predicts_better(law) and not free_delay.beats(half_sample)
        )
        return replace(half_sample, delay_std=free_delay.delay_std, is_half_sample=True) if is_half else law
    sampled_law = sampled.select_law()
    shift, shift_std = (law.delay + law.lag) / fits.period, (law.delay_std + law.lag_std) / fits.period
    if shift + CHANNEL.z_limit * shift_std < CHANNEL.least_sampled:
        return law
    is_within_sample = shift < 0.5 + CHANNEL.z_limit * shift_std
    answers_row = bool(find_feedback([w.recording for w in fits.data.windows]))  # the log is not that of an earlier row
    is_sampled = answers_row or not law.beats(sampled_law) if is_within_sample else sampled_law.beats(law)
    if not (is_sampled and sampled_law.is_late):
        return law
    sampled = sampled.with_jump_errors()
    half_sample, sampled_law = sampled.fit([np.array([0.5 * fits.period, 0.0])]), sampled.select_law()
    if half_sample.agrees(sampled_law) and not sampled_law.beats(half_sample):
        return replace(half_sample, delay_std=sampled_law.delay_std, is_half_sample=True)
    return replace(sampled_law, rival=None)


def align_each(recordings: Sequence[Recording], terms: Sequence[Term] = ()) -> list[Alignment]:
    """Align all recordings together, or separately if they differ; see `align`.

    All recordings have the same drive and log. The law of all, or of one recording, holds for all if more than half
    agree with it. A recording that contradicts it keeps its own law, unless torque acts late by that law. In closed
    loops all share the law of all recordings. If they do not determine it, each must determine its own, because a
    delay fits the controller's answer more easily with less motion.

    Returns:
        The alignment of each recording, in order.
    """
    joint = align(recordings, terms)
    is_closed = all(find_feedback([recording]) for recording in recordings)
    if len(recordings) == 1 or (is_closed and np.isfinite(joint.delay_std)):
        return [joint] * len(recordings)
    separate_laws = [align([recording], terms) for recording in recordings]
    if is_closed and not all(np.isfinite(alignment.delay_std) for alignment in separate_laws):
        return [joint] * len(recordings)
    for law in (joint, *sorted(separate_laws, key=lambda alignment: alignment.delay_std + alignment.lag_std)):
        agree = [alignment.agrees(law) for alignment in separate_laws]
        is_shared = (law.is_late and joint.agrees(law)) or (law is joint and law.is_found)
        if is_shared and 2 * sum(agree) > len(separate_laws):
            uses_law = [
                is_alike or (alignment.is_found and not alignment.is_late)
                for alignment, is_alike in zip(separate_laws, agree, strict=True)
            ]
            return [
                law if uses_shared else alignment
                for alignment, uses_shared in zip(separate_laws, uses_law, strict=True)
            ]
    separate = [alignment if alignment.is_late or not alignment.is_found else joint for alignment in separate_laws]
    return separate if any(alignment.is_found for alignment in separate) else [joint] * len(separate_laws)
