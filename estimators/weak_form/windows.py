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
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.signals.differentiation import differentiate_position, find_near_reversals
from estimators.signals.motion import HALF_WIDTHS, LEAD_IN, find_slowest, get_known_load, get_temperature
from estimators.weak_form.averages import WindowAverages
from estimators.weak_form.resolution import RESOLUTION
from estimators.weak_form.window_noise import WindowNoise, scale_by_jumps
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import Samples
from pendulum_env.physics.mechanism import LinkLoad
from pendulum_env.physics.simulation import StepPrograms
from pendulum_env.recording import Recording


@dataclass(frozen=True, eq=False)
class Stick:
    """Windows of a recording of N samples that include stick, by their middle samples, and samples clear of it.

    Attributes:
        turning: windows with mostly motion, near a reversal, a start or a halt, m / 4 samples apart.
        resting: windows with mostly rest, m samples apart.
        is_clear: mask of samples about which a window is clear of stick (N,).
    """

    turning: Index
    resting: Index
    is_clear: Mask

    @property
    def centers(self) -> Index:
        """Middle samples of the windows that are not clear of stick, `turning` and `resting`, ascending."""
        return np.sort(np.concatenate([self.turning, self.resting]))


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
        stick: other windows, which include stick.
        moving: mask of samples with a speed above its noise (N,).
        noise: noise of a window.
        first, stop: range of samples with windows; earlier samples are inputs of terms with memory alone.
        at: name of the recorded joint; empty for a pendulum.
        run: number of the recording, which joints with links share; None for a pendulum.
        payload: known payload on a link.
        scale: factor on the equation about each sample (N,), below one for uncertain torque; None if all are one.
        inertia: known inertia of the joint without load, which scales encoder noise [kg m^2]; None if the base model
            gives it.
    """

    recording: Recording
    samples: Samples
    acceleration: Array
    kernel: Array
    centers: Index
    stick: Stick
    moving: Mask
    noise: WindowNoise
    first: int
    stop: int
    at: str = ""
    run: int | None = None
    payload: LinkLoad | None = None
    scale: Array | None = None
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
        rates = [np.diff(self.samples.velocity[part]) for part in self.recording.segment_slices]
        return self.recording.known_inertia * self.recording.rate * float(np.std(np.concatenate(rates)))

    @cached_property
    def averages(self) -> WindowAverages:
        """Averages over the windows."""
        return self._make_averages(self.kernel)

    @cached_property
    def rates(self) -> WindowAverages:
        """Averages of time derivatives of series, by <w f'> = -<w' f>, for torque with a lag."""
        padded = np.pad(self.kernel, 2)
        return self._make_averages(0.5 * self.recording.rate * (padded[:-2] - padded[2:]))

    def _make_averages(self, kernel: Array) -> WindowAverages:
        """Return the averages with another kernel (2 m + 1,)."""
        motion = self.samples, self.moving, self.acceleration
        return WindowAverages.from_kernel(*motion, kernel, self.centers, self.row_scale)

    @property
    def row_scale(self) -> Array:
        """Factor on each equation (R,)."""
        return np.ones(len(self.centers)) if self.scale is None else self.scale[self.centers]

    @property
    def half_width(self) -> float:
        """Half width of a window [s]."""
        return len(self.kernel) // 2 / self.recording.rate

    def with_noise_of(self, other: Windows) -> Windows:
        """Return the windows with the noise of others, of the same sensors."""
        return replace(self, noise=replace(other.noise, excess=self.noise.excess))

    def center_at_every_sample(self) -> Windows:
        """Return windows about every sample that is clear of stick."""
        return replace(self, centers=np.flatnonzero(self.stick.is_clear), scale=None)

    def with_torque(self, torque: Array, averages: Array) -> Windows:
        """Return the windows with another torque (N,) [N m]; `averages` (N,) are its `average_held_torque`."""
        samples = replace(self.samples, torque=averages)
        return replace(self, recording=replace(self.recording, torque=torque), samples=samples)

    @cached_property
    def unsmoothed(self) -> Samples:
        """Samples with the recorded position and its central differences (N,)."""
        q = self.recording.position
        return replace(self.samples, position=q, velocity=np.gradient(q, 1.0 / self.recording.rate))

    def select_center_samples(self) -> Samples:
        """Return the samples at the middle of each window, without states, (R,) each."""
        x, c = self.samples, self.centers
        load, temperature = x.load.select(c), np.broadcast_to(x.temperature, x.time.shape)[c]
        return Samples(x.time[c], x.position[c], x.velocity[c], x.torque[c], load=load, temperature=temperature)


def mark_contacts(w: Windows) -> Mask:
    """Mark the equations of added windows, which are in contact with a stop (R,)."""
    return np.isin(w.centers, w.stick.centers)


def average_held_torque(torque: Array) -> Array:
    """Return the average (N,) of a held torque under the triangle about each sample: (u[k-1] + u[k]) / 2.

    The first value stays.
    """
    averages = torque.copy()
    averages[1:] = 0.5 * (torque[1:] + torque[:-1])
    return averages


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
    m, settings = max(2, round(half_width * recording.rate)), RESOLUTION.cut
    has_reversals = recording.known_inertia > 0 and half_width > HALF_WIDTHS[-1]
    window, load = make_bump(m), get_known_load(recording)
    longest = max(2, round((settings.swing_smoothing if has_reversals else settings.smoothing) * m))
    motion = differentiate_position(recording, window, longest)
    v = motion.velocity
    speed = np.sqrt(np.convolve(v**2, window, "same")) if has_reversals else np.abs(v)
    moving = speed > max(find_slowest(v), settings.moving * motion.velocity_noise)
    guard = m + 1 + motion.half_width // settings.shift  # smoothing may shift a zero of the velocity
    mostly_moving = np.convolve(moving, window, "same") > settings.mostly
    near_stick = ~mostly_moving if has_reversals else find_near_reversals(v, moving, guard)
    is_excluded = np.zeros(len(v), dtype=bool)
    distance = math.ceil(margin * recording.rate)
    for segment in recording.segment_slices:
        begin, end = segment.start, segment.stop
        lead_in = max(distance, round(min(LEAD_IN * recording.rate, settings.lead_in * (end - begin))))
        is_excluded[begin : begin + guard + 1 + lead_in] = True
        is_excluded[max(begin, end - guard - 1 - distance) : end] = True
    if not recording.powered.all():
        is_excluded |= np.convolve(recording.powered == 0.0, np.ones(2 * guard + 1))[guard : guard + len(v)] > 0
    first, stop = (round(share * len(v)) for share in part)
    candidates, dense = (np.arange(first + m, stop - m, step) for step in (m, max(1, m // settings.dense)))
    candidates, dense = candidates[~is_excluded[candidates]], dense[~is_excluded[dense] & near_stick[dense]]
    touches_stick = near_stick[candidates]
    is_clear = ~(near_stick | is_excluded)
    is_clear[: first + m] = is_clear[stop - m :] = False
    noise = WindowNoise.measure(recording, load, window, motion)
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
        stick=Stick(dense[mostly_moving[dense]], candidates[touches_stick & ~mostly_moving[candidates]], is_clear),
        moving=moving,
        noise=noise,
        first=first,
        stop=stop,
        scale=scale_by_jumps(recording, window, noise.torque),
    )
