"""Coarse encoders at a low rate, from motion in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from estimators import identify
from estimators.identification import CoarseEncoder
from estimators.schemes.six import scheme
from estimators.signals.measurements import has_encoder_bias, measure_segments
from pendulum_env.physics import BASE
from pendulum_env.recording import Recording, TorqueConstant

THETA = {"inertia": 0.09, "gravity": 2.0, "viscous": 0.36, "coulomb": 0.9}
RATE, SUBSTEPS = 100.0, 25


def record(counts: int, seed: int, seconds: float = 30.0) -> Recording:
    """Return a slow multisine and its torque by the law of the pendulum, the mean over each period."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.arange(1, 8) / 7.3
    a, phase = rng.normal(size=7) / np.arange(1, 8) ** 0.5, rng.uniform(0, 2 * np.pi, 7)
    a *= 1.6 / np.abs(a).sum()
    t = (np.arange(round(seconds * RATE) * SUBSTEPS)[:, None] + 0.5) / (RATE * SUBSTEPS)
    q, v, acceleration = (np.sum(a * w**n * np.sin(w * t + phase + n * np.pi / 2), axis=1) for n in range(3))
    torque = THETA["inertia"] * acceleration + THETA["gravity"] * np.sin(q) + THETA["viscous"] * v
    torque = np.mean((torque + THETA["coulomb"] * np.sign(v)).reshape(-1, SUBSTEPS), axis=1)
    time, step = np.arange(len(torque)) / RATE, 2 * np.pi / counts
    position = np.round(np.sum(a * np.sin(w * time[:, None] + phase), axis=1) / step) * step
    return Recording(time, position, torque + 0.01 * rng.standard_normal(len(time)), name=f"{counts} counts")


@pytest.mark.parametrize(("counts", "seed"), [(4096, 1), (4096, 2), (1024, 1)])
def test_a_coarse_encoder_leaves_no_bias(counts, seed):
    recording = record(counts, seed)
    assert has_encoder_bias(recording)
    for result in identify(recording, schemes=["dynamic", "filtered_dynamic", "filtered_power"]).values():
        for name, value in THETA.items():
            estimate = result.model[name]
            assert abs(estimate.value - value) < 4 * estimate.std, (result.scheme, name)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("counts", [400, 200])
def test_standard_errors_cover_the_bias_that_a_very_coarse_encoder_leaves(counts, seed):
    found = identify(record(counts, seed), schemes=["dynamic", "filtered_dynamic", "filtered_power"])
    is_biased = any(result.model["inertia"].is_biased for result in found.values())
    assert is_biased == any(isinstance(one, CoarseEncoder) or one.is_biasing for one in found.findings)
    for result in found.values():
        inertia = result.model["inertia"]
        assert abs(inertia.value - THETA["inertia"]) < 3 * inertia.std, result.scheme
        if counts == 400:  # noise has about half of the information
            assert inertia.value == pytest.approx(THETA["inertia"], rel=0.25), result.scheme
        else:
            assert inertia.is_biased, result.scheme


def test_the_correction_obeys_bounds():
    for bounds in ((0.07, 0.080), (0.095, 0.12)):
        for result in identify(record(1024, 1), bounds={"inertia": bounds}).values():
            inertia = result.model["inertia"]
            assert inertia.at_bound, result.scheme
            assert inertia.value in bounds, result.scheme
    free = identify(record(1024, 1), schemes="dynamic", bounds={"inertia": (0.085, None)})["dynamic"].model["inertia"]
    assert not free.at_bound  # the uncorrected estimate is below this bound
    assert abs(free.value - THETA["inertia"]) < 4 * free.std


def test_the_error_of_the_torque_constant_contains_no_noise_bias():
    recording = record(1024, 1)
    current = replace(recording, torque_constant=TorqueConstant(2.0, 0.01, "A"))
    for id in ("dynamic", "filtered_power"):
        inertia = identify(recording, schemes=id)[id].model["inertia"]
        calibrated = identify(current, schemes=id)[id].model["inertia"]
        assert calibrated.value == pytest.approx(inertia.value, rel=1e-6)
        assert calibrated.std == pytest.approx(np.hypot(inertia.std, 0.005 * inertia.value), rel=0.05)


def test_the_residual_is_that_of_the_corrected_model():
    recording = record(1024, 1)
    result = identify(recording, schemes="dynamic")["dynamic"]
    (m,) = measure_segments(recording)
    equations, usable = scheme("dynamic").regression(m, BASE)
    residual = (equations.y - equations.phi @ result.model.theta)[usable]
    assert result.residual_rms == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-6)


def test_a_fine_encoder_needs_no_correction():
    assert not has_encoder_bias(record(2**20, 0))
