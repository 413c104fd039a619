"""Weak form of the torque balance: averages over short smooth windows that stay clear of stick.

The integral of the balance times a smooth window w of compact support gives one equation per window,

    <w tau> = sum_k theta_k <w (mass_k q'' + force_k + dry_k sgn q')>.

Both sides pass the same zero-phase low-pass filter. Windows that overlap little have nearly uncorrelated errors, so
ordinary least squares is nearly efficient. Windows that touch stick are left out.

The second difference of the position at sample k is the average acceleration under a triangle over samples k - 1 to
k + 1. The average of the held torque under this triangle is the mean of commands k - 1 and k. A smooth function has
the average (f[k-1] + 10 f[k] + f[k+1]) / 12 (Numerov).

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
    Motion,
    correlate_averages,
    differentiate_position,
    estimate_white_noise,
    find_near_reversals,
)
from estimators.signals.motion import HALF_WIDTHS, LEAD_IN, SLOWEST, get_known_load, get_temperature
from pendulum_env._typing import Array, ArrayLike, Index, Mask
from pendulum_env.arms.body import LinkLoad
from pendulum_env.physics import LOAD, Column, KnownLoad, Samples, Term
from pendulum_env.physics.simulation import StepPrograms
from pendulum_env.physics.term import Memory, trace_variants
from pendulum_env.recording import Recording

Averages: TypeAlias = "scipy.sparse.csr_array | scipy.sparse.linalg.LinearOperator"  # text: loaded when used
MAX_DENSITY = 4  # entries per sample of a matrix of averages, above which an operator slides the window


@dataclass(frozen=True, eq=False)
class WindowAverages:
    """Averages over the R windows of one recording, or of several concatenated ones: rows of a regression.

    Attributes:
        samples: samples at N instants.
        moving: mask of instants with a significant velocity (N,); dry friction counts as zero at others.
        acceleration: acceleration at the instants (N,), see `Windows`.
        narrow: matrix (R, N) of averages of series that are already averages over the triangle, as held torque is.
        wider: matrix (R, N) of averages of smooth functions, which includes the triangle.
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
            np.concatenate(series) for series in zip(*((p.moving, p.acceleration) for p in parts), strict=True)
        )
        return cls(concatenate_samples([series.samples for series in parts]), moving, acceleration, narrow, wider)

    def column(self, column: Column, x: Samples) -> Array:
        """Return a column of the regressor (R,), averaged over the windows, from samples with states (N,)."""
        smooth, dry = column.force(x), column.dry(x)
        if np.ndim(dry) or dry:
            smooth = smooth + dry * np.sign(x.velocity) * self.moving
        averages = _average_series(self.narrow if column.of_torque else self.wider, smooth)
        mass = column.mass(x)
        if np.ndim(mass) or mass:
            averages = averages + self.narrow @ (mass * self.acceleration)
        return np.where(np.isfinite(averages), averages, 0.0)  # a diverged state has no column

    def columns(self, variants: Sequence[Term], samples: Sequence[Samples]) -> list[tuple[Array, Array]]:
        """Return the linear columns (R, P) and the sum of the fixed columns (R,) of each variant of one effect.

        `samples` has for each variant the samples with its state variables.
        """
        parts = []
        zeros = np.zeros(self.narrow.shape[0])
        for variant, x in zip(variants, samples, strict=True):
            linear = [self.column(c, x) for c in variant.columns]
            # fixed columns are held torques, which are already averages over the triangle
            fixed = sum((_average_series(self.narrow, c.force(x)) for c in variant.fixed), zeros)
            fixed = np.where(np.isfinite(fixed), fixed, 0.0)
            parts.append((np.column_stack(linear) if linear else np.empty((len(zeros), 0)), fixed))
        return parts

    def perturb_fixed_columns(self, term: Term, perturbations: Array) -> Array:
        """Return the fixed columns of a term without memory (R, J) under perturbations of the torque (J,) [N m]."""
        total = np.zeros((self.narrow.shape[0], len(perturbations)))
        for k, perturbation in enumerate(perturbations):  # one at a time fits the processor cache
            samples = replace(self.samples, torque=self.samples.torque + perturbation)
            total[:, k] = sum(_average_series(self.narrow, column.force(samples)) for column in term.fixed)
        return total


def _join_diagonally(parts: Sequence[Averages]) -> Averages:
    """Join the averages of several recordings to one block-diagonal matrix or operator."""
    if all(scipy.sparse.issparse(averages) for averages in parts):
        return scipy.sparse.csr_array(scipy.sparse.block_diag(parts, "csr"))
    rows, columns = (sum(averages.shape[axis] for averages in parts) for axis in (0, 1))
    ends = np.cumsum([averages.shape[1] for averages in parts])[:-1]

    def average(series: Array) -> Array:
        pieces = np.split(np.ravel(series), ends)
        return np.concatenate([averages @ piece for averages, piece in zip(parts, pieces, strict=True)])

    return scipy.sparse.linalg.LinearOperator((rows, columns), matvec=average, dtype=np.float64)


def _average_series(averages: Averages, series: ArrayLike) -> Array:
    """Average a series (N,), or a constant, over the windows (R,)."""
    return np.asarray(averages @ np.broadcast_to(np.asarray(series, dtype=float), averages.shape[1:]))


def concatenate_samples(parts: Sequence[Samples]) -> Samples:
    """Concatenate samples of several recordings, with the states of the same terms."""
    loads = [
        np.concatenate([np.broadcast_to(value, x.time.shape) for value, x in zip(values, parts, strict=True)])
        for values in zip(*(x.load for x in parts), strict=True)
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
    """Concatenate the states of the same terms along several recordings."""
    return {
        id: tuple(np.concatenate(series) for series in zip(*(x.memory[id] for x in parts), strict=True))
        for id in parts[0].memory
    }


@dataclass(frozen=True)
class Windows:
    """Windowed equations of one recording of N samples; build them with `cut`.

    Attributes:
        recording: the recording.
        samples: time, smoothed position and velocity, and torque at the instants, each (N,).
        acceleration: raw second difference of the position (N,) [rad/s^2]; only its averages are meaningful.
        kernel: weights of a window (2 m + 1,), summing to one.
        centers: index of the middle sample of each window in the equations (R,): windows clear of stick, m samples
            apart, and added contacts with a stop.
        turning: middle samples of other windows with mostly motion, near a reversal, a start or a halt, m / 4 apart.
        resting: middle samples of other windows with mostly rest, m apart.
        moving: mask of samples with a speed above its noise (N,).
        is_clear: mask of samples about which a window is clear of stick (N,).
        torque_noise: standard deviation of a window's torque by white noise [N m].
        acceleration_noise: standard deviation of a window's acceleration by white noise [rad/s^2].
        acceleration_shared: correlation of the acceleration noise of windows half a window apart.
        velocity_noise: standard deviation of the smoothed velocity [rad/s].
        first, stop: range of samples with windows; earlier samples only drive terms with memory.
        at: name of the recorded joint of an arm; empty for a pendulum.
        run: number of the arm's recording, which its joints share; None for a pendulum.
        payload: known payload of the arm.
        scale: factor on the equation about each sample (N,), below one for uncertain torque; None if all are one.
        common_noise: covariances of torque noise and acceleration noise, of one window and of windows half a window
            apart [N m rad/s^2].
        inertia: known inertia of the joint without load, which scales encoder noise [kg m^2]; None if the base model
            gives it.
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
    common_noise: tuple[float, float] = (0.0, 0.0)
    inertia: float | None = None

    @cached_property
    def programs(self) -> StepPrograms:
        """Cache of compiled steps of models, for simulations of parts of the recording."""
        return StepPrograms()

    @cached_property
    def torque_scale(self) -> float:
        """Standard deviation of recorded plus known load torque [N m]; in a free swing, of the inertia's torque."""
        if not self.recording.known_inertia:
            return float(np.std(self.recording.torque + self.samples.load.torque))
        bounds = pairwise((*self.recording.starts, len(self.moving)))
        rates = [np.diff(self.samples.velocity[begin:end]) for begin, end in bounds]
        return self.recording.known_inertia * self.recording.rate * float(np.std(np.concatenate(rates)))

    @property
    def raw_torque_noise(self) -> float:
        """Standard deviation of the white noise of the torque channel [N m]."""
        return self.torque_noise / float(np.linalg.norm(_average_log(self.recording, self.kernel)))

    @property
    def unclear(self) -> Index:
        """Middle samples of the windows that are not clear of stick, `turning` and `resting`, ascending."""
        return np.sort(np.concatenate([self.turning, self.resting]))

    @cached_property
    def averages(self) -> WindowAverages:
        """Averages over the windows."""
        return self._make_window_averages(self.kernel)

    @cached_property
    def rates(self) -> WindowAverages:
        """Averages of time derivatives of series, by <w f'> = -<w' f>, for torque with a lag."""
        padded = np.pad(self.kernel, 2)
        return self._make_window_averages(0.5 * self.recording.rate * (padded[:-2] - padded[2:]))

    def _make_window_averages(self, kernel: Array) -> WindowAverages:
        """Return the averages with another kernel (2 m + 1,)."""
        narrow, wider = self._make_averages(kernel), self._make_averages(np.convolve(kernel, [1 / 12, 10 / 12, 1 / 12]))
        return WindowAverages(self.samples, self.moving, self.acceleration, narrow, wider)

    @property
    def row_scale(self) -> Array:
        """Factor on each equation (R,)."""
        return np.ones(len(self.centers)) if self.scale is None else self.scale[self.centers]

    def center_at_every_sample(self) -> Windows:
        """Return windows about every sample that is clear of stick."""
        return replace(self, centers=np.flatnonzero(self.is_clear), scale=None)

    def _make_averages(self, kernel: Array) -> Averages:
        """Return the sparse matrix (R, N) of averages with a kernel, or an operator if it would be dense."""
        count, length = len(self.centers), len(kernel)
        first, scale = self.centers - length // 2, self.row_scale
        if count * length > MAX_DENSITY * len(self.moving):
            return scipy.sparse.linalg.LinearOperator(
                (count, len(self.moving)),
                matvec=lambda series: scale * np.correlate(np.ravel(series), kernel, "valid")[first],
                dtype=np.float64,
            )
        samples = first[:, None] + np.arange(length)
        parts = np.outer(scale, kernel).ravel(), samples.ravel(), length * np.arange(count + 1)
        return scipy.sparse.csr_array(parts, shape=(count, len(self.moving)))

    def with_torque(self, torque: Array, averages: Array) -> Windows:
        """Return the windows with another torque (N,) [N m]; `averages` (N,) are its `average_held_torque`."""
        samples = replace(self.samples, torque=averages)
        return replace(self, recording=replace(self.recording, torque=torque), samples=samples)

    def average(self, series: Array) -> Array:
        """Average a series (N,) over the windows (R,)."""
        return np.asarray(self.averages.narrow @ series)

    def trace(self, variants: Sequence[Term]) -> list[Samples]:
        """Return the driving samples with the states of each variant of one effect."""
        return trace_all([self], variants)[0]

    def select_driving_samples(self, kind: type[Term]) -> Samples:
        """Return the samples (N,) that drive an effect: raw positions for impacts and transmissions, else smoothed."""
        return self._unsmoothed if kind.has_impacts or kind.kind == "transmission" else self.samples

    @cached_property
    def _unsmoothed(self) -> Samples:
        """Samples with the recorded position and its central differences (N,)."""
        q = self.recording.position
        return replace(self.samples, position=q, velocity=np.gradient(q, 1.0 / self.recording.rate))

    def columns(self, variants: Sequence[Term]) -> list[tuple[Array, Array]]:
        """Return the linear columns (R, P) and the sum of the fixed columns (R,) of each variant of one effect."""
        return self.averages.columns(variants, self.trace(variants))

    def compute_absorbed_noise(self, term: Term) -> float:
        """Estimate the variance of white torque noise that a term's fixed columns absorb [(N m)^2], by random noise."""
        noise = np.random.default_rng(0).standard_normal(len(self.recording)) * self.raw_torque_noise
        noisier = self.with_torque(self.recording.torque + noise, self.samples.torque + average_held_torque(noise))
        ((_, noisy_fixed),), ((_, fixed),) = noisier.columns([term]), self.columns([term])
        averaged_noise = self.average(average_held_torque(noise))
        return max(0.0, float(np.var(averaged_noise) - np.var(averaged_noise - (noisy_fixed - fixed))))

    def torque(self) -> Array:
        """Return the averages (R,) of the recorded torque [N m]."""
        return self.average(self.samples.torque)

    def applied_torque(self) -> Array:
        """Return the averages (R,) of the recorded torque; in a free swing -I q'' with the known inertia I [N m]."""
        known = self.recording.known_inertia
        return -known * self.average(self.acceleration) if known else self.torque()

    def net_torque(self) -> Array:
        """Return the left-hand side: the averages (R,) of the recorded torque minus that of the known load [N m]."""
        return self.torque() - self.averages.column(LOAD, self.samples) if self.samples.load else self.torque()

    def select_center_samples(self) -> Samples:
        """Return the samples at the middle of each window, without states, (R,) each."""
        x, c = self.samples, self.centers
        load, temperature = x.load.select(c), np.broadcast_to(x.temperature, x.time.shape)[c]
        return Samples(x.time[c], x.position[c], x.velocity[c], x.torque[c], load=load, temperature=temperature)

    def noise(self, inertia: float) -> float:
        """Return the standard deviation of a window's residual by noise [N m]; known loads add inertia."""
        load = self._add_load(inertia)
        separate = self.torque_noise**2 + (load * self.acceleration_noise) ** 2
        return math.sqrt(max(separate - 2 * load * self.common_noise[0], 0.0))

    def rate_noise(self, inertia: float) -> float:
        """Return the standard deviation by noise of the rate of an inertia's torque in a window [N m/s]."""
        padded = np.pad(self.kernel, 3)
        bend, slope = (float(np.linalg.norm(np.diff(padded, order))) for order in (2, 3))
        return self._add_load(inertia) * self.acceleration_noise * self.recording.rate * slope / bend

    def shared_noise(self, inertia: float) -> float:
        """Return the covariance by noise of the residuals of windows half a window apart [(N m)^2]."""
        average = _average_log(self.recording, self.kernel)
        of_torque = self.torque_noise**2 * correlate_averages(average, len(self.kernel) // 2)
        load = self._add_load(inertia)
        of_motion = (load * self.acceleration_noise) ** 2 * self.acceleration_shared
        return of_torque + of_motion - 2 * load * self.common_noise[1]

    def _add_load(self, inertia: float) -> float:
        """Return the inertia plus the largest inertia of the known load [kg m^2]."""
        return inertia + float(np.max(self.samples.load.inertia))


def average_held_torque(torque: Array) -> Array:
    """Return the average (N,) of a held torque under the triangle about each sample: (u[k-1] + u[k]) / 2.

    The first value stays.
    """
    averages = torque.copy()
    averages[1:] = 0.5 * (torque[1:] + torque[:-1])
    return averages


def trace_all(windows: Sequence[Windows], variants: Sequence[Term]) -> list[list[Samples]]:
    """Return, per recording and variant of one effect, the driving samples with the variant's states.

    States restart in each segment. Samples of an effect without state are unchanged.
    """
    kind = type(variants[0])
    driving = [w.select_driving_samples(kind) for w in windows]
    if not kind.has_state():
        return [[x] * len(variants) for x in driving]
    segments, commands, periods = [], [], []  # one of each segment
    for w, x in zip(windows, driving, strict=True):
        for begin, end in pairwise((*w.recording.starts, len(w.recording))):
            rows = slice(begin, end)
            temperature = np.broadcast_to(x.temperature, x.time.shape)[rows]
            motion = x.time[rows], x.position[rows], x.velocity[rows], x.torque[rows]
            segments.append(Samples(*motion, temperature=temperature))
            commands.append(w.recording.torque[begin:end])
            periods.append(1.0 / w.recording.rate)
    if kind.has_own_trace():
        arguments = zip(segments, commands, periods, strict=True)
        memories = iter([[variant.trace(*segment) for variant in variants] for segment in arguments])
    else:
        memories = iter(trace_variants(variants, segments, commands, periods))
    traces = []
    for w, x in zip(windows, driving, strict=True):
        of_segments = [next(memories) for _ in w.recording.starts]
        states = [
            tuple(np.concatenate(series) for series in zip(*(segment[v] for segment in of_segments), strict=True))
            for v in range(len(variants))
        ]
        traces.append([replace(x, memory=kind.name_memory(memory)) for memory in states])
    return traces


def make_bump(half_width: int) -> Array:
    """Return the weights (1 - s^2)^3, -1 < s < 1, of 2 half_width + 1 samples, summing to one."""
    s = np.arange(-half_width, half_width + 1) / (half_width + 1)
    weights = (1.0 - s**2) ** 3
    return weights / weights.sum()


Part = tuple[float, float]  # begin and end of a part, as shares of a recording
WHOLE: Part = (0.0, 1.0)


def cut(recording: Recording, half_width: float, part: Part = WHOLE, margin: float = 0.0) -> Windows:
    """Cut a recording into windows: clear of stick, turning and resting.

    Windows never overlap gaps, the lead-in of a segment, or instants with an open motor. Position and velocity are
    smoothed, acceleration is not. The torque noise includes that of the known load.

    Windows of a free swing that are longer than `HALF_WIDTHS` include reversals, but are mostly in motion: without
    torque, a joint that sticks stays at rest.

    Args:
        recording: recording, at least 0.1 s longer than a window.
        half_width: half width of a window [s], at least two samples.
        part: begin and end of the range with windows, as shares of the recording.
        margin: least time between a window and the ends of its segment [s].
    """
    m = max(2, round(half_width * recording.rate))
    has_reversals = recording.known_inertia > 0 and half_width > HALF_WIDTHS[-1]
    smoothing = max(2, round((0.3 if has_reversals else 0.75) * m))
    window, load = make_bump(m), get_known_load(recording)
    motion = differentiate_position(recording, window, smoothing)
    v = motion.velocity
    speed = np.sqrt(np.convolve(v**2, window, "same")) if has_reversals else np.abs(v)
    moving = speed > max(SLOWEST, 5 * motion.velocity_noise)
    guard = m + 1 + smoothing // 3  # smoothing may shift a zero of the velocity
    mostly_moving = np.convolve(moving, window, "same") > 0.5
    near_stick = ~mostly_moving if has_reversals else find_near_reversals(v, moving, guard)
    is_excluded = np.zeros(len(v), dtype=bool)
    distance = math.ceil(margin * recording.rate)
    for begin, end in pairwise((*recording.starts, len(recording))):
        lead_in = max(distance, round(min(LEAD_IN * recording.rate, 0.1 * (end - begin))))
        is_excluded[begin : begin + guard + 1 + lead_in] = True
        is_excluded[max(begin, end - guard - 1 - distance) : end] = True
    if not recording.powered.all():
        is_excluded |= np.convolve(recording.powered == 0.0, np.ones(2 * guard + 1))[guard : guard + len(v)] > 0
    first, stop = (round(share * len(v)) for share in part)
    candidates, dense = (np.arange(first + m, stop - m, step) for step in (m, max(1, m // 4)))
    candidates, dense = candidates[~is_excluded[candidates]], dense[~is_excluded[dense] & near_stick[dense]]
    touches_stick = near_stick[candidates]
    is_clear = ~(near_stick | is_excluded)
    is_clear[: first + m] = is_clear[stop - m :] = False
    torque_noise = _compute_torque_noise(recording, load, window)
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
        centers=candidates[~touches_stick],
        turning=dense[mostly_moving[dense]],
        resting=candidates[touches_stick & ~mostly_moving[candidates]],
        moving=moving,
        is_clear=is_clear,
        torque_noise=torque_noise,
        acceleration_noise=motion.acceleration_noise,
        acceleration_shared=correlate_averages(motion.noise_weights, m),
        velocity_noise=motion.velocity_noise,
        first=first,
        stop=stop,
        scale=scale_by_jumps(recording, window, torque_noise),
        common_noise=_compute_common_noise(recording, window, motion),
    )


def _average_log(recording: Recording, window: Array) -> Array:
    """Return the weights of samples of the log in a window's average, with the response of a torque moved in time."""
    average = np.convolve(window, [0.5, 0.5])
    return average if recording.moved is None else np.convolve(average, recording.moved.response)


def _compute_torque_noise(recording: Recording, load: KnownLoad, window: Array) -> float:
    """Return the standard deviation of a window's torque by white noise of the log and of the known load [N m]."""
    noise = estimate_white_noise(recording.torque) if recording.moved is None else recording.moved.noise
    of_load = estimate_white_noise(load.get_torque(recording.time)) * np.linalg.norm(np.convolve(window, [0.5, 0.5]))
    return math.hypot(noise * np.linalg.norm(_average_log(recording, window)), of_load)


def _compute_common_noise(recording: Recording, window: Array, motion: Motion) -> tuple[float, float]:
    """Return the covariances of torque and acceleration by noise of the encoder, see `Windows.common_noise`.

    A controller reacts to this noise without delay. A torque that was moved in time includes the reaction to its row;
    the acting torque between the rows does not.
    """
    if recording.moved is None or recording.moved.answer == 0.0:
        return 0.0, 0.0
    half, response = len(window) // 2, recording.moved.response
    of_torque = np.convolve(np.convolve(window, [0.5, 0.5]), response[::-1])  # of samples in the order of time
    of_motion = np.pad(motion.noise_weights, (len(response) // 2, len(response) // 2 - 1))
    variance = (motion.acceleration_noise / float(np.linalg.norm(motion.noise_weights))) ** 2
    shifted = of_torque[half:] @ of_motion[:-half] + of_torque[:-half] @ of_motion[half:]
    slope = recording.moved.answer * variance
    return slope * float(of_torque @ of_motion), 0.5 * slope * float(shifted)


def scale_by_jumps(recording: Recording, window: Array, torque_noise: float) -> Array | None:
    """Return the factor on the equation about each sample (N,): its noise over that with jumps; None if all are one."""
    errors = compute_jump_errors(recording)
    if torque_noise == 0 or not errors.any():
        return None
    variance = np.convolve(errors**2, window**2, "same")
    return np.asarray(1.0 / np.sqrt(1.0 + variance / torque_noise**2))


def compute_jump_errors(recording: Recording) -> Array:
    """Return the standard error of each sample of the torque by a jump at an unknown time (N,) [N m].

    The time of a jump of sampled torque is uniform between two samples, which gives the error jump / sqrt(12). A jump
    is the difference of a change from the median of five changes, if it exceeds noise.
    """
    if recording.moved is None or not recording.moved.is_sampled:
        return np.zeros(len(recording))
    changes = np.diff(recording.torque, prepend=recording.torque[0])
    changes[list(recording.starts)] = 0.0
    jumps = changes - scipy.signal.medfilt(changes, 5)
    jumps[np.abs(jumps) < 4 * np.sqrt(2) * recording.moved.noise] = 0.0
    return np.asarray(np.abs(jumps) / np.sqrt(12))
