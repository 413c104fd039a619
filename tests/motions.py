"""Motions made up for tests of laws."""

import numpy as np

from pendulum_env.physics import Samples


def recorded(seed: int, seconds: float = 8.0, rate: float = 200.0, scale: float = 1.0, drift: float = 0.0) -> Samples:
    """A smooth random motion in time order, around an angle that drifts [rad/s]."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    w, phase, size = rng.uniform(0.5, 12, 5), rng.uniform(0, 6.3, 5), scale * rng.uniform(0.2, 1, 5)
    angle = np.outer(time, w) + phase
    torque = 3 * np.sin(time * w[0]) + np.cos(angle[:, 1])
    return Samples(time, np.sin(angle) @ size + drift * time, np.cos(angle) @ (size * w) + drift, torque)
