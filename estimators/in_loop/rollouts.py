"""Rollouts of servos: simulations of whole recordings from the goal alone, compared with the measured motion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy

from estimators.decisions.criterion import ResidualStructure
from estimators.in_loop.counts import (
    FINEST,
    compute_creep_torque,
    find_encoder_step,
    find_least_change,
    make_quantisation_noise,
)
from estimators.in_loop.servo_inputs import make_servos
from estimators.signals.differentiation import estimate_encoder_noise
from estimators.weak_form.point import Point
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics import has_link
from pendulum_env.recording import Recording
from pendulum_env.servo.drive import LONGEST_DELAY
from pendulum_env.servo.loop import Servos, simulate_servos

GRAIN = 0.02  # [s] between compared positions, about
STEPS, FINE = 11, 20  # of the integrator in this time, during a search and for the final fit
SAME_RATE = 0.01  # relative difference of the rates of logs that are compared at their samples
SLACK = 0.01  # share of a step of the integrator that may be missing, by rounding
CONTACT = 2  # factor of the number of steps with a link: its contact is stiffer than the joint
JITTER = 0.03  # error of a clock in samples
SMOOTH = 1e-12  # [rad], step of an encoder without visible counts: one compiled step simulates it and counts


@dataclass(frozen=True)
class Rollouts:
    """Recordings with a goal and a drive, each segment of them a rollout.

    Attributes:
        recordings: of servos.
        steps: of the integrator in the time `GRAIN`.
        shares: begin and end of the compared part of each recording; the whole recording is simulated.
        grain: time between compared positions [s]; None takes samples of the log, about `GRAIN` apart. Held goals bend
            the motion, so positions between samples are not known.
        has_counts: whether positions are compared in counts of the encoder, if the log shows them; None: if the
            controllers read counts.
    """

    recordings: tuple[Recording, ...]
    steps: int = STEPS
    shares: Part = WHOLE
    grain: float | None = None
    has_counts: bool | None = None

    @cached_property
    def _grain(self) -> float:
        """Return the time between compared positions [s]: `GRAIN` if the rates of the logs differ."""
        if self.grain is not None:
            return self.grain
        periods = [1.0 / recording.rate for recording in self.recordings]
        period = float(np.median(periods))
        is_same = max(periods) <= (1.0 + SAME_RATE) * min(periods)
        return period * max(1, round(GRAIN / period)) if is_same else GRAIN

    @cached_property
    def _steps_per_grain(self) -> int:
        return max(1, int(np.ceil(self.steps * self._grain / GRAIN - SLACK)))

    @cached_property
    def _segments(self) -> list[tuple[int, Recording]]:
        return [(k, part) for k, recording in enumerate(self.recordings) for part in recording.segments]

    @cached_property
    def servos(self) -> Servos:
        """Return all rollouts in a batch; shorter ones are padded with their last sample."""
        step, count = self._grain / self._steps_per_grain, self._steps_per_grain * max(len(at) for at in self._times)
        encoder_step = (self.encoder_step or SMOOTH) if self._reads_counts else None
        return make_servos([part for _, part in self._segments], step, count, encoder_step)

    @property
    def _reads_counts(self) -> bool:
        drives = [recording.actuator for recording in self.recordings]
        return all(drive.acts_on_position and drive.reads == "counts" for drive in drives)

    @cached_property
    def encoder_step(self) -> float | None:
        """Return the step of the encoder in which positions are compared [rad]; None if they are compared exactly."""
        has_counts = self._reads_counts if self.has_counts is None else self.has_counts
        return find_encoder_step(self.recordings) if has_counts else None

    @cached_property
    def without_counts(self) -> Self:
        """Return the rollouts without counts, in controllers and comparison: their errors change smoothly."""
        return self if self.encoder_step is None else replace(self, has_counts=False)

    @cached_property
    def noise_of_counts(self) -> Array:
        """Return the noise of the encoder in each row (R,) [rad], which the comparison of counts lacks."""
        return make_quantisation_noise(self.encoder_step or 0.0, len(self.position))

    @cached_property
    def _times(self) -> list[Array]:
        """Return the times of compared positions, from the start of each rollout [s]."""
        grain = self._grain
        lengths = [(part.time[-1] - part.time[0]) / grain for _, part in self._segments]
        return [grain * np.arange(1.0, int(length + 1e-6) + 1) for length in lengths]

    @cached_property
    def _compared(self) -> list[Mask]:
        """Return masks of the times of each rollout within the compared share of its recording."""
        masks = []
        for times, (k, part) in zip(self._times, self._segments, strict=True):
            whole = self.recordings[k]
            share = (part.time[0] - whole.time[0] + times) / (whole.time[-1] - whole.time[0] + self._grain)
            masks.append((share >= self.shares[0]) & (share < self.shares[1]))
        return masks

    @cached_property
    def position(self) -> Array:
        """Measured positions to compare with (R,) [rad], by a cubic spline; linear interpolation is too inaccurate."""
        parts = zip(self._times, self._compared, self._segments, strict=True)
        return np.concatenate(
            [
                scipy.interpolate.CubicSpline(part.time, part.position)(part.time[0] + times[mask])
                for times, mask, (_, part) in parts
            ]
        )

    @cached_property
    def recording_of(self) -> Index:
        """Return the index of the recording of each compared position (R,)."""
        return np.repeat([k for k, _ in self._segments], [int(mask.sum()) for mask in self._compared])

    @cached_property
    def resolution(self) -> float:
        """Return the standard deviation of the quantisation by the finest encoder [rad]."""
        least = find_least_change(self.recordings)
        return least / np.sqrt(12.0) if np.isfinite(least) else FINEST

    @property
    def creep_torque(self) -> float:
        """Return the torque of `compute_creep_torque`; 0 if simulated controllers read counts."""
        reads_counts = self._reads_counts and self.encoder_step is not None
        return 0.0 if reads_counts else compute_creep_torque(self.recordings, self.resolution)

    @property
    def encoder(self) -> dict[str, float]:
        """Return the mean absolute error due to the encoder alone, by the name of the joint [rad]."""
        noise = np.mean([estimate_encoder_noise(recording.position) for recording in self.recordings])
        return {"": float(np.sqrt(2 / np.pi) * noise)}

    @cached_property
    def mistimed(self) -> tuple[Self, Self]:
        """Return the rollouts with delayed goals, and those with delayed controllers.

        The delay is `JITTER` samples. A controller at the longest delay is advanced instead.
        """

        def delay_recording(recording: Recording, goal: float, drive: float) -> Recording:
            assert recording.reference is not None and recording.drive is not None  # every rollout has both
            reference = np.interp(recording.time - goal, recording.time, recording.reference)
            delay = recording.drive.delay
            delayed = replace(recording.drive, delay=delay + drive if delay + drive <= LONGEST_DELAY else delay - drive)
            return replace(recording, reference=reference, drive=delayed)

        jitter = [JITTER / recording.rate for recording in self.recordings]
        goals = tuple(delay_recording(r, seconds, 0.0) for r, seconds in zip(self.recordings, jitter, strict=True))
        drives = tuple(delay_recording(r, 0.0, seconds) for r, seconds in zip(self.recordings, jitter, strict=True))
        return replace(self, recordings=goals), replace(self, recordings=drives)

    def compute_position_errors(self, points: Sequence[Point]) -> Array:
        """Return simulated minus measured positions (R, V) of V models with terms of equal classes [rad].

        Both are counts of the encoder, if controllers read them.
        """
        paths = self.simulate_paths(points)
        if self.encoder_step is not None:
            origin = self.servos.position
            paths = origin + self.encoder_step * np.rint((paths - origin) / self.encoder_step)
        return self.compare_paths(paths)

    def simulate_paths(self, points: Sequence[Point]) -> Array:
        """Return the positions (N + 1, V, B) of V models with terms of equal classes, a grain apart [rad]."""
        terms = []
        for variants in zip(*(point.terms for point in points), strict=True):
            nonlinear = {
                name: np.array([v.nonlinear_values[name] for v in variants]) for name in variants[0].nonlinear_values
            }
            merged = {
                name: values[0] if np.all(values == values[0]) else values[:, None]
                for name, values in nonlinear.items()
            }
            terms.append(type(variants[0])(**merged))
        rollouts = self._in_contact if has_link(points[0].terms) else self
        theta = np.column_stack([point.theta for point in points])
        return simulate_servos(terms, theta, rollouts.servos, rollouts._steps_per_grain)

    @cached_property
    def _in_contact(self) -> Self:
        """Return the rollouts with the shorter steps of the integrator for a contact."""
        return replace(self, steps=CONTACT * self.steps)

    def compare_paths(self, paths: Array) -> Array:
        """Return simulated positions (N + 1, V, B), a grain apart from the start, minus measured ones (R, V) [rad].

        Errors are clipped to 2 rad; a simulation that diverged has this error.
        """
        simulated = np.concatenate(
            [paths[1 : len(mask) + 1, :, lane][mask] for lane, mask in enumerate(self._compared)]
        )
        farthest = 2.0  # [rad], largest error
        return np.clip(np.nan_to_num(simulated, nan=np.inf) - self.position[:, None], -farthest, farthest)

    @cached_property
    def time(self) -> Array:
        """Times of the compared positions, from the start of each recording (R,) [s]."""
        parts = zip(self._times, self._compared, self._segments, strict=True)
        return np.concatenate(
            [part.time[0] + times[mask] - self.recordings[k].time[0] for times, mask, (k, part) in parts]
        )

    @cached_property
    def clusters(self) -> Index:
        """Block of time of each row (R,), for standard errors."""
        return self.blocks(1.5)[0]  # [s], over which errors of a rollout are correlated

    def blocks(self, length: float) -> tuple[Index, Index, Index]:
        """Return the block of `length` seconds and the recording of each row (R,); the recording of each block (S,)."""
        pairs = np.column_stack([self.recording_of, (self.time / length).astype(np.intp)])
        blocks, block = np.unique(pairs, axis=0, return_inverse=True)
        return block.ravel(), self.recording_of, blocks[:, 0]

    def measure_structure(self, residual: Array) -> ResidualStructure:
        """Return the size of a residual (R,) [rad], the geometric mean of the RMS over recordings.

        Correlated neighbours do not indicate a missing effect: a servo that sticks at another position than its model
        is off for seconds. The geometric mean limits the weight of one recording.
        """
        squares = np.bincount(self.recording_of, residual**2) / np.bincount(self.recording_of)
        rms = float(np.exp(0.5 * np.mean(np.log(np.maximum(squares, 1e-300)))))
        return ResidualStructure(rms, 0.0, rms)

    @cached_property
    def precision(self) -> float:
        """Return the error of the simulation itself [rad]."""
        return 1e-4 * float(np.std(self.position))  # share of the motion

    @cached_property
    def noise(self) -> float:
        """Return the error due to encoder and clock alone, the geometric mean over recordings [rad]."""
        late = [JITTER * np.std(np.gradient(r.position, r.time)) / r.rate for r in self.recordings]
        return max(self.precision, float(np.exp(np.mean(np.log(np.hypot(self.resolution, late))))))
