"""Errors of the parameters that runs allow, by their exact motion and the noise of their sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.retold.machines import Run, Sensors

Array = NDArray[np.float64]

WINDOWS = (0.05, 0.1, 0.2, 0.4)  # [s], over which encoder positions are differentiated twice
FEWEST = 10  # windows
LARGEST = 1.0  # relative standard error, above which a parameter is not determined


def bound_errors(runs: Sequence[Run]) -> dict[str, float]:
    """Return the relative standard error of each base parameter of a machine in some runs, with the best windows.

    Equations of motion hold in windows in which the joint slides. Their noise is that of the torque, and that of an
    acceleration from positions in the window.
    """
    plant, is_relative = runs[0].machine.plant, runs[0].motion == "free swing"  # relative to the inertia
    names = [n for n in ("inertia", "gravity", "viscous", "coulomb") if getattr(plant, n)]
    names = names[1:] if is_relative else names
    truth = {name: getattr(plant, name) for name in names}
    errors = [compute_errors(_list_rows(runs, names, window), truth) for window in WINDOWS]
    return {name: min(each[name] for each in errors) for name in errors[0]}


def _list_rows(runs: Sequence[Run], names: Sequence[str], window: float) -> Array:
    """Return the rows (W, P) of the equations over their noise, in windows of a length [s]."""
    plant, is_relative, rows = runs[0].machine.plant, runs[0].motion == "free swing", []
    for run in runs:
        recording, size = run.recording, count_samples(run.sensors, window)
        q, v, a = (cut(x, size) for x in (recording.exact_position, recording.velocity, recording.acceleration))
        is_clear = cut(recording.sliding, size).all(axis=1) & (np.ptp(np.sign(v), axis=1) == 0)
        columns = {"inertia": a, "gravity": np.sin(q), "viscous": v, "coulomb": np.sign(v)}
        of_torque = 0.0 if is_relative else run.sensors.noise * run.machine.torque / np.sqrt(size)
        noise = np.hypot(of_torque, plant.inertia * compute_acceleration_noise(run.sensors, window))
        rows.append(np.column_stack([columns[name].mean(axis=1)[is_clear] for name in names]) / noise)
    return np.concatenate(rows)


def count_samples(sensors: Sensors, window: float = WINDOWS[0]) -> int:
    """Return the number of samples in a window [s]."""
    return max(4, round(window * sensors.rate))


def cut(values: Array | NDArray[np.bool_], size: int) -> Array:
    """Return values in windows (W, size)."""
    count = len(values) // size
    return values[: count * size].reshape(count, size)


def compute_acceleration_noise(sensors: Sensors, window: float = WINDOWS[0]) -> float:
    """Return the error of an acceleration from n positions of variance s^2 in a time T: 720 s^2 / (n T^4), its root."""
    size, encoder = count_samples(sensors, window), 2 * np.pi / (sensors.counts or 1e9) / np.sqrt(12)
    return float(encoder * np.sqrt(720 / size) * (sensors.rate / size) ** 2)


def compute_errors(rows: Array, truth: Mapping[str, float]) -> dict[str, float]:
    """Return the relative standard errors of a least-squares fit to rows (W, P) over their noise.

    An error is infinite if the rows are few or do not determine the parameter. Parameters of zero are left out.
    """
    values = np.array([*truth.values()])
    if len(rows) < FEWEST:
        return {name: np.inf for name, value in truth.items() if value}
    norms = np.maximum(np.linalg.norm(rows, axis=0), 1e-100)
    _, singular, right = np.linalg.svd(rows / norms, full_matrices=False)
    errors = np.sqrt(np.sum((right.T / np.maximum(singular, 1e-12)) ** 2, axis=1)) / norms
    errors[errors > LARGEST * np.abs(values)] = np.inf
    return {name: float(own / abs(truth[name])) for name, own in zip(truth, errors, strict=True) if truth[name]}
