"""Measurements: motion and torque of a recording at the same instants, through one zero-phase filter.

The torque balance stays true if every part of it passes the same linear filter. All quantities here pass one symmetric
window w without a second moment, so that it is transparent to cubics: linear terms suffer nothing from it, and sin q
or |q'| of smoothed motion are off by a fourth power of its length only.

The command is held: between samples k - 1 and k acts command k - 1. The second difference of the position at k is the
average acceleration under a triangle over k - 1 to k + 1, and the torque under that triangle is exactly the mean of
commands k - 1 and k. Central differences average velocity likewise. Whatever differentiation averages, command and
motion are averaged alike, and a correction by second differences d^2 undoes it for both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.regression.least_squares import IdentificationError
from estimators.signals.differentiation import estimate_encoder_noise, estimate_scatter, find_near_reversals
from estimators.signals.motion import HALF_WIDTHS, LEAD_IN, SLOWEST, get_known_load, get_temperature
from pendulum_env._typing import Array, ArrayLike, Mask
from pendulum_env.physics import KnownLoad, Samples, Term
from pendulum_env.physics.term import ROOM, UNLOADED, Memory
from pendulum_env.recording import Recording

SPARE = 30  # samples that a recording is longer than the filter
TYPICAL_ACCELERATION = 20.0  # [rad/s^2], RMS, of a run under the paper's excitation
CLEAN = 0.01  # of the RMS acceleration: more noise than this biases inertia by more than 1e-4
CLEAN_SWING = 0.03  # the same of a free swing, whose acceleration is no unknown's column: there noise biases nothing
SIDES = 3  # samples on either side that the kernels below reach to
# Convolution kernels over samples k + 3 to k - 3, of fourth order: values at instant k, each times period^-derivative.
VALUE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
# (q[k+1] - q[k-1]) / 2 averages velocity, if it is linear between samples, by 1/4, 1/2, 1/4; 1 - d^2/4 undoes it.
UNDO = np.array([-1.0, 6.0, -1.0]) / 4
SLOPE = np.pad(np.convolve([0.5, 0.0, -0.5], UNDO), 1)
BEFORE = np.pad(np.convolve([0.25, 0.5, 0.25], UNDO), (2, 0))  # of the command: k - 1, which acts until instant k
# q[k+1] - 2 q[k] + q[k-1] averages acceleration by a triangle over both sides of k; 1 - d^2/12 undoes it.
SHARPEN = np.array([-1.0, 14.0, -1.0]) / 12
CURVATURE = np.pad(np.convolve([1.0, -2.0, 1.0], SHARPEN), 1)
AT_INSTANT = np.pad(np.convolve([0.0, 0.5, 0.5], SHARPEN), 1)


@dataclass(frozen=True, eq=False)
class Measurements:
    """N filtered samples of one recording, without its ends; made by `measure`.

    Attributes:
        time: (N,) [s].
        position, velocity, acceleration: smoothed, at the instants (N,) [rad], [rad/s], [rad/s^2].
        torque: at the instants, between two commands (N,) [N m].
        held: mean torque between the sample before and this one (N,) [N m].
        moving: samples whose velocity has a sign beyond its noise (N,).
        period: between samples [s].
        torque_noise: standard deviation of the white noise in `held` [N m].
        reach: samples on either side that a value depends on.
        memory: state variables of terms that have any, by term id, see `remember`.
        load: what is known to hang on the joint, and to act on it.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    held: Array
    moving: Mask
    period: float
    torque_noise: float
    reach: int
    memory: Mapping[str, Memory] = field(default_factory=dict)
    load: KnownLoad = UNLOADED
    temperature: ArrayLike = ROOM

    def __len__(self) -> int:
        return len(self.time)

    @property
    def rate(self) -> float:
        """Return the sampling rate [Hz]."""
        return 1.0 / self.period

    @property
    def samples(self) -> Samples:
        """Return the samples on which columns depend, (N,) each."""
        return Samples(self.time, self.position, self.velocity, self.torque, self.memory, self.load, self.temperature)

    def clear(self, guard: float | None) -> Mask:
        """Find samples that are farther than `guard` [s] and the reach of the filter from stick and reversals (N,).

        Terms with memory do not know their start: with them, the first moments are left out too.
        """
        clear = np.ones(len(self), dtype=bool)
        if guard is not None:
            clear = ~find_near_reversals(self.velocity, self.moving, max(self.reach, round(guard / self.period)))
        if self.memory:
            clear[: round(LEAD_IN / self.period)] = False
        return clear


def make_window(half_width: int) -> Array:
    """Compute smooth weights over 2 half_width + 1 samples with sum one and zero second moment."""
    s = np.arange(-half_width, half_width + 1) / (half_width + 1)
    bump = (1.0 - s**2) ** 3
    fourth = bump @ s**4
    weights = bump * (1.0 - s**2 * (bump @ s**2 / fourth)) if fourth > 0 else bump
    total: float = weights.sum()
    return weights / total


@dataclass(frozen=True)
class Smoothing:
    """Filter of motion and torque of a recording.

    Attributes:
        half_width: of its window [samples].
        slowest: velocity below which its sign is not trusted [rad/s].
    """

    half_width: int
    slowest: float = SLOWEST

    @classmethod
    def of_encoder(cls, counts: int, rate: float) -> Smoothing:
        """Choose the window for the resolution of an encoder, see `of_noise`."""
        return cls.of_noise(compute_encoder_noise(counts), rate)

    @classmethod
    def of_noise(cls, noise: float, rate: float) -> Smoothing:
        """Choose the smallest half-width of at least two samples with negligible position noise in the acceleration.

        For online use, where the motion to come is not known: it is taken to be as lively as `TYPICAL_ACCELERATION`.
        """
        widths = [m for m in range(2, max(3, round(HALF_WIDTHS[-1] * rate))) if m in (2, 3) or m % 2 == 0]
        for m in widths:
            if (
                noise * rate**2 * _compute_noise_gain(np.convolve(make_window(m), CURVATURE))
                <= CLEAN * TYPICAL_ACCELERATION
            ):
                break
        return cls(m, max(SLOWEST, 5 * noise * rate * _compute_noise_gain(np.convolve(make_window(m), SLOPE))))

    def of_position(self) -> Array:
        """Return weights (2 reach + 1,) of positions, newest first, for the position."""
        return np.convolve(make_window(self.half_width), VALUE)

    def of_steps(self, period: float) -> Array:
        """Return weights (2, 2 reach) of position steps, newest first, for velocity and acceleration.

        Steps rather than positions: while the encoder stands still, velocity is then 0 and not what rounding leaves.
        """
        w = make_window(self.half_width)
        kernels = np.array([np.convolve(w, SLOPE) / period, np.convolve(w, CURVATURE) / period**2])
        return np.cumsum(kernels, axis=1)[:, :-1]

    def of_torque(self) -> Array:
        """Return weights (2, 2 reach + 1), newest first, for the torque at the instant and over the sample before."""
        w = make_window(self.half_width)
        return np.array([np.convolve(w, AT_INSTANT), np.convolve(w, BEFORE)])

    @property
    def reach(self) -> int:
        """Return the number of samples on either side of a value; the torque uses one later sample less."""
        return self.half_width + SIDES


def compute_encoder_noise(counts: int) -> float:
    """Return the standard deviation of the position noise of an encoder [rad]; 0 counts measure exactly."""
    return float(2 * np.pi / counts / np.sqrt(12)) if counts else 0.0


def measure(recording: Recording, smoothing: Smoothing | None = None) -> Measurements:
    """Filter a recording; its velocity is not used, since its delay is unknown.

    Raises:
        IdentificationError: if the recording is too short.
    """
    period = 1.0 / recording.rate
    fewest = SPARE if smoothing is None else 2 * smoothing.half_width + SPARE
    if len(recording) < fewest:
        raise IdentificationError(
            f"{recording.name}: {len(recording)} samples are too few to differentiate, at least {fewest} are needed: "
            "record longer"
        )
    smoothing = smoothing or choose_smoothing(recording)
    slope, curvature = smoothing.of_steps(period)
    at_instant, before = smoothing.of_torque()
    steps = np.diff(recording.position)
    load = get_known_load(recording)
    if np.ndim(load.torque):
        load = load._replace(torque=np.convolve(load.get_torque(recording.time), smoothing.of_position(), "valid"))
    velocity = np.convolve(steps, slope, "valid")
    return Measurements(
        time=recording.time[smoothing.reach : -smoothing.reach],
        position=np.convolve(recording.position, smoothing.of_position(), "valid"),
        velocity=velocity,
        acceleration=np.convolve(steps, curvature, "valid"),
        torque=np.convolve(recording.torque, at_instant, "valid"),
        held=np.convolve(recording.torque, before, "valid"),
        moving=np.abs(velocity) > smoothing.slowest,
        period=period,
        torque_noise=estimate_scatter(recording.torque) * _compute_noise_gain(before),
        reach=smoothing.reach + 1,
        load=load,
        temperature=get_temperature(recording)[smoothing.reach : -smoothing.reach],
    )


def measure_segments(recording: Recording) -> list[Measurements]:
    """Filter each segment of a recording, see `measure_joints`."""
    return [m for (m,) in measure_joints([recording])]


def measure_joints(joints: Sequence[Recording]) -> list[tuple[Measurements, ...]]:
    """Filter n joints in each segment of their recordings; segments too short to differentiate are left out.

    All pass the longest of the windows that the joints ask for: their rows of the balance share all motion.
    """
    segments = list(zip(*(joint.segments for joint in joints), strict=True))
    longest = max(segments, key=lambda segment: len(segment[0]))
    if len(longest[0]) < SPARE:
        measure(longest[0])  # says so
    chosen = [choose_smoothing(joint) for joint in longest]
    width = max(smoothing.half_width for smoothing in chosen)
    chosen = [replace(smoothing, half_width=width) for smoothing in chosen]
    return [
        tuple(measure(*pair) for pair in zip(segment, chosen, strict=True))
        for segment in segments
        if len(segment[0]) >= 2 * width + SPARE
    ]


def remember(m: Measurements, terms: Sequence[Term]) -> Measurements:
    """Add the states of the terms along measurements, driven by the acting torque."""
    command = np.append(m.held[1:], m.held[-1])  # from each sample to the next
    states = {
        id: memory
        for term in terms
        if term.has_state() and term.id not in m.memory
        for id, memory in term.name_memory(term.trace(m.samples, command, m.period)).items()
    }
    return replace(m, memory={**m.memory, **states}) if states else m


def choose_smoothing(recording: Recording) -> Smoothing:
    """Choose the shortest window of at least two samples with negligible encoder noise in the acceleration.

    Short windows keep more samples near reversals, where friction shows; but the second difference of a coarse encoder
    is all noise, which falls with the window's length to the power -2.5.
    """
    noise, clean = estimate_encoder_noise(recording.position), CLEAN_SWING if recording.known_inertia else CLEAN
    longest = (len(recording) - SPARE) // 2
    widths = sorted({min(longest, max(2, round(width * recording.rate))) for width in HALF_WIDTHS})
    for m in widths:
        curvature = np.convolve(make_window(m), CURVATURE)
        total = float(np.mean(np.convolve(recording.position, curvature, "valid") ** 2))
        encoder = (noise * _compute_noise_gain(curvature)) ** 2
        if encoder <= clean**2 * max(0.0, total - encoder):
            break
    return Smoothing(
        m, max(SLOWEST, 5 * noise * recording.rate * _compute_noise_gain(np.convolve(make_window(m), SLOPE)))
    )


def _compute_noise_gain(kernel: Array) -> float:
    """Compute the gain of a kernel for white noise."""
    return float(np.sqrt(kernel @ kernel))
