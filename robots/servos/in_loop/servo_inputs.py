"""Inputs of simulated servos in each step of the integrator, from the rows of their logs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from estimators.signals.differentiation import estimate_encoder_noise
from estimators.signals.motion import get_known_load, get_temperature
from pendulum_env._typing import Array, Index
from pendulum_env.physics import SIGNIFICANT, KnownLoad
from pendulum_env.recording import Recording
from robots.servos.loop import ControllerSamples, Servos
from robots.servos.torque import find_drive, follow_goals, get_bus_voltage


def make_servos(parts: Sequence[Recording], step: float, ends: Index, encoder_step: float | None = None) -> Servos:
    """Make the inputs of servos from recordings without gaps; shorter ones are padded with their last sample.

    Args:
        parts: recordings with a goal and a drive.
        step: of the integrator [s].
        ends: number of steps of each recording (B,).
        encoder_step: step of the encoder that controllers read [rad]; None: they read the exact position.
    """
    count = int(ends.max())
    begins = np.arange(count, dtype=np.float64) * step + 1e-6  # of the steps [s], against rounding

    def stack(read: Callable[[Array, Recording], Array], values: Iterable[Array | float | None]) -> Array:
        """Return series as `read` has them in each step (N, B)."""
        pairs = zip(values, parts, strict=True)
        return np.array([read(np.broadcast_to(np.asarray(series), len(part)), part) for series, part in pairs]).T

    def hold(series: Array, part: Recording) -> Array:
        """Return a series held from sample to sample, at the begin of each step (N,)."""
        return series[np.minimum((begins * part.rate).astype(np.intp), len(part) - 1)]

    def interpolate(series: Array, part: Recording) -> Array:
        """Return a series interpolated between samples, at the begin of each step (N,)."""
        return np.interp(begins, np.arange(len(part)) / part.rate, series)

    def average_held(series: Array, part: Recording) -> Array:
        """Return the mean over each step of a series held from sample to sample (N,); a step may span two."""
        edges = np.append(begins, begins[-1] + step)
        integral = np.append(0.0, np.cumsum(series)) / part.rate
        until = np.minimum(edges * part.rate, len(series))
        path = np.interp(until, np.arange(len(series) + 1), integral) + (edges - until / part.rate) * series[-1]
        return np.diff(path) / step

    def read_goal(series: Array, part: Recording) -> Array:
        """Return the goal that the controller uses in each step (N,), that of its last reading."""
        drive = find_drive(part)
        is_ramp, rate = drive.goal == "ramp", drive.rate
        if rate is None:
            return follow_goals(series, begins * part.rate) if is_ramp else average_held(series, part)
        looks = ControllerSamples(rate, step, count)
        samples = (looks.time + 1e-6) * part.rate
        goals = (
            follow_goals(series, samples) if is_ramp else series[np.minimum(samples.astype(np.intp), len(series) - 1)]
        )
        return looks.average(goals)[np.maximum.accumulate(np.where(looks.has_sample > 0, np.arange(count), 0))]

    loads = [get_known_load(part) for part in parts]
    known_load = KnownLoad(
        np.array([load.inertia for load in loads], dtype=float),
        np.array([load.gravity for load in loads], dtype=float),
        stack(interpolate, [load.torque for load in loads]),
    )
    return Servos(
        tuple(map(find_drive, parts)),
        step,
        stack(read_goal, [part.reference for part in parts]),
        stack(hold, [get_bus_voltage(part) for part in parts]),
        stack(hold, [part.powered for part in parts]),
        np.array([part.position[0] for part in parts]),
        np.array([_estimate_initial_velocity(part) for part in parts]),
        np.array([part.time[0] for part in parts]),
        known_load if any(loads) else KnownLoad(),
        stack(interpolate, [get_temperature(part) for part in parts]),
        encoder_step,
        ends,
    )


def _estimate_initial_velocity(recording: Recording) -> float:
    """Return the velocity at the first sample [rad/s]; zero if it is not significant, as most logs begin at rest."""
    beginning = 0.08  # [s], time to which a cubic is fitted at first
    shortest = 6  # least number of samples of the cubic
    length = min(len(recording), max(shortest, round(beginning * recording.rate)))
    noise = estimate_encoder_noise(recording)
    while True:
        powers = np.vander(recording.time[:length] - recording.time[0], min(4, length), increasing=True)
        cubic = np.linalg.lstsq(powers, recording.position[:length])[0]
        if length <= shortest or np.std(powers @ cubic - recording.position[:length]) < 1.2 * noise:
            std = noise * float(np.linalg.norm(np.linalg.pinv(powers)[1]))
            return float(cubic[1]) if abs(cubic[1]) > SIGNIFICANT * std else 0.0
        length = max(shortest, length // 2)  # a cubic describes a fast start only briefly
