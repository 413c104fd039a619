"""The torque channel: what was recorded is a gain, a delay, a filter and a hold of what the joint needs.

With tau the torque that acts, tau = C u of what is logged, by a law of the channel (`signals.channel.Channel`),

    C u = (1/K) (dI q'' + dmgl sin q) + phi theta,

by least squares over windows. The torque of the known loads is a column like any other, whose parameter is one over the
torque constant where a current is logged; where torque is, it is subtracted. The other columns follow nearly any
physics of the joint, each a function of the motion: none can stand in for time, or explain torque by torque.

Source: Golub and Pereyra, Inverse Problems 19(2), 2003 (variable projection); Ramsey, Journal of the Royal Statistical
Society B 31(2), 1969 (powers of the fitted values).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtri

from estimators.regression.balance import Balance
from estimators.selection.columns import depends_on_torque
from estimators.selection.criterion import Criterion
from estimators.selection.score import BLOCK, Blocks, cross_validated
from estimators.signals.channel import Channel
from estimators.weak_form.dataset import Dataset, prepare, smooth_laws
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import BASE, Column, KnownLoad, Term
from pendulum_env.physics.friction import Stribeck
from pendulum_env.physics.term import LOAD
from pendulum_env.recording import Load, Recording
from pendulum_env.recording.record import NEWTON_METRE


@dataclass(frozen=True)
class ChannelSettings:
    """How delays and lags are searched for, and when one is reported."""

    reach: float = 0.05  # [s], delays and lags up to it are looked for
    starts: int = 51  # delays among which a search starts from the best
    sure: float = 4.0  # standard errors from which an estimate is told from none
    clearer: float = float(ndtri(1 - Criterion().chance))  # standard errors of a gain that counts, as of an effect's
    by_chance: float = float(np.log(2 * reach / 1e-3))  # [nat], gained by chance by the best of so many delays
    fewest_equations: int = 3  # equations for each column
    friction: tuple[float, ...] = (0.02, 0.1, 0.5)  # of the highest velocity: where friction, too, may bend
    bends: int = 3  # times that the torque of the model is refitted with columns that depend on it
    nearby: float = 1e-4  # [s], difference for derivatives
    negligible: float = 0.02  # of a sample: neither smoothing nor a clock is as exact as that
    between: int = 4  # recordings from which on their scatter, too, tells a standard error
    fewest_stretches: int = 3  # below which their scatter tells nothing


SEARCH = ChannelSettings()
NONE = Load(0.0, 0.0)
# friction that is pressed by what hangs on the output, the joint's own weight and the known loads [per N m of each]
OWN = Column("own", "1", dry=lambda x: np.abs(np.sin(x.position)))
HUNG = Column("hung", "1", dry=lambda x: x.load.gravity * np.abs(np.sin(x.position)))
# and by the motor, with its slope by the torque
MOTOR = Column("motor", "1", dry=lambda x: np.abs(x.torque), of_torque=True)
SENSE = Column("sense", "1", dry=lambda x: np.sign(x.torque), of_torque=True)


@dataclass(frozen=True)
class Law:
    """A law of the channel with free delay, free lag or both, as fitted.

    Attributes:
        channel: the law.
        std: standard errors of delay and lag [s], zero of what is not free.
        gain: parameter of the first column, and its standard error.
        density: log predictive density of each stretch (2, C) [nat], if what is left acts as torque, and if it is
            noise of the log, which the channel's filter raises.
    """

    channel: Channel
    std: tuple[float, float]
    gain: tuple[float, float]
    density: Array

    @property
    def is_sure(self) -> bool:
        """Whether each of its parameters is told from zero, and none is at the end of the search."""
        pairs = zip((self.channel.delay, self.channel.lag), self.std, strict=True)
        return all(SEARCH.sure * std < abs(value) < SEARCH.reach for value, std in pairs if std > 0)

    def stands(self, none: Law) -> bool:
        """Whether it is surely told from none, and surely predicts better."""
        return self.is_sure and self.excels(none, SEARCH.by_chance)

    def excels(self, other: Law, by_chance: float = 0.0) -> bool:
        """Whether it surely predicts better, by the scatter between stretches, whatever is left.

        A channel acts always: what fits a single event better is no delay.
        """
        gain = self.density - other.density
        if gain.shape[1] < SEARCH.fewest_stretches:
            return False
        spread = np.sqrt(gain.shape[1]) * gain.std(axis=1)
        return bool((gain.sum(axis=1) - by_chance > SEARCH.clearer * spread).all())


@dataclass(frozen=True, eq=False)
class ChannelFits:
    """Fits of what was recorded under any law of the channel, in rows of which all torque is known.

    Attributes:
        data: windows, each with its known load.
        rows: equations used (R,) of those in the windows.
        phi: columns (R, P), weighted; first that of the known loads, where it is there to tell the gain.
        by_torque: their slopes by the torque (R, P).
        where: stretch of each equation for predictions.
        is_sampled: whether torque is taken for sampled, else for held.
        torques: weighted torque (R,) that acts in the windows by law of the channel, as far as they were asked for.
    """

    data: Dataset
    rows: Index
    phi: Array
    by_torque: Array
    where: Blocks
    is_sampled: bool = False
    torques: dict[Channel, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, recordings: Sequence[Recording], beside: Sequence[Term] = ()) -> Self | None:
        """Fits to recordings beside effects that the joint has, None if too little is clear of the ends of segments.

        Raises:
            IdentificationError: if too little of the motion is clear of stick.
        """
        data, loads = prepare(recordings), [recording.load or NONE for recording in recordings]
        hung = zip(data.windows, (KnownLoad(load.inertia, load.gravity) for load in loads), strict=True)
        data = replace(data, windows=tuple(replace(w, samples=replace(w.samples, load=load)) for w, load in hung))
        rows = np.flatnonzero(np.concatenate([_clear(w) for w in data.windows]))
        fast = float(np.percentile(np.abs(data.samples.velocity), 95))
        known = [term for term in beside if not depends_on_torque(term)]
        laws = (*smooth_laws(data.windows[0]), *(Stribeck(share * fast) for share in SEARCH.friction), *known)
        gain = [] if is_torque(data) else [LOAD]
        columns = [*gain, OWN, HUNG] if len(set(loads)) > 1 else [OWN]
        first = [data.rows.column(column, data.rows.samples) for column in columns]
        phi = np.column_stack([*first, *(data.columns([law])[0][0] for law in laws)])
        if len(rows) < SEARCH.fewest_equations * phi.shape[1]:
            return None
        stretch, recording = (numbers[rows] for numbers in data.blocks(BLOCK)[:2])
        _, begin, stretch = np.unique(stretch, return_index=True, return_inverse=True)
        where = Blocks(stretch, recording, recording[begin], stretch)
        return cls(data, rows, phi[rows] * data.weights[rows, None], np.zeros((len(rows), phi.shape[1])), where)

    def beside(self, columns: Array, by_torque: Array | None = None) -> Self:
        """The same with more columns (R, P), and their slopes by the torque where they depend on it."""
        weighted = columns * self.data.weights[self.rows, None]
        slopes = np.zeros_like(columns) if by_torque is None else by_torque
        phi, by_torque = np.column_stack([self.phi, weighted]), np.column_stack([self.by_torque, slopes])
        return replace(self, phi=phi, by_torque=by_torque)

    def rubbing(self) -> Self:
        """The same with friction that is pressed by the motor."""
        parts = [self.data.rows.column(column, self.data.rows.samples)[self.rows, None] for column in (MOTOR, SENSE)]
        return self.beside(*parts)

    def bent(self) -> Self:
        """The same with columns that bend with the torque of the model: friction under load, and a bent gain."""
        sign, torque, bent = np.sign(self.data.samples.velocity[self.rows]), self.torque(self.channel(self.start)), self
        for _ in range(SEARCH.bends):
            fitted = (torque - bent.residual(torque)) / self.data.weights[self.rows] + self.carried[self.rows]
            bent = self.beside(np.column_stack([np.abs(fitted) * sign, fitted**2, fitted**3]))
        return bent

    def drifting(self) -> Self:
        """The same with parameters that change along each recording."""
        passed = np.concatenate([2 * w.centers / len(w.recording) - 1 for w in self.data.windows])
        base = np.column_stack([self.data.columns([term])[0][0] for term in BASE])
        return self.beside((base * passed[:, None])[self.rows])

    @cached_property
    def carried(self) -> Array:
        """Torque that is known to be taken by loads in all windows [N m], none where the log is no torque."""
        load = self.data.rows.column(LOAD, self.data.rows.samples)
        return load if is_torque(self.data) else 0.0 * load

    @cached_property
    def span(self) -> Array:
        """Orthonormal basis of the columns (R, P)."""
        left, singular, _ = np.linalg.svd(self.phi / np.maximum(np.linalg.norm(self.phi, axis=0), 1e-300), False)
        return np.asarray(left[:, singular > 1e-9 * singular[0]])

    @cached_property
    def start(self) -> Array:
        """The best of a few delays, (2,), see `channel`."""
        delays = SEARCH.reach * np.linspace(-1.0, 1.0, SEARCH.starts)
        return min(np.outer(delays, [1.0, 0.0]), key=lambda x: float(np.linalg.norm(self.misfit(x))))

    def sharpest(self) -> Self:
        """The same beside the model of the motion that tells a delay most precisely: this one, or a wider one."""
        return min((self, self.drifting(), self.bent()), key=lambda own: own.delayed.std[0])

    @cached_property
    def delayed(self) -> Law:
        """The law with a free delay."""
        return self.fit([np.zeros(2), self.start], (0,))

    @property
    def period(self) -> float:
        """Of a sample [s]."""
        return 1.0 / max(w.recording.rate for w in self.data.windows)

    def channel(self, x: Array) -> Channel:
        """Law with a delay and a filter that delays slow torque by so much [s]; time constants are steep near zero."""
        delay, shift = (float(value) for value in x)
        lag = shift if shift <= 0 else self.period / float(np.log1p(self.period / shift))
        return Channel(delay, lag, self.is_sampled)

    def torque(self, channel: Channel) -> Array:
        """Weighted torque (R,) that acts in the windows, less what is known to be taken by loads."""
        if channel in self.torques:
            return self.torques[channel]
        parts = []
        for w in self.data.windows:
            bounds = pairwise((*w.recording.starts, len(w.recording)))
            acting = [channel.around(w.samples, w.recording.torque[a:b], 1.0 / w.recording.rate) for a, b in bounds]
            parts.append(w.average(np.concatenate(acting)))
        net = np.concatenate(parts) - self.carried
        self.torques[channel] = net[self.rows] * self.data.weights[self.rows]
        return self.torques[channel]

    def residual(self, torque: Array) -> Array:
        """What the columns leave of a weighted torque (R, ...)."""
        return torque - self.span @ (self.span.T @ torque)

    def misfit(self, x: Array) -> Array:
        """What the model leaves of the torque, (R,), weighted."""
        return self.residual(self.torque(self.channel(x)))

    def slopes(self, x: Array, ways: Array) -> Array:
        """Derivatives (R, F) of the torque along each of several ways (F, 2)."""
        ends = [[self.torque(self.channel(x + sign * SEARCH.nearby * way)) for sign in (1, -1)] for way in ways]
        rises = [(after - before) / (2 * SEARCH.nearby) for after, before in ends]
        return np.reshape(rises, (len(ways), len(self.rows))).T

    def fit(self, starts: Iterable[Array], free: Sequence[int] = (), low: float = -SEARCH.reach) -> Law:
        """Best law near the best of the starts.

        Args:
            starts: delay and shift, see `channel`.
            free: which of them are fitted.
            low: limit of both.
        """
        within = (np.clip(start, low, SEARCH.reach) for start in starts)
        x = min(within, key=lambda start: float(np.linalg.norm(self.misfit(start))))
        ways = np.eye(2)[list(free)]
        if free:
            moved = least_squares(
                lambda way: self.misfit(x + way @ ways),
                np.zeros(len(ways)),
                lambda way: self.residual(self.slopes(x + way @ ways, ways)),
                (low - ways @ x, SEARCH.reach - ways @ x),
                xtol=1e-6,
            )
            x = x + moved.x @ ways
        channel, slopes = self.channel(x), self.slopes(x, ways)
        design, count = np.column_stack([self.phi, -slopes]), self.phi.shape[1]
        by_torque, far = np.column_stack([self.by_torque, 0 * slopes]), np.full(design.shape[1], np.inf)
        balance = Balance(design, self.torque(channel), by_torque, -far, far, np.ones(len(design)))
        fits = [balance.fit(clusters) for clusters in self.clusters]
        errors = np.max([fit.std for fit in fits], axis=0)
        delay_std, lag_std = (float(std) for std in errors[count:] @ ways)
        if channel.lag > 0:  # d lag / d shift
            lag_std *= channel.lag**2 / (x[1] * (x[1] + self.period))
        gain = float(fits[0].theta[0]), float(errors[0])
        density = cross_validated(balance, self.where)
        raised = np.log(self.raised(channel)) * np.bincount(self.where.block)
        return Law(channel, (delay_std, lag_std), gain, np.stack([density, density + raised]))

    def raised(self, channel: Channel) -> float:
        """By how much the channel's filter raises white noise of the log in the windows, at most."""
        factors, reach = [], int(np.ceil(5 * SEARCH.reach / self.period))
        impulse = np.eye(1, 2 * reach + 1, reach)[0]
        for w in self.data.windows:
            ways, period = (replace(channel, delay=0.0), Channel()), 1.0 / w.recording.rate
            passed = [np.convolve(way.around(w.samples, impulse, period), w.kernel) for way in ways]
            after, before = (float(np.linalg.norm(one)) for one in passed)
            factors.append(after / before)
        return max(factors)

    @property
    def clusters(self) -> list[Index]:
        """Stretches of time, and recordings, of each equation (R,), within which errors may be alike."""
        time, recording = self.data.clusters, self.data.recording_of_window
        several = [time, recording] if len(np.unique(recording[self.rows])) >= SEARCH.between else [time]
        return [np.unique(clusters[self.rows], return_inverse=True)[1] for clusters in several]


def is_torque(data: Dataset) -> bool:
    """Whether torque was logged, and not what it is some gain of."""
    return data.windows[0].recording.torque_unit == NEWTON_METRE


def _clear(w: Windows) -> Mask:
    """Windows whose torque is known under every law of the channel (R,)."""
    beyond = len(w.kernel) // 2 + int(np.ceil(SEARCH.reach * w.recording.rate)) + 2
    bounds = pairwise((*w.recording.starts, len(w.recording)))
    return np.any([(w.centers >= begin + beyond) & (w.centers < end - beyond) for begin, end in bounds], axis=0)
