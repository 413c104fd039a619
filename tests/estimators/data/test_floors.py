"""Noise floor of data that hardly determine the inertia by which encoder noise enters the torque."""

import numpy as np
import pytest
import scipy.integrate

from estimators.data.fit_data import FitData
from pendulum_env.physics import BASE
from pendulum_env.physics.limits import limit_term
from pendulum_env.recording import Recording

INERTIA, GRAVITY, VISCOUS, COULOMB = 0.003, 0.18, 0.015, 0.02


def creep(seed: int) -> Recording:
    """A pendulum that a constant torque lifts to rest at 1.1 rad, read by an encoder of 16384 counts."""
    time, rng = np.arange(10_000) / 1000, np.random.default_rng(seed)
    torque = GRAVITY * np.sin(1.1) + COULOMB

    def slope(_: float, state: np.ndarray) -> list[float]:
        friction = VISCOUS * state[1] + COULOMB * np.tanh(state[1] / 1e-4)
        return [state[1], (torque - GRAVITY * np.sin(state[0]) - friction) / INERTIA]

    position = scipy.integrate.solve_ivp(slope, (0, 10), [0, 0], "Radau", time, rtol=1e-9, atol=1e-12).y[0]
    step = 2 * np.pi / 16_384
    return Recording(time, step * np.round(position / step), torque + 0.001 * rng.standard_normal(10_000))


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_the_encoder_is_scaled_by_the_inertia_beside_known_values(seed: int) -> None:
    base = tuple(limit_term(term, {"gravity": (GRAVITY, GRAVITY)}) for term in BASE)
    for part in FitData.from_recordings([creep(seed)], (), base).parts:
        rms = float(np.sqrt(np.mean(part.residual(base) ** 2)))
        assert rms / 1.3 < part.floors[""] < 3 * rms
