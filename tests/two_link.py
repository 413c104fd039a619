"""Recordings of the two-link arm that SciPy integrates by its textbook equations."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.two_link import Multisine, TwoLink
from robots.arms.body import Body, read_body
from robots.arms.recording import ArmRecording
from tests.once import once

JOINTS = ("shoulder", "elbow")


@functools.cache
def body() -> Body:
    """The arm, read from its own file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "two.urdf"
        path.write_text(TwoLink().urdf())
        return read_body(path)


@once("benchmarks")
def record_arm(
    plant: TwoLink = TwoLink(),  # noqa: B008  (frozen)
    seed: int = 0,
    *,
    seconds: float = 10.0,
    rate: float = 1000.0,
    scale: tuple[float, float] = (3.5, 2.2),
    noise: float = 0.02,
    counts: int = 0,
    offset: object = 0.0,
) -> ArmRecording:
    """A run under the paper's frequencies, with noise and an offset (N, 2) or less on the torque [N m]."""
    time, signal = np.arange(0, seconds, 1 / rate), Multisine.paper(seed, scale)
    position, _ = plant.simulate(signal, time)
    if counts:
        step = 2 * np.pi / counts
        position = np.round(position / step) * step
    torque = signal.held(time, 1 / rate) + noise * np.random.default_rng(seed).normal(size=position.shape)
    return ArmRecording.from_arrays(f"run {seed}", JOINTS, time, position, torque + np.array(offset))
