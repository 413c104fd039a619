"""Motions made up for tests of laws."""

from collections.abc import Callable

import numpy as np

from pendulum_env.physics import Samples
from pendulum_env.recording import Recording


def recorded(seed: int, seconds: float = 8.0, rate: float = 200.0, scale: float = 1.0, drift: float = 0.0) -> Samples:
    """A smooth random motion in time order, around an angle that drifts [rad/s]."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    w, phase, size = rng.uniform(0.5, 12, 5), rng.uniform(0, 6.3, 5), scale * rng.uniform(0.2, 1, 5)
    angle = np.outer(time, w) + phase
    torque = 3 * np.sin(time * w[0]) + np.cos(angle[:, 1])
    return Samples(time, np.sin(angle) @ size + drift * time, np.cos(angle) @ (size * w) + drift, torque)


def record_motion(resistance: Callable[[np.ndarray, np.ndarray], np.ndarray], size: float = 1.0) -> Recording:
    """Torque that a motion of three tones takes of a body against a torque of its position and velocity.

    It is that in the middle of each step, as held torque is.
    """
    rng, time = np.random.default_rng(3), np.arange(0.0, 20.0, 0.001)
    rates, phases = 2 * np.pi * np.array([0.15, 0.35, 0.6]), np.array([0.3, 1.0, 2.0])
    waves, sizes = rates * time[:, None] + phases, size * np.array([0.6, 0.4, 0.25])
    q, v, a = (wave @ sizes for wave in (np.sin(waves), rates * np.cos(waves), -(rates**2) * np.sin(waves)))
    torque = 0.09 * a + 2.0 * np.sin(q) + 0.3 * np.sign(v) + resistance(q, v)
    return Recording(time[::2], q[::2], torque[1::2] + 0.01 * rng.standard_normal(len(q) // 2), name="moved")
