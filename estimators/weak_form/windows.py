"""Weak form of the torque balance: averages over short smooth windows that stay clear of stick.

Multiplying the balance by a smooth window w of compact support and integrating gives one equation per window,

    <w tau> = sum_k theta_k <w (mass_k q'' + force_k + dry_k sgn q')>,

in which both sides pass the same zero-phase low-pass filter. Windows that overlap little have nearly uncorrelated
errors, so ordinary least squares on them is close to efficient; windows that touch stick are left out.

Two facts about sampled data are built in. The command is held: the second difference of the position at sample k is
the average acceleration under a triangle over samples k - 1 to k + 1, whose torque is exactly the mean of commands
k - 1 and k. The same triangle acts on smooth functions as (f[k-1] + 10 f[k] + f[k+1]) / 12 (Numerov).

Source: weak-form identification as in Messenger and Bortz, Multiscale Modeling and Simulation 19(3), 2021.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import scipy

from estimators.signals.differentiation import (
    correlate_averages,
    differentiate_position,
    estimate_white_noise,
    find_near_reversals,
)
from estimators.signals.motion import LEAD_IN, SLOWEST, get_known_load, get_temperature
from pendulum_env._typing import Array, ArrayLike, Index, Mask
from pendulum_env.arms.body import LinkLoad
from pendulum_env.physics import LOAD, Column, KnownLoad, Samples, Term
from pendulum_env.physics.simulation import StepPrograms
from pendulum_env.physics.term import Memory, trace_variants
from pendulum_env.recording import Recording

Averages: TypeAlias = "scipy.sparse.csr_array | scipy.sparse.linalg.LinearOperator"  # text: they are loaded where used
DENSEST = 4  # entries of a matrix of averages per sample, above which averages are made by sliding the window


@dataclass(frozen=True, eq=False)
class WindowAverages:
    """Averages over the windows of one recording, or of several in a row: rows of a regression.

    Attributes:
        samples: at N instants.
        moving: instants at which the velocity has a sign (N,); at others dry friction has none.
        acceleration: there, see `Windows`.
        narrow: averages (R, N) of series held from sample to sample, like torque.
        wider: of smooth functions, which pass the triangle first.
    """

    samples: Samples
    moving: Mask
    acceleration: Array
    narrow: Averages
    wider: Averages

    @classmethod
    def join(cls, parts: Sequence[WindowAverages]) -> WindowAverages:
        """Join the averages of several recordings."""
        if len(parts) == 1:
            return parts[0]
        narrow, wider = (_join_diagonally(every) for every in zip(*((p.narrow, p.wider) for p in parts), strict=True))
        moving, acceleration = (
            np.concatenate(own) for own in zip(*((p.moving, p.acceleration) for p in parts), strict=True)
        )
        return cls(concatenate_samples([own.samples for own in parts]), moving, acceleration, narrow, wider)

    def column(self, column: Column, x: Samples) -> Array:
        """Average a column of the regressor (R,), along samples with the term's state variables."""
        smooth, dry = column.force(x), column.dry(x)
        if np.ndim(dry) or dry:
            smooth = smooth + dry * np.sign(x.velocity) * self.moving
        # torque samples are averages over the triangle already
        averages = _average_series(self.narrow if column.of_torque else self.wider, smooth)
        mass = column.mass(x)
        if np.ndim(mass) or mass:
            averages = averages + self.narrow @ (mass * self.acceleration)
        return np.where(np.isfinite(averages), averages, 0.0)  # a diverged state has no column

    def columns(self, variants: Sequence[Term], traced: Sequence[Samples]) -> list[tuple[Array, Array]]:
        """Return the linear columns (R, P) and the sum of the fixed columns (R,) of each variant of one effect.

        Args:
            variants: of one effect.
            traced: samples with the state variables of each.
        """
        parts = []
        none = np.zeros(self.narrow.shape[0])
        for variant, x in zip(variants, traced, strict=True):
            linear = [self.column(c, x) for c in variant.columns]
            # fixed columns are torques that hold like the command, and already averages over the triangle
            fixed = sum((_average_series(self.narrow, c.force(x)) for c in variant.fixed), none)
            fixed = np.where(np.isfinite(fixed), fixed, 0.0)
            parts.append((np.column_stack(linear) if linear else np.empty((len(none), 0)), fixed))
        return parts

    def fixed_under(self, term: Term, perturbations: Array) -> Array:
        """Return the fixed columns of a term without memory (R, J) under perturbations of the torque (J,) [N m]."""
        x, size = self.samples, (self.narrow.shape[1], len(perturbations))
        under = [replace(x, torque=x.torque + own) for own in perturbations]  # one by one, within the processor's cache
        total = np.zeros((self.narrow.shape[0], len(perturbations)))
        for column in term.fixed:
            forces = np.empty(size)
            for k, own in enumerate(under):
                forces[:, k] = column.force(own)
            total += self.narrow @ forces
        return total


def _join_diagonally(parts: Sequence[Averages]) -> Averages:
    """Join averages of several recordings, each over its own samples."""
    if all(scipy.sparse.issparse(own) for own in parts):
        return scipy.sparse.csr_array(scipy.sparse.block_diag(parts, "csr"))
    rows, columns = (sum(own.shape[axis] for own in parts) for axis in (0, 1))
    ends = np.cumsum([own.shape[1] for own in parts])[:-1]

    def average(series: Array) -> Array:
        return np.concatenate([own @ piece for own, piece in zip(parts, np.split(np.ravel(series), ends), strict=True)])

    return scipy.sparse.linalg.LinearOperator((rows, columns), matvec=average, dtype=np.float64)


def _average_series(averages: Averages, series: ArrayLike) -> Array:
    """Average a series, or a constant (R,)."""
    return np.asarray(averages @ np.broadcast_to(np.asarray(series, dtype=float), averages.shape[1:]))


def concatenate_samples(parts: Sequence[Samples]) -> Samples:
    """Concatenate samples of several recordings, with the states of the same terms."""
    loads = [
        np.concatenate([np.broadcast_to(own, x.time.shape) for own, x in zip(of_each, parts, strict=True)])
        for of_each in zip(*(x.load for x in parts), strict=True)
    ]
    return Samples(
        np.concatenate([x.time for x in parts]),
        np.concatenate([x.position for x in parts]),
        np.concatenate([x.velocity for x in parts]),
        np.concatenate([x.torque for x in parts]),
        concatenate_memory(parts),
        KnownLoad(*loads),
        np.concatenate([np.broadcast_to(x.temperature, x.time.shape) for x in parts]),
    )


def concatenate_memory(parts: Sequence[Samples]) -> dict[str, Memory]:
    """Concatenate the states of terms along several recordings."""
    return {
        id: tuple(np.concatenate(series) for series in zip(*(x.memory[id] for x in parts), strict=True))
        for id in parts[0].memory
    }


@dataclass(frozen=True)
class Windows:
    """Windowed equations of one recording; build them with `cut`.

    Attributes:
        recording: the recording.
        samples: time, smoothed position and velocity, and torque at the instants, each (N,).
        acceleration: raw second difference of the position (N,) [rad/s^2]; only its averages are meaningful.
        kernel: window w, (2 m + 1,), summing to one.
        centers: sample index of each window that is clear of stick, (R,).
        turning: the same for other windows with mostly motion, near a reversal, a start or a halt; four times as dense.
        resting: the same for windows with mostly rest.
        moving: samples whose velocity has a sign, (N,).
        is_clear: samples whose window is clear of stick, as those of `centers` are, (N,).
        torque_noise: standard deviation of a window's torque from white noise [N m].
        acceleration_noise: the same for its acceleration [rad/s^2].
        acceleration_shared: correlation of that noise between windows half a window apart.
        velocity_noise: standard deviation of the smoothed velocity [rad/s].
        first, stop: range of samples with windows; those before it initialise terms with memory.
        scale: factor on the equation about each sample (N,), below one where its torque is known less well than
            elsewhere; None if it is one everywhere.
        at: name of the recorded joint of an arm.
        run: number of the arm's recording, which its joints share.
        payload: what the arm is known to carry.
    """

    recording: Recording
    samples: Samples
    acceleration: Array
    kernel: Array
    centers: Index
    turning: Index
    resting: Index
    moving: Mask
    is_clear: Mask
    torque_noise: float
    acceleration_noise: float
    acceleration_shared: float
    velocity_noise: float
    first: int
    stop: int
    at: str = ""
    run: int | None = None
    payload: LinkLoad | None = None
    scale: Array | None = None

    @cached_property
    def programs(self) -> StepPrograms:
        """Compiled steps of models that simulate parts of the recording."""
        return StepPrograms()

    @cached_property
    def torque_scale(self) -> float:
        """Standard deviation of the recorded torque; in a free swing, of that which accelerates the inertia [N m]."""
        if not self.recording.known_inertia:
            return float(np.std(self.recording.torque + self.samples.load.torque))
        bounds = pairwise((*self.recording.starts, len(self.moving)))
        rates = [np.diff(self.samples.velocity[begin:end]) for begin, end in bounds]
        return self.recording.known_inertia * self.recording.rate * float(np.std(np.concatenate(rates)))

    @property
    def raw_torque_noise(self) -> float:
        """Standard deviation of the white noise of the torque channel [N m]."""
        return self.torque_noise / float(np.linalg.norm(np.convolve(self.kernel, [0.5, 0.5])))

    @property
    def unclear(self) -> Index:
        """Sample index of each window that is not clear of stick."""
        return np.sort(np.concatenate([self.turning, self.resting]))

    @cached_property
    def averages(self) -> WindowAverages:
        """Averages over the windows."""
        return self._averages_by(self.kernel)

    @cached_property
    def rates(self) -> WindowAverages:
        """Averages of time derivatives, for torque with a lag: <w f'> = -<w' f>."""
        padded = np.pad(self.kernel, 2)
        return self._averages_by(0.5 * self.recording.rate * (padded[:-2] - padded[2:]))

    def _averages_by(self, kernel: Array) -> WindowAverages:
        narrow, wider = self._averages(kernel), self._averages(np.convolve(kernel, [1 / 12, 10 / 12, 1 / 12]))
        return WindowAverages(self.samples, self.moving, self.acceleration, narrow, wider)

    def at_every_sample(self) -> Windows:
        """Return windows about every sample that is clear of stick."""
        return replace(self, centers=np.flatnonzero(self.is_clear), scale=None)

    def _averages(self, kernel: Array) -> Averages:
        count, length = len(self.centers), len(kernel)
        first = self.centers - length // 2
        scale = np.ones(count) if self.scale is None else self.scale[self.centers]
        if count * length > DENSEST * len(self.moving):
            return scipy.sparse.linalg.LinearOperator(
                (count, len(self.moving)),
                matvec=lambda series: scale * np.correlate(np.ravel(series), kernel, "valid")[first],
                dtype=np.float64,
            )
        place = first[:, None] + np.arange(length)
        parts = np.outer(scale, kernel).ravel(), place.ravel(), length * np.arange(count + 1)
        return scipy.sparse.csr_array(parts, shape=(count, len(self.moving)))

    def with_torque(self, torque: Array, averages: Array) -> Windows:
        """Return the motion under another torque (N,) [N m], with its averages by `average_held_torque` (N,)."""
        samples = replace(self.samples, torque=averages)
        return replace(self, recording=replace(self.recording, torque=torque), samples=samples)

    def average(self, series: Array) -> Array:
        """Average a series (N,) over the windows (R,)."""
        return np.asarray(self.averages.narrow @ series)

    def trace(self, variants: Sequence[Term]) -> list[Samples]:
        """Trace the states of variants of one effect along the recording, one result for each variant."""
        return trace_all([self], variants)[0]

    def select_driving_samples(self, kind: type[Term]) -> Samples:
        """Return the samples that drive an effect: not smoothed for one with impacts."""
        return self._unsmoothed if kind.has_impacts or kind.kind == "transmission" else self.samples

    @cached_property
    def _unsmoothed(self) -> Samples:
        q = self.recording.position
        return replace(self.samples, position=q, velocity=np.gradient(q, 1.0 / self.recording.rate))

    def columns(self, variants: Sequence[Term]) -> list[tuple[Array, Array]]:
        """Return the linear columns (R, P) and the sum of the fixed columns (R,) of each variant of one effect."""
        return self.averages.columns(variants, self.trace(variants))

    def absorbed(self, term: Term) -> float:
        """Return the variance of white torque noise that the term's fixed columns absorb [(N m)^2]."""
        noise = np.random.default_rng(0).standard_normal(len(self.recording)) * self.raw_torque_noise
        noisier = self.with_torque(self.recording.torque + noise, self.samples.torque + average_held_torque(noise))
        ((_, more),), ((_, taken),) = noisier.columns([term]), self.columns([term])
        raw = self.average(average_held_torque(noise))
        return float(np.var(raw) - np.var(raw - (more - taken)))

    def torque(self) -> Array:
        """Return averages (R,) of the measured torque [N m]."""
        return self.average(self.samples.torque)

    def applied_torque(self) -> Array:
        """Return the applied torque; in a free swing -I q'', which a model has to explain."""
        known = self.recording.known_inertia
        return -known * self.average(self.acceleration) if known else self.torque()

    def net_torque(self) -> Array:
        """Return averages (R,) of the torque less that of the known load: the model's left-hand side [N m]."""
        return self.torque() - self.averages.column(LOAD, self.samples) if self.samples.load else self.torque()

    def at_centers(self) -> Samples:
        """Return the samples at the windows' centres, (R,) each."""
        x, c = self.samples, self.centers
        warm = np.broadcast_to(x.temperature, x.time.shape)[c]
        return Samples(x.time[c], x.position[c], x.velocity[c], x.torque[c], load=x.load.select(c), temperature=warm)

    def noise(self, inertia: float) -> float:
        """Return the standard deviation of a window's residual due to noise [N m]; known loads add inertia."""
        return float(np.hypot(self.torque_noise, self._moved(inertia) * self.acceleration_noise))

    def rate_noise(self, inertia: float) -> float:
        """Return the standard deviation of the rate of the torque that moves an inertia, due to noise [N m/s]."""
        padded = np.pad(self.kernel, 3)
        bend, slope = (float(np.linalg.norm(np.diff(padded, order))) for order in (2, 3))
        return self._moved(inertia) * self.acceleration_noise * self.recording.rate * slope / bend

    def shared_noise(self, inertia: float) -> float:
        """Return the covariance of the residuals of adjacent windows due to measurement noise [(N m)^2]."""
        of_torque = self.torque_noise**2 * correlate_averages(
            np.convolve(self.kernel, [0.5, 0.5]), len(self.kernel) // 2
        )
        return of_torque + (self._moved(inertia) * self.acceleration_noise) ** 2 * self.acceleration_shared

    def _moved(self, inertia: float) -> float:
        """Return the inertia with that of the known load [kg m^2]."""
        return inertia + float(np.max(self.samples.load.inertia))


def average_held_torque(torque: Array) -> Array:
    """Average a torque (N,) that is held from sample to sample over the triangle about each sample."""
    averages = torque.copy()
    averages[1:] = 0.5 * (torque[1:] + torque[:-1])
    return averages


def trace_all(windows: Sequence[Windows], variants: Sequence[Term]) -> list[list[Samples]]:
    """Trace the states of variants of one effect, one result for each recording and variant."""
    kind = type(variants[0])
    driving = [w.select_driving_samples(kind) for w in windows]
    if not kind.has_state():
        return [[x] * len(variants) for x in driving]
    runs, commands, periods = [], [], []  # one for each segment: the motion in a gap is unknown
    for w, x in zip(windows, driving, strict=True):
        for begin, end in pairwise((*w.recording.starts, len(w.recording))):
            part = slice(begin, end)
            warm = np.broadcast_to(x.temperature, x.time.shape)[part]
            runs.append(Samples(x.time[part], x.position[part], x.velocity[part], x.torque[part], temperature=warm))
            commands.append(w.recording.torque[begin:end])
            periods.append(1.0 / w.recording.rate)
    if kind.has_own_trace():
        every = zip(runs, commands, periods, strict=True)
        memories = iter([kind.trace_each(variants, *run) for run in every])
    else:
        memories = iter(trace_variants(variants, runs, commands, periods))
    traced = []
    for w, x in zip(windows, driving, strict=True):
        segments = [next(memories) for _ in w.recording.starts]
        states = [
            tuple(np.concatenate(series) for series in zip(*(own[v] for own in segments), strict=True))
            for v in range(len(variants))
        ]
        traced.append([replace(x, memory=kind.name_memory(memory)) for memory in states])
    return traced


def make_bump(half_width: int) -> Array:
    """Return the window (1 - s^2)^3 over 2 half_width + 1 samples, summing to one."""
    s = np.arange(-half_width, half_width + 1) / (half_width + 1)
    weights = (1.0 - s**2) ** 3
    return weights / weights.sum()


Part = tuple[float, float]  # begin and end of a part, as shares of a recording
WHOLE: Part = (0.0, 1.0)


def cut(recording: Recording, half_width: float, part: Part = WHOLE) -> Windows:
    """Cut a recording, or a part of it, into windows.

    Args:
        recording: at least 0.1 s longer than a window.
        half_width: of a window [s]; at least two samples are taken.
        part: range of the recording with windows.
    """
    m = max(2, round(half_width * recording.rate))
    smoothing = max(2, round(0.75 * m))
    window, load = make_bump(m), get_known_load(recording)
    noise = math.hypot(estimate_white_noise(recording.torque), estimate_white_noise(load.get_torque(recording.time)))
    motion = differentiate_position(recording, window, smoothing)
    v = motion.velocity
    moving = np.abs(v) > max(SLOWEST, 5 * motion.velocity_noise)
    guard = m + 1 + smoothing // 3  # the smoothed velocity may cross zero a little off the true one
    near, outside = find_near_reversals(v, moving, guard), np.zeros(len(v), dtype=bool)
    for begin, end in pairwise((*recording.starts, len(recording))):
        lead_in = round(min(LEAD_IN * recording.rate, 0.1 * (end - begin)))
        outside[begin : begin + guard + 1 + lead_in] = outside[end - guard - 1 : end] = True
    if not recording.powered.all():  # an open motor has no back-EMF
        outside |= np.convolve(recording.powered == 0.0, np.ones(2 * guard + 1))[guard : guard + len(v)] > 0
    first, stop = (round(share * len(v)) for share in part)
    candidates, dense = (np.arange(first + m, stop - m, step) for step in (m, max(1, m // 4)))
    candidates, dense = candidates[~outside[candidates]], dense[~outside[dense] & near[dense]]
    stuck = near[candidates]
    is_clear = ~(near | outside)
    is_clear[: first + m] = is_clear[stop - m :] = False
    mostly_moving = np.convolve(moving, window, "same") > 0.5
    return Windows(
        recording=recording,
        samples=Samples(
            recording.time,
            motion.position,
            v,
            average_held_torque(recording.torque),
            load=load,
            temperature=get_temperature(recording),
        ),
        acceleration=motion.acceleration,
        kernel=window,
        centers=candidates[~stuck],
        turning=dense[mostly_moving[dense]],
        resting=candidates[stuck & ~mostly_moving[candidates]],
        moving=moving,
        is_clear=is_clear,
        torque_noise=noise * float(np.linalg.norm(np.convolve(window, [0.5, 0.5]))),
        acceleration_noise=motion.acceleration_noise,
        acceleration_shared=correlate_averages(motion.noise_weights, m),
        velocity_noise=motion.velocity_noise,
        first=first,
        stop=stop,
    )
