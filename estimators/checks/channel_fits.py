"""Fits of delay and lag of the torque channel beside models of the motion that bend to nearly any physics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np

from estimators.regression.least_squares import Balance, robust_covariance
from estimators.selection.candidates import depends_on_torque
from estimators.selection.criterion import Criterion
from estimators.selection.score import STRETCH, Bootstrap, Stretches, cross_validated
from estimators.signals.channel import Channel
from estimators.weak_form.dataset import Dataset, smooth_laws
from pendulum_env._typing import Array, Index
from pendulum_env.physics import BASE, Term
from pendulum_env.physics.friction import Stribeck

REACH = 0.05  # [s], delays and lags up to it are looked for
STEP = 1e-3  # [s], a tenth of the longest step
SURE = 4.0  # standard errors from which an estimate is told from none
TRIED = int(2 * REACH / STEP)  # delays that are told apart; the best of so many predicts better by chance
BETTER, CLEARER = 1.0, 2.0  # standard errors of what is gained in predictive density: to be heard, to be chosen
FEWEST = 3  # equations for each column
FRICTION = (0.02, 0.1, 0.5)  # of the highest velocity: where friction may bend, beside where smooth laws bend already
BENT = 3  # times that the torque of the model is refitted with columns that depend on it
TURNS = 20  # of Gauss-Newton at most
SHARES = (1.0, 0.4, 0.1)  # of a Gauss-Newton step that are tried
NEARBY = 1e-4  # [s], difference for derivatives


@dataclass(frozen=True)
class Law:
    """A law of the channel with free delay, free lag or both, as fitted."""

    channel: Channel
    std: tuple[float, float]  # of delay and lag [s]
    density: Array  # log predictive density of each stretch, (2, C), see `ChannelFits.density`

    @property
    def is_sure(self) -> bool:
        """Whether each of its parameters is told from zero, and none is at the end of the search."""
        pairs = zip((self.channel.delay, self.channel.lag), self.std, strict=True)
        return all(SURE * std < abs(value) < REACH for value, std in pairs if std > 0)

    def excels(self, other: Law, by: float) -> bool:
        """Whether it predicts better by some standard errors, over stretches, of the difference; in either case."""
        gain = self.density - other.density
        return bool((gain.sum(axis=1) > by * np.sqrt(gain.shape[1]) * gain.std(axis=1)).all())


@dataclass(frozen=True)
class View:
    """The laws of the channel beside one model of the motion; delay and lag together only where torque is late."""

    bootstrap: Bootstrap
    none: Law
    delay: Law
    lag: Law
    both: Law | None
    is_plain: bool = True  # whether that model is the one that all begins with

    def bears_out(self, law: Law) -> bool:
        """Whether a law predicts surely better than none, as an effect has to, and so it does without its best second.

        A channel acts always. What fits a single event better is no delay.
        """
        by_chance = float(np.log(TRIED))
        return all(
            np.sum(after - before) - np.max(after - before) > by_chance
            and self.bootstrap.gain(after, before, by_chance).chance <= Criterion().chance
            for after, before in zip(law.density, self.none.density, strict=True)
        )

    @property
    def best(self) -> Law:
        """What predicts best."""
        laws = [law for law in (self.none, self.delay, self.lag, self.both) if law is not None]
        return max(laws, key=lambda law: float(law.density.sum()))


@dataclass(frozen=True, eq=False)
class ChannelFits:
    """Fits of the flexible model to windows, for any law of the channel; rows of which all torque is known.

    Attributes:
        data: windows.
        rows: equations used (R,) of those in the windows.
        phi: columns (R, P), weighted.
        clusters: stretch of each equation for standard errors, (R,).
        where: stretch of each equation for predictions.
        is_sampled: whether torque is taken for sampled, else for held.
        torques: weighted torque (R,) that acts in the windows by law of the channel, as far as they were asked for.
    """

    data: Dataset
    rows: Index
    phi: Array
    clusters: Index
    where: Stretches
    is_sampled: bool = False
    torques: dict[Channel, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, data: Dataset, beside: Sequence[Term] = ()) -> Self | None:
        """Fits to these windows, None if too few are clear of the ends of segments; see `align`."""
        clear = []
        for w in data.windows:
            beyond = len(w.kernel) // 2 + int(np.ceil(REACH * w.recording.rate)) + 2
            own = np.zeros(len(w.centers), dtype=bool)
            for begin, end in pairwise((*w.recording.starts, len(w.recording))):
                own |= (w.centers >= begin + beyond) & (w.centers < end - beyond)
            clear.append(own)
        rows = np.flatnonzero(np.concatenate(clear))
        fast = float(np.percentile(np.abs(data.samples.velocity), 95))
        known = [term for term in beside if not depends_on_torque(term)]
        laws = (*smooth_laws(data.windows[0]), *(Stribeck(share * fast) for share in FRICTION), *known)
        phi = np.column_stack([data.columns([law])[0][0] for law in laws])
        phi = phi[rows] * data.weights[rows, None]
        if len(phi) < FEWEST * phi.shape[1]:
            return None
        stretch, recording = (numbers[rows] for numbers in data.stretches(STRETCH)[:2])
        _, first, stretch = np.unique(stretch, return_index=True, return_inverse=True)
        where = Stretches(stretch, recording, recording[first], stretch)
        return cls(data, rows, phi, np.unique(data.clusters[rows], return_inverse=True)[1], where)

    def torque(self, channel: Channel) -> Array:
        """Weighted torque (R,) that acts in the windows, less what known loads take."""
        if channel in self.torques:
            return self.torques[channel]
        parts = []
        for w in self.data.windows:
            torque, period = w.recording.torque, 1.0 / w.recording.rate
            bounds = pairwise((*w.recording.starts, len(w.recording)))
            acting = [channel.around(w.samples, torque[begin:end], period) for begin, end in bounds]
            parts.append(w.average(np.concatenate(acting)))
        net = np.concatenate(parts) - self.carried
        self.torques[channel] = net[self.rows] * self.data.weights[self.rows]
        return self.torques[channel]

    def sampled(self) -> Self:
        """The same of torque that was sampled, and not held."""
        return replace(self, is_sampled=True)

    def drifting(self) -> Self:
        """The same with base parameters that change along each recording."""
        passed = np.concatenate([2 * w.centers / len(w.recording) - 1 for w in self.data.windows])[self.rows]
        return replace(self, phi=np.column_stack([self.phi, self.phi[:, : len(BASE)] * passed[:, None]]))

    def bent(self, channel: Channel) -> Self:
        """The same with columns that bend with the torque of the model: friction under load, and a bent gain.

        Like every other column they are functions of the motion alone, and cannot explain torque by torque.
        Source: Ramsey, Journal of the Royal Statistical Society B 31(2), 1969 (powers of the fitted values).
        """
        weights = self.data.weights[self.rows]
        sign = np.sign(self.data.samples.velocity[self.rows])
        bent = self
        for _ in range(BENT):
            fitted = (bent.torque(channel) - bent.residual(channel)) / weights + self.carried[self.rows]
            powers = np.column_stack([np.abs(fitted) * sign, fitted**2, fitted**3])
            bent = replace(self, phi=np.column_stack([self.phi, powers * weights[:, None]]))
        return bent

    def residual(self, channel: Channel) -> Array:
        """What the model leaves of the torque, (R,), weighted."""
        torque = self.torque(channel)
        return torque - self.span @ (self.span.T @ torque)

    @cached_property
    def bootstrap(self) -> Bootstrap:
        """Of the stretches."""
        return Bootstrap(self.where.of_stretch, np.random.default_rng(0))

    @cached_property
    def carried(self) -> Array:
        """Torque that known loads take in all windows [N m]."""
        return self.data.torque() - self.data.net_torque()

    @cached_property
    def span(self) -> Array:
        """Orthonormal basis of the columns (R, P)."""
        left, singular, _ = np.linalg.svd(self.phi / np.maximum(np.linalg.norm(self.phi, axis=0), 1e-300), False)
        return np.asarray(left[:, singular > 1e-9 * singular[0]])

    def channel(self, x: Array) -> Channel:
        """Law with a delay and a filter that delays slow torque by so much [s]; time constants are steep near zero."""
        delay, shift = (float(value) for value in x)
        period = 1.0 / self.data.windows[0].recording.rate
        lag = shift if shift <= 0 else period / float(np.log1p(period / shift))
        return Channel(delay, lag, self.is_sampled)

    def misfit(self, x: Array) -> float:
        """Sum of squared residuals."""
        residual = self.residual(self.channel(x))
        return float(residual @ residual)

    def slopes(self, x: Array, free: Index) -> Array:
        """Derivatives (R, F) of the torque with respect to what is free."""
        ways = NEARBY * np.eye(2)[free]
        ends = [[self.torque(self.channel(x + sign * way)) for sign in (1, -1)] for way in ways]
        return np.column_stack([(after - before) / (2 * NEARBY) for after, before in ends])

    def fit(self, starts: Iterable[tuple[float, float]], free: tuple[int, ...], low: float = -REACH) -> Law:
        """Best law near the best of the starts, by variable projection.

        Args:
            starts: delay and shift, see `channel`.
            free: which of them are fitted.
            low: limit of both.

        Source: Golub and Pereyra, Inverse Problems 19(2), 2003.
        """
        index = np.array(free, dtype=int)
        x = min((np.array(start) for start in starts), key=self.misfit)
        for _ in range(TURNS if free else 0):
            slopes = self.slopes(x, index)
            slopes -= self.span @ (self.span.T @ slopes)
            step = np.zeros(2)
            step[index] = np.linalg.lstsq(-slopes, self.residual(self.channel(x)), rcond=1e-9)[0]
            step *= min(1.0, 10 * STEP / max(float(np.abs(step).max()), 1e-300))
            tried = [np.clip(x + share * step, low, REACH) for share in SHARES]
            best = min(tried, key=self.misfit)
            if self.misfit(best) >= self.misfit(x) * (1 - 1e-7):
                break
            x = best
        channel = self.channel(x)
        slopes = self.slopes(x, index) if free else np.empty((len(self.rows), 0))
        std = np.zeros(2)
        if free:
            std[index] = self.errors(slopes, self.residual(channel))
        if channel.lag > 0:  # d lag / d shift
            period = 1.0 / self.data.windows[0].recording.rate
            std[1] *= channel.lag**2 / (x[1] * (x[1] + period))
        return Law(channel, (float(std[0]), float(std[1])), self.density(channel, slopes))

    def errors(self, slopes: Array, residual: Array) -> Array:
        """Standard errors (F,) of what is free: of the jackknife, or by chance alone, whichever is larger.

        What no law explains repeats with the motion, and resembles the slopes by chance: how much is seen where it is
        moved along the recording to places where it does not belong. For white residuals the two are the same.
        """
        covariance = robust_covariance(np.column_stack([self.span, slopes]), residual, self.clusters)
        jackknife = np.diag(covariance)[-slopes.shape[1] :]
        own = slopes - self.span @ (self.span.T @ slopes)
        spectrum = np.conj(np.fft.rfft(residual))[:, None] * np.fft.rfft(np.linalg.pinv(own).T, axis=0)
        # estimates (R, F) from the residual moved along by 0 to R - 1 equations
        elsewhere = np.fft.irfft(spectrum, len(residual), axis=0)
        return np.sqrt(np.maximum(jackknife, np.mean(elsewhere**2, axis=0)))

    def gain(self, channel: Channel) -> float:
        """By how much the channel's filter raises white noise of the log in the windows, mean over recordings."""
        gains = []
        for w in self.data.windows:
            period = 1.0 / w.recording.rate
            impulse = np.zeros(2 * int(np.ceil(5 * REACH / period)) + 1)
            impulse[len(impulse) // 2] = 1.0
            ways = (Channel(), replace(channel, delay=0.0))
            before, after = (way.around(w.samples, impulse, period) for way in ways)
            gains.append(np.linalg.norm(np.convolve(after, w.kernel)) / np.linalg.norm(np.convolve(before, w.kernel)))
        return float(np.mean(gains))

    def density(self, channel: Channel, slopes: Array) -> Array:
        """Log predictive density of each stretch (2, C): if what is left acts as torque, and if it is the log's noise.

        Each stretch is predicted by laws, and a channel near this one, that were fitted to the other folds.
        """
        design, torque = np.column_stack([self.span, slopes]), self.torque(channel)
        free = np.full(design.shape[1], np.inf)
        balance = Balance(design, torque, np.zeros_like(design), -free, free, np.ones(len(torque)))
        density = cross_validated(balance, self.where)
        return np.stack([density, density + np.log(self.gain(channel)) * np.bincount(self.where.stretch)])

    def views(self) -> list[View]:
        """Under this model of the motion, and under each more general one that predicts better; most precise first."""
        grid = np.arange(-REACH, REACH + STEP, 2 * STEP)
        start = min(((float(delay), 0.0) for delay in grid), key=lambda start: self.misfit(np.array(start)))
        own = self.compare(start)
        wider = [
            replace(fits.compare(start), is_plain=False) for fits in (self.drifting(), self.bent(own.delay.channel))
        ]
        views = [own, *(view for view in wider if view.best.excels(own.best, BETTER))]
        return sorted(views, key=lambda view: view.delay.std[0])

    def compare(self, start: tuple[float, float]) -> View:
        """Fits of every law of the channel beside this model of the motion."""
        none = self.fit([(0.0, 0.0)], ())
        delay = self.fit([(0.0, 0.0), start], (0,))
        late = delay.channel.delay
        lag = self.fit([(0.0, share * late) for share in (0.5, 1.0, 1.5)], (1,))
        both = None
        if late > 0:
            both = self.fit([(share * late, (1 - share) * late) for share in (0.25, 0.5, 0.75)], (0, 1), low=0.0)
        return View(self.bootstrap, none, delay, lag, both)
