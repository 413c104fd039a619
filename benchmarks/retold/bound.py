"""Smallest errors of the parameters of a run, by its exact motion and the noise of its sensors."""

from __future__ import annotations

import numpy as np

from benchmarks.retold.machines import Run

WINDOW = 0.05  # [s], over which encoder positions are differentiated twice
FEWEST = 10  # windows


def bound_errors(run: Run) -> dict[str, float]:
    """Return the least relative standard error of each base parameter.

    Equations of motion hold in windows in which the joint slides. Their noise is that of the torque, and that of an
    acceleration from positions in the window: 720 s^2 / (n T^4) for n positions of variance s^2 in a time T.
    """
    recording, plant, sensors = run.recording, run.recording.plant, run.sensors
    size = max(4, round(WINDOW * sensors.rate))
    count = len(recording.time) // size
    q, v, a = (
        x[: count * size].reshape(count, size)
        for x in (recording.exact_position, recording.velocity, recording.acceleration)
    )
    is_clear = recording.sliding[: count * size].reshape(count, size).all(axis=1) & (np.ptp(np.sign(v), axis=1) == 0)
    columns = {"inertia": a, "gravity": np.sin(q), "viscous": v, "coulomb": np.sign(v)}
    is_relative = run.motion == "free swing"  # to the inertia
    names = [name for name in columns if getattr(plant, name) and not (is_relative and name == "inertia")]
    if is_clear.sum() < FEWEST:
        return dict.fromkeys(names, np.inf)
    phi = np.column_stack([columns[name].mean(axis=1)[is_clear] for name in names])
    encoder = 2 * np.pi / (sensors.counts or 1e9) / np.sqrt(12)
    of_motion = plant.inertia * encoder * np.sqrt(720 / size) * (sensors.rate / size) ** 2
    of_torque = 0.0 if is_relative else sensors.noise * run.machine.torque / np.sqrt(size)
    noise = np.hypot(of_torque, of_motion)
    norms = np.linalg.norm(phi, axis=0) + 1e-300
    _, singular, right = np.linalg.svd(phi / norms, full_matrices=False)
    spread = np.sqrt(np.sum((right.T / np.maximum(singular, 1e-12)) ** 2, axis=1)) / norms
    return {name: float(noise * s / getattr(plant, name)) for name, s in zip(names, spread, strict=True)}
