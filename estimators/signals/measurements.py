"""Measurements: motion and torque of a recording at the same instants, through one zero-phase filter.

The torque balance stays true if each part passes the same linear filter. All quantities here pass one symmetric window
w without second and fourth moments. It does not change polynomials of fifth degree; sin q of smoothed motion has an
error of sixth order in its length. As this error is large in fast rotation, `Measurements.compute_force` filters forces
of the angle alone, as the stream of `OnlineEstimator` does.

Command k - 1 acts between samples k - 1 and k. The second difference of the position at k is the average acceleration
under a triangle over k - 1 to k + 1. The average torque under this triangle is the mean of commands k - 1 and k.
Central differences average velocity over k - 1 to k + 1 in the same way. A correction by second differences d^2 of
motion and command removes the second moment of both averages. They then agree with smooth parts of the balance
(sin q) to fourth order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimators.regression.least_squares import IdentificationError
from estimators.signals.differentiation import estimate_encoder_noise, estimate_scatter, find_halts, find_near
from estimators.signals.motion import HALF_WIDTHS, LEAD_IN, SLOWEST, find_slowest, get_known_load, get_temperature
from pendulum_env._typing import Array, ArrayLike, Mask
from pendulum_env.physics import Column, KnownLoad, Samples, Term
from pendulum_env.physics.term import ROOM, UNLOADED, Memory
from pendulum_env.recording import Recording

SPARE_SAMPLES = 30  # least number of samples of a recording beyond the filter
TYPICAL_ACCELERATION = 20.0  # [rad/s^2], RMS under the paper's excitation
MAX_NOISE = 0.005  # largest noise over RMS acceleration; it biases inertia by 2.5e-5
WIDTHS = (*HALF_WIDTHS, 0.11)  # candidates of half widths [s]
MAX_NOISE_ONLINE = 0.01  # the same online, where a longer window delays the estimates
SHORT_WINDOW = 0.01  # [s], largest half width of a short window online
MAX_NOISE_SHORT = 0.03  # the same for an estimator with a short window, which keeps more samples near reversals
MAX_NOISE_SWING = 0.03  # the same for a free swing with known inertia
SIDES = 3  # samples on either side in the kernels below
# Convolution kernels over samples k + 3 to k - 3, of fourth order: values at instant k, each times period^-derivative.
VALUE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
# (q[k+1] - q[k-1]) / 2 averages velocity over both sides of k; its change from k - 1 to k averages held commands by
# 1/4, 1/2, 1/4. 1 - d^2/6 removes the second moment of the average of velocity.
UNDO = np.array([-1.0, 8.0, -1.0]) / 6
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
        time: instants (N,) [s].
        position, velocity, acceleration: smoothed, at the instants (N,) [rad], [rad/s], [rad/s^2].
        torque: filtered torque at the instants, the mean of the commands before and after (N,) [N m].
        held: filtered torque from the sample before to this one (N,) [N m].
        moving: samples with a speed above `Smoothing.slowest` (N,).
        period: sample time [s].
        torque_noise: standard deviation of the white noise in `held` [N m].
        reach: samples on either side that a value depends on.
        memory: state variables of terms with state, by term id, see `add_states`.
        load: known load of the joint.
        temperature: temperature of the joint [deg C].
        unfiltered: samples before the filter, at rest, with `reach` - 1 more at each end; None if unknown.
        window: weights of the filter (2 reach - 1,).
        halts: samples in stick or after a reversal, see `Smoothing.halt_width`; None: those of `velocity` (N,).
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
    unfiltered: Samples | None = None
    window: Array | None = None
    halts: Mask | None = None

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

    def compute_force(self, column: Column) -> ArrayLike:
        """Compute the force of a column per unit of its parameter (N,); that of a potential is filtered.

        The filtered force differs from that at the smoothed position where the angle changes by more than about a
        radian within the window.
        """
        if (x := self.unfiltered) is None or self.window is None or column.potential is None:
            return column.force(self.samples)
        force = np.broadcast_to(column.force(x) - column.loss(x), x.time.shape)
        return np.convolve(force, self.window, "valid") + column.loss(self.samples)

    def add_noise(self, noise: Array) -> Measurements:
        """Return the measurements with noise in the position before the filter, without states.

        The noise (N + 2 reach - 2,) [rad] does not change the filter and the mask `moving`.
        """
        smoothing = Smoothing(self.reach - 1 - SIDES)
        slope, curvature = smoothing.make_step_kernels(self.period)
        steps, x = np.diff(noise), self.unfiltered
        return replace(
            self,
            position=self.position + np.convolve(noise, smoothing.make_position_kernel(), "valid"),
            velocity=self.velocity + np.convolve(steps, slope, "valid"),
            acceleration=self.acceleration + np.convolve(steps, curvature, "valid"),
            unfiltered=None if x is None else replace(x, position=x.position + noise),
            memory={},
        )

    def find_clear(self, guard: float | None) -> Mask:
        """Find samples farther than `guard` [s] and the reach of the filter from stick and reversals (N,).

        All samples are clear if `guard` is None. With `memory`, the first `LEAD_IN` seconds are left out too.
        """
        clear = np.ones(len(self), dtype=bool)
        if guard is not None:
            halts = find_halts(self.velocity, self.moving) if self.halts is None else self.halts
            clear = ~find_near(halts, max(self.reach, round(guard / self.period)))
        if self.memory:
            clear[: round(LEAD_IN / self.period)] = False
        return clear


def make_window(half_width: int) -> Array:
    """Compute smooth weights over 2 half_width + 1 samples with sum one and zero second and fourth moments."""
    s = np.arange(-half_width, half_width + 1) / (half_width + 1)
    bump, powers = (1.0 - s**2) ** 2, np.stack([s**0, s**2, s**4])
    moments = (powers * bump) @ powers.T
    weights = bump * (np.linalg.lstsq(moments, np.array([1.0, 0.0, 0.0]), rcond=None)[0] @ powers)
    return np.asarray(weights / weights.sum())


@dataclass(frozen=True)
class Smoothing:
    """Filter of motion and torque of a recording.

    Attributes:
        half_width: half width of the window [samples].
        slowest: least speed with a known sign [rad/s].
        halt_width: half width of the window of the velocity that shows stick and reversals [samples]; None: the same.
            A shorter one shows a reversal that is followed by another within the window.
    """

    half_width: int
    slowest: float = SLOWEST
    halt_width: int | None = None

    @classmethod
    def from_encoder(cls, counts: int, rate: float) -> Smoothing:
        """Choose the window for an encoder of some counts per turn at a sampling rate [Hz], see `from_noise`."""
        return cls.from_noise(compute_encoder_noise(counts), rate)

    @classmethod
    def from_noise(cls, noise: float, rate: float, is_precise: bool = False) -> Smoothing:
        """Choose the smallest half width of at least two samples that keeps noise of the acceleration below a limit.

        The limit is `MAX_NOISE_ONLINE` times `TYPICAL_ACCELERATION`, as future motion is unknown online. If no width
        satisfies this, the largest is chosen. `noise` is that of the position [rad], `rate` the sampling rate [Hz].

        With `is_precise`, for estimates at the Cramer-Rao bound, windows up to `SHORT_WINDOW` have the limit
        `MAX_NOISE_SHORT`, and a shorter window shows reversals. A diagnosis needs less noise and more samples.
        """
        widths = [m for m in range(2, max(3, round(WIDTHS[-1] * rate))) if m in (2, 3) or m % 2 == 0]
        for m in widths:
            limit = MAX_NOISE_SHORT if is_precise and m <= SHORT_WINDOW * rate else MAX_NOISE_ONLINE
            acceleration_noise = noise * rate**2 * _compute_noise_gain(np.convolve(make_window(m), CURVATURE))
            if acceleration_noise <= limit * TYPICAL_ACCELERATION:
                break
        slowest = max(SLOWEST, 5 * noise * rate * _compute_noise_gain(np.convolve(make_window(m), SLOPE)))
        return cls(m, slowest, _choose_halt_width(m, slowest, noise * rate) if is_precise else None)

    def make_position_kernel(self) -> Array:
        """Return weights (2 reach + 1,) of positions, newest first, for the smoothed position."""
        return np.convolve(make_window(self.half_width), VALUE)

    def make_step_kernels(self, period: float) -> Array:
        """Return weights (2, 2 reach) of position steps, newest first, for velocity and acceleration.

        Steps instead of positions give a resting encoder a velocity of exactly 0. `period` in [s].
        """
        w = make_window(self.half_width)
        kernels = np.array([np.convolve(w, SLOPE) / period, np.convolve(w, CURVATURE) / period**2])
        return np.cumsum(kernels, axis=1)[:, :-1]

    def make_halt_kernel(self, period: float) -> Array:
        """Return weights (2 reach,) of position steps, newest first, for the velocity that shows halts."""
        if self.halt_width is None or self.halt_width >= self.half_width:
            return np.asarray(self.make_step_kernels(period)[0])
        kernel = Smoothing(self.halt_width).make_step_kernels(period)[0]
        return np.pad(kernel, self.half_width - self.halt_width)

    def make_torque_kernels(self) -> Array:
        """Return weights (2, 2 reach + 1) of commands, newest first, for `Measurements.torque` and `.held`."""
        w = make_window(self.half_width)
        return np.array([np.convolve(w, AT_INSTANT), np.convolve(w, BEFORE)])

    @property
    def reach(self) -> int:
        """Return the number of samples on either side that a value depends on."""
        return self.half_width + SIDES


def compute_encoder_noise(counts: int) -> float:
    """Return the standard deviation of the rounding of an encoder [rad], from counts per turn; 0 for 0 counts."""
    return float(2 * np.pi / counts / np.sqrt(12)) if counts else 0.0


def measure(recording: Recording, smoothing: Smoothing | None = None) -> Measurements:
    """Filter a recording, with the window of `choose_smoothing` unless given; its own velocity is not used.

    The first and last `smoothing.reach` samples are left out.

    Raises:
        IdentificationError: if the recording is too short.
    """
    period = 1.0 / recording.rate
    least_count = SPARE_SAMPLES if smoothing is None else 2 * smoothing.half_width + SPARE_SAMPLES
    if len(recording) < least_count:
        raise IdentificationError(
            f"{recording.name}: {len(recording)} samples are too few to differentiate, at least {least_count} are "
            "needed: record longer"
        )
    smoothing = smoothing or choose_smoothing(recording)
    slope, curvature = smoothing.make_step_kernels(period)
    at_instant, before = smoothing.make_torque_kernels()
    steps = np.diff(recording.position)
    load = get_known_load(recording)
    if np.ndim(load.torque):
        load = load._replace(
            torque=np.convolve(load.get_torque(recording.time), smoothing.make_position_kernel(), "valid")
        )
    velocity, halt_velocity = (
        np.convolve(steps, kernel, "valid") for kernel in (slope, smoothing.make_halt_kernel(period))
    )
    return Measurements(
        time=recording.time[smoothing.reach : -smoothing.reach],
        position=np.convolve(recording.position, smoothing.make_position_kernel(), "valid"),
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
        halts=find_halts(halt_velocity, np.abs(halt_velocity) > smoothing.slowest),
    )


def measure_segments(recording: Recording) -> list[Measurements]:
    """Filter each segment of a recording of one joint, see `measure_joints`."""
    return [m for (m,) in measure_joints([recording])]


def measure_joints(joints: Sequence[Recording]) -> list[tuple[Measurements, ...]]:
    """Filter n joints in each segment of their recordings; return n measurements per segment.

    All joints have the same width of the window, since their equations share all motion. It is the largest that a joint
    chooses in the longest segment. Shorter segments than this window are left out.

    Raises:
        IdentificationError: if all segments are too short.
    """
    segments = list(zip(*(joint.segments for joint in joints), strict=True))
    longest = max(segments, key=lambda segment: len(segment[0]))
    if len(longest[0]) < SPARE_SAMPLES:
        measure(longest[0])  # raises the error
    chosen = [choose_smoothing(joint) for joint in longest]
    width = max(smoothing.half_width for smoothing in chosen)
    chosen = [replace(smoothing, half_width=width) for smoothing in chosen]
    return [
        tuple(measure_with_unfiltered(*pair) for pair in zip(segment, chosen, strict=True))
        for segment in segments
        if len(segment[0]) >= 2 * width + SPARE_SAMPLES
    ]


def measure_with_unfiltered(recording: Recording, smoothing: Smoothing) -> Measurements:
    """Filter a recording and keep its samples before the filter, for `Measurements.compute_force`."""
    rest, load = np.zeros(len(recording)), get_known_load(recording)
    unfiltered = Samples(recording.time, recording.position, rest, recording.torque, load=load)
    return replace(measure(recording, smoothing), unfiltered=unfiltered, window=smoothing.make_position_kernel())


def add_states(m: Measurements, terms: Sequence[Term]) -> Measurements:
    """Return the measurements with the states of terms in `memory`, driven by `held`; present states stay."""
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

    If no candidate has negligible noise, the longest is chosen. Short windows keep more samples near reversals, which
    show friction.
    """
    noise = estimate_encoder_noise(recording)
    widths = _list_half_widths(recording)
    half_width = next((width for width in widths if _has_negligible_noise(recording, width, noise)), widths[-1])
    velocity_noise = noise * recording.rate * _compute_noise_gain(np.convolve(make_window(half_width), SLOPE))
    velocity = np.convolve(recording.position, np.convolve(make_window(half_width), SLOPE), "valid") * recording.rate
    slowest = max(find_slowest(velocity), 5 * velocity_noise)
    return Smoothing(half_width, slowest, _choose_halt_width(half_width, slowest, noise * recording.rate))


def _choose_halt_width(half_width: int, slowest: float, noise: float) -> int:
    """Choose the shortest window whose velocity noise is a fifth of `slowest` at most; `noise` is per period."""
    for m in range(2, half_width):
        if 5 * noise * _compute_noise_gain(np.convolve(make_window(m), SLOPE)) <= slowest:
            return m
    return half_width


def has_encoder_bias(recording: Recording) -> bool:
    """Return whether encoder noise in the acceleration is not negligible in the longest window."""
    longest = _list_half_widths(recording)[-1]
    return not _has_negligible_noise(recording, longest, estimate_encoder_noise(recording))


def _list_half_widths(recording: Recording) -> list[int]:
    """List candidates of half widths [samples], ascending."""
    longest = (len(recording) - SPARE_SAMPLES) // 2
    return sorted({min(longest, max(2, round(width * recording.rate))) for width in WIDTHS})


def _has_negligible_noise(recording: Recording, half_width: int, noise: float) -> bool:
    """Return whether position noise [rad] in the acceleration is below `MAX_NOISE` of the RMS acceleration.

    In a free swing, the limit is `MAX_NOISE_SWING`.
    """
    limit = MAX_NOISE_SWING if recording.known_inertia else MAX_NOISE
    curvature = np.convolve(make_window(half_width), CURVATURE)
    total_square = float(np.mean(np.convolve(recording.position, curvature, "valid") ** 2))
    noise_square = (noise * _compute_noise_gain(curvature)) ** 2
    return noise_square <= limit**2 * max(0.0, total_square - noise_square)


def _compute_noise_gain(kernel: Array) -> float:
    """Compute the gain of a kernel (K,) for the standard deviation of white noise."""
    return float(np.sqrt(kernel @ kernel))
