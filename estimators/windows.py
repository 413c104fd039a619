"""Weak form of the torque balance: averages over short smooth windows that stay clear of stick.

Multiplying the balance by a smooth window w of compact support and integrating gives one equation per window,

    <w tau> = sum_k theta_k <w (mass_k q'' + force_k + dry_k sgn q')>,

in which both sides pass the same zero-phase low-pass filter. Windows that overlap little have nearly uncorrelated
errors, so ordinary least squares on them is close to efficient, and a window either touches stick or it does not.

Two facts about sampled data are built in. The command is held: the second difference of the position at sample k is
the average acceleration under a triangle over samples k - 1 to k + 1, whose torque is exactly the mean of commands
k - 1 and k. The same triangle acts on smooth functions as (f[k-1] + 10 f[k] + f[k+1]) / 12 (Numerov).

Source: weak-form identification as in Messenger and Bortz, Multiscale Modeling and Simulation 19(3), 2021.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import binary_dilation
from scipy.signal import savgol_filter

from pendulum_env._typing import Array, ArrayLike, Index, Mask
from pendulum_env.physics import BASE, Column, Samples, Term
from pendulum_env.physics.term import trace
from pendulum_env.recording import Recording

HALF_WIDTHS = (0.008, 0.01, 0.012, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05, 0.06, 0.08)  # [s], candidates, short to long
FOLDS, RUN = 10, 4  # of cross-validation: how many, and windows in a row in one
LEAST_NOISE = 5e-4  # of the torque
LEAD_IN = 0.3  # [s] at the start, in which effects with memory still know a start that was not recorded
TRIFLE = 0.01  # share of the torque; encoder noise below it hides nothing worth finding
FEWEST = 100  # windows that a length has to leave clear of stick,
CLEAR = 0.3  # or share of the recording
SLOWEST = 0.02  # [rad/s]; below it, or below five times its noise, a velocity has no sign


class IdentificationError(ValueError):
    """Data from which nothing can be identified; the message says why and what to record instead."""


@dataclass(frozen=True)
class Equations:
    """Linear regression y = phi theta + error in N m: phi (R, P), y (R,)."""

    phi: Array
    y: Array


@dataclass(frozen=True)
class Windows:
    """Windowed equations of one recording; build them with `cut`.

    Attributes:
        recording: the recording.
        samples: time, smoothed position and velocity, and torque at the instants, each (N,).
        acceleration: raw second difference of the position, or first difference of a measured velocity where that is
            less noisy, (N,) [rad/s^2]; only its averages are meaningful.
        kernel: window w, (2 m + 1,), summing to one.
        centers: sample index of each window that is clear of stick, (R,).
        moving: samples whose velocity has a sign, (N,).
        torque_noise: standard deviation of a window's torque from white noise [N m].
        acceleration_noise: the same for its acceleration [rad/s^2].
        velocity_noise: standard deviation of the smoothed velocity [rad/s].
        first, stop: samples from which windows are taken, a part of the recording; the rest leads terms with memory in.
    """

    recording: Recording
    samples: Samples
    acceleration: Array
    kernel: Array
    centers: Index
    moving: Mask
    torque_noise: float
    acceleration_noise: float
    velocity_noise: float
    first: int
    stop: int

    @property
    def raw_torque_noise(self) -> float:
        """Standard deviation of the white noise of the torque channel [N m]."""
        return self.torque_noise / float(np.linalg.norm(np.convolve(self.kernel, [0.5, 0.5])))

    def average(self, series: ArrayLike, kernel: Array | None = None) -> Array:
        """Averages (R,) of a series (N,) over the windows."""
        kernel = self.kernel if kernel is None else kernel
        series = np.broadcast_to(np.asarray(series, dtype=float), self.acceleration.shape)
        if len(self.centers) == 0:
            return np.empty(0)
        return sliding_window_view(series, len(kernel))[self.centers - len(kernel) // 2] @ kernel

    def trace(self, variants: Sequence[Term]) -> list[Samples]:
        """Samples with the state variables that each of several variants of one effect has along the recording."""
        recording, period, x, kind = self.recording, 1.0 / self.recording.rate, self.samples, type(variants[0])
        if kind.kind == "transmission":  # impacts are shorter than any smoothing
            x = replace(x, position=recording.position, velocity=np.gradient(recording.position, period))
        if kind.trace is not Term.trace:
            memories = [variant.trace(x, recording.torque, period) for variant in variants]
        elif kind.advance is not Term.advance:
            memories = trace(variants, x, recording.torque, period)
        else:
            return [x] * len(variants)
        return [replace(x, memory={v.id: memory}) for v, memory in zip(variants, memories, strict=True)]

    def column(self, column: Column, x: Samples) -> Array:
        """Averages (R,) of a column of the regressor, `x` being the samples with the term's state variables."""
        numerov = np.convolve(self.kernel, [1 / 12, 10 / 12, 1 / 12])
        smooth = column.force(x) + column.dry(x) * np.sign(x.velocity)
        averages = self.average(column.mass(x) * self.acceleration) + self.average(smooth, numerov)
        return np.nan_to_num(averages, nan=0.0, posinf=0.0, neginf=0.0)  # a state that diverged explains nothing

    def columns(self, variants: Sequence[Term]) -> list[tuple[Array, Array]]:
        """For each variant of one effect its linear columns (R, P) and the sum of its fixed columns (R,)."""
        parts = []
        for variant, x in zip(variants, self.trace(variants), strict=True):
            linear = [self.column(c, x) for c in variant.columns]
            # fixed columns are torques that hold like the command, and already averages over the triangle
            fixed = sum((self.average(c.force(x)) for c in variant.fixed), np.zeros(len(self.centers)))
            fixed = np.nan_to_num(fixed, nan=0.0, posinf=0.0, neginf=0.0)
            parts.append((np.column_stack(linear) if linear else np.empty((len(self.centers), 0)), fixed))
        return parts

    def muffled(self, term: Term) -> float:
        """Variance of white torque noise that the term's fixed columns take out of the windows [(N m)^2]."""
        noise = np.random.default_rng(0).standard_normal(len(self.recording)) * self.raw_torque_noise
        held = noise.copy()
        held[1:] = 0.5 * (noise[1:] + noise[:-1])
        heard = replace(
            self, recording=replace(self.recording, torque=noise), samples=replace(self.samples, torque=held)
        )
        ((_, taken),) = heard.columns([term])
        raw = heard.torque()
        return float(np.var(raw) - np.var(raw - taken))

    def torque(self) -> Array:
        """Averages (R,) of the measured torque [N m]."""
        return self.average(self.samples.torque)

    def at_centers(self) -> Samples:
        """Samples at the windows' centres, (R,) each."""
        x, c = self.samples, self.centers
        return Samples(x.time[c], x.position[c], x.velocity[c], x.torque[c])

    def noise(self, inertia: float) -> float:
        """Standard deviation that measurement noise alone gives a window's residual [N m]."""
        return float(np.hypot(self.torque_noise, inertia * self.acceleration_noise))


def bump(half_width: int) -> Array:
    """Window (1 - s^2)^3 over 2 half_width + 1 samples, summing to one."""
    s = np.arange(-half_width, half_width + 1) / (half_width + 1)
    weights = (1.0 - s**2) ** 3
    return weights / weights.sum()


def white_noise(series: Array) -> float:
    """Standard deviation of the white part of a smooth signal, from its fourth differences; robust against steps."""
    differences = np.diff(series, 4)
    spread = float(np.median(np.abs(differences))) / 0.6745 / np.sqrt(comb(8, 4))
    steps = np.abs(np.diff(series))
    quantum = float(steps[steps > 1e-12].min(initial=np.inf))
    return max(spread, quantum / np.sqrt(12)) if np.isfinite(quantum) else spread


def smooth_motion(position: Array, period: float, half_width: int) -> tuple[Array, Array]:
    """Zero-phase position and velocity from local cubic polynomials over 2 half_width + 1 samples."""
    length = min(2 * half_width + 1, len(position) - 1 + len(position) % 2)
    smoothed = savgol_filter(position, length, 3)
    velocity = savgol_filter(position, length, 3, deriv=1, delta=period)
    return smoothed, velocity


@dataclass(frozen=True)
class Motion:
    """Position, velocity and acceleration (N,), with the noise of the latter two after smoothing and windowing."""

    position: Array
    velocity: Array
    acceleration: Array
    velocity_noise: float
    acceleration_noise: float


def _from_position(recording: Recording, window: Array, half_width: int) -> Motion:
    period = 1.0 / recording.rate
    q, v = smooth_motion(recording.position, period, half_width)
    a = np.zeros_like(q)
    a[1:-1] = np.diff(recording.position, 2) / period**2
    noise = white_noise(recording.position)
    # slope of the cubic fit: variance 28.1 / (2 s)^3 per unit of position noise, for large s
    slope = noise * np.sqrt(28.1 / (2 * half_width) ** 3) / period
    curvature = np.convolve(window, [1.0, -2.0, 1.0]) / period**2
    return Motion(q, v, a, slope, noise * float(np.linalg.norm(curvature)))


def _from_velocity(recording: Recording, window: Array, half_width: int) -> Motion | None:
    """Motion from a measured velocity, None where that disagrees with the position."""
    if recording.velocity is None:
        return None
    period = 1.0 / recording.rate
    q, slope = smooth_motion(recording.position, period, half_width)
    v, a_smooth = smooth_motion(recording.velocity, period, half_width)
    # v = scale (q' - delay q''): a velocity in other units, or filtered, must not replace the encoder
    scale, lag = np.linalg.lstsq(np.column_stack([slope, -a_smooth]), v, rcond=None)[0]
    if abs(scale - 1) > 0.03 or abs(lag) > 0.5 * period:
        return None
    a = np.zeros_like(q)
    a[1:-1] = (recording.velocity[2:] - recording.velocity[:-2]) / (2 * period)
    noise = white_noise(recording.velocity)
    slope_of_window = np.convolve(window, [0.5, 0.0, -0.5]) / period
    return Motion(q, v, a, noise * 1.5 / np.sqrt(2 * half_width), noise * float(np.linalg.norm(slope_of_window)))


Part = tuple[float, float]  # shares of a recording where a part begins and ends
WHOLE: Part = (0.0, 1.0)


def cut(recording: Recording, half_width: float, part: Part = WHOLE) -> Windows:
    """Windows of a recording, or of a part of it.

    Args:
        recording: at least 0.1 s longer than a window.
        half_width: of a window [s]; at least two samples are taken.
        part: where windows are taken from.
    """
    m = max(2, round(half_width * recording.rate))
    smoothing = max(2, round(0.75 * m))
    window = bump(m)
    motion = _from_position(recording, window, smoothing)
    measured = _from_velocity(recording, window, smoothing)
    if measured and measured.acceleration_noise < 0.7 * motion.acceleration_noise:
        motion = measured
    torque = recording.torque.copy()
    torque[1:] = 0.5 * (recording.torque[1:] + recording.torque[:-1])
    v = motion.velocity
    moving = np.abs(v) > max(SLOWEST, 5 * motion.velocity_noise)
    halted = ~moving
    halted[1:] |= np.sign(v[1:]) != np.sign(v[:-1])
    guard = m + smoothing + 1
    near = binary_dilation(halted, iterations=guard)
    near[: guard + 1] = near[-guard - 1 :] = True
    lead_in = round(min(LEAD_IN, 0.1 * recording.duration) * recording.rate)
    first, stop = (round(share * len(v)) for share in part)
    candidates = np.arange(max(guard + 1 + lead_in, first + m), min(len(v) - guard - 1, stop - m), m)
    held = np.convolve(window, [0.5, 0.5])
    return Windows(
        recording=recording,
        samples=Samples(recording.time, motion.position, v, torque),
        acceleration=motion.acceleration,
        kernel=window,
        centers=candidates[~near[candidates]],
        moving=moving,
        torque_noise=white_noise(recording.torque) * float(np.linalg.norm(held)),
        acceleration_noise=motion.acceleration_noise,
        velocity_noise=motion.velocity_noise,
        first=first,
        stop=stop,
    )


@dataclass(frozen=True)
class Dataset:
    """Windows of one or several recordings that share one set of parameters.

    Attributes:
        windows: one entry a recording.
        weights: relative weight of each equation, (R,): recordings with more noise count less.
        blocks: fold of each equation in cross-validation, (R,). Folds take turns along the recording, a few windows
            each, so that an event that happens once (a stop that is hit, a payload that is lost) is in most of them.
        clusters: the same with shorter stretches, for standard errors under correlated residuals.
    """

    windows: tuple[Windows, ...]
    weights: Array
    blocks: Index
    clusters: Index

    @property
    def samples(self) -> Samples:
        """Samples at the windows' centres, all recordings in a row, (R,) each."""
        parts = [w.at_centers() for w in self.windows]
        return Samples(
            np.concatenate([x.time for x in parts]),
            np.concatenate([x.position for x in parts]),
            np.concatenate([x.velocity for x in parts]),
            np.concatenate([x.torque for x in parts]),
        )

    def columns(self, variants: Sequence[Term]) -> list[tuple[Array, Array]]:
        """For each variant of one effect its linear columns (R, P) and the sum of its fixed columns (R,)."""
        per_window = [w.columns(variants) for w in self.windows]
        return [
            (np.concatenate([phi for phi, _ in parts]), np.concatenate([fixed for _, fixed in parts]))
            for parts in zip(*per_window, strict=True)
        ]

    def torque(self) -> Array:
        """Windowed measured torque, (R,) [N m]."""
        return np.concatenate([w.torque() for w in self.windows])

    def equations(self, terms: Sequence[Term]) -> Equations:
        """Regression of the measured torque, less the terms' fixed columns, on their linear columns."""
        parts = [self.columns([term])[0] for term in terms]
        phi = np.column_stack([linear for linear, _ in parts])
        return Equations(phi, self.torque() - sum(fixed for _, fixed in parts))

    def muffled(self, term: Term) -> float:
        """Variance of torque noise that the term takes out, mean over the equations [(N m)^2]."""
        counts = [len(w.centers) for w in self.windows]
        parts = [count * w.muffled(term) for count, w in zip(counts, self.windows, strict=True) if count]
        return sum(parts) / max(1, sum(counts))

    def noise(self, inertia: float) -> float:
        """Root mean square over the windows of what measurement noise alone leaves [N m]."""
        counts = np.array([len(w.centers) for w in self.windows])
        levels = np.array([w.noise(inertia) for w in self.windows])
        least = LEAST_NOISE * float(np.std(self.torque()))  # smoothing and integration are not exact either
        return max(least, float(np.sqrt(np.sum(counts * levels**2) / max(1, counts.sum()))))


def _numbers(windows: Sequence[Windows], length: float) -> Index:
    """Number the stretches of about `length` seconds that the equations lie in, never across recordings."""
    numbers, offset = [], 0
    for w in windows:
        stretches = max(1, round(w.recording.duration / length))
        which = np.minimum((w.centers * stretches) // len(w.recording), stretches - 1)
        numbers.append(which + offset)
        offset += stretches
    return np.unique(np.concatenate(numbers), return_inverse=True)[1]


def _widths(recording: Recording) -> tuple[float, ...]:
    """Half widths that are at least two samples and that leave windows enough."""
    shortest = 2.0 / recording.rate
    return tuple(h for h in HALF_WIDTHS if h >= 0.99 * shortest) or (shortest,)


def choose_half_width(recording: Recording) -> float:
    """Shortest half width [s] at which encoder noise no longer dominates torque noise.

    Short windows keep more samples near reversals, where friction shows; but the second difference of a coarse encoder
    is all noise, which falls with the window's length to the power -2.5.
    """
    widths = _widths(recording)
    inertia = 0.0
    for width in reversed(widths):  # the longest that leaves enough windows knows inertia best
        equations = dataset((cut(recording, width),)).equations(BASE)
        if len(equations.y) >= 20:
            inertia = abs(float(np.linalg.lstsq(equations.phi, equations.y, rcond=None)[0][0]))
            break
    enough = TRIFLE * float(np.std(recording.torque))
    cuts = [cut(recording, width) for width in widths]
    covered = [len(w.centers) * width for w, width in zip(cuts, widths, strict=True)]  # [s], clear of stick
    enough_windows = [
        len(w.centers) >= FEWEST or time >= CLEAR * recording.duration for w, time in zip(cuts, covered, strict=True)
    ]
    feasible = [i for i, fine in enumerate(enough_windows) if fine] or [int(np.argmax(covered))]
    quiet = [i for i in feasible if inertia * cuts[i].acceleration_noise <= max(0.7 * cuts[i].torque_noise, enough)]
    return widths[quiet[0] if quiet else feasible[-1]]


def dataset(windows: Sequence[Windows]) -> Dataset:
    """Put windows of several recordings together, weighted by their noise and split into folds."""
    total = sum(w.recording.duration for w in windows)
    reference = float(np.median([np.std(w.recording.torque) for w in windows]))
    levels = [max(w.noise(0.05), 0.003 * reference) for w in windows]
    weights = [np.full(len(w.centers), min(levels) / level) for w, level in zip(windows, levels, strict=True)]
    return Dataset(
        tuple(windows),
        np.concatenate(weights),
        np.arange(sum(len(w.centers) for w in windows)) // RUN % FOLDS,
        _numbers(windows, min(0.5, total / 30)),
    )


def prepare(recordings: Sequence[Recording], half_widths: Sequence[float] | None = None, part: Part = WHOLE) -> Dataset:
    """Windowed equations of recordings or of a part of each, with window lengths fit to their noise unless given.

    Raises:
        IdentificationError: if too little of the motion is clear of stick to fit anything.
    """
    widths = half_widths or [choose_half_width(recording) for recording in recordings]
    windows = [cut(recording, width, part) for recording, width in zip(recordings, widths, strict=True)]
    usable = sum(len(w.centers) for w in windows)
    if usable < 20:
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: only {usable} stretches of motion are clear of stick and reversals, at least 20 are needed: "
            "record longer, faster or wider motion"
        )
    return dataset(windows)
