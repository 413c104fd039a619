"""A coarse encoder: its resolution is learnt from the motion, and rest changes no estimate."""

from functools import cache

import gymnasium as gym
import numpy as np
import pytest

from estimators.online import OnlineEstimator
from estimators.online.estimator import SampleBuffer
from estimators.signals.measurements import Smoothing
from estimators.wrappers import EstimateParameters
from pendulum_env.plant import PAPER
from pendulum_env.registration import PENDULUM
from tests import slow
from tests.feeding import play_two_tones
from tests.runge_kutta import simulate_stick_slip

TRUTH = np.array([0.05, 1.5, 0.12, 0.35])
RATE, COUNTS = 200.0, 16_384


def moved(torque: np.ndarray, rate: float = RATE) -> np.ndarray:
    """Return positions of the plant under a torque."""
    inertia, gravity, viscous, coulomb = TRUTH
    position, *_ = simulate_stick_slip(
        lambda t, q, v, u: u - gravity * np.sin(q) - viscous * v, lambda *_: coulomb, inertia, torque, 1 / rate
    )
    return position[:-1]


@cache
def recorded(seconds: float, rest: float, counts: int = COUNTS, seed: int = 0, size: float = 1.0) -> np.ndarray:
    """Time, position and torque over the period before (3, N): motion under three sines, then rest with noise."""
    rng, time = np.random.default_rng(seed), np.arange(round((seconds + rest) * RATE)) / RATE
    tones = ((2.2, 0.31, 0.0), (1.3, 0.83, 1.0), (0.7, 1.9, 2.0))
    torque = sum(each * np.sin(2 * np.pi * frequency * time + phase) for each, frequency, phase in tones)
    torque = np.where(time < seconds, size * torque, 0.0)
    count = 2 * np.pi / counts
    measured = count * np.rint(moved(torque) / count + 0.2 * rng.standard_normal(len(time)))
    torque = torque + 0.02 * rng.standard_normal(len(time)) * (time >= seconds)
    return np.array([time, measured, np.append(0.0, torque[:-1])])


def fed(estimator: OnlineEstimator, samples: np.ndarray):
    return [estimator.take(*(np.full(1, value) for value in sample)) for sample in samples.T]


def standard_errors(now) -> np.ndarray:
    return now.std[0]


@pytest.mark.parametrize("options", [{"forgetting": 0.999}, {}], ids=str)
def test_rest_changes_no_estimate(options):
    """There is no information in it, so nothing is counted, and nothing forgotten: all schemes hold the truth."""
    estimates = fed(OnlineEstimator(RATE, **options), recorded(6.0, 20.0))
    stopped, rested = estimates[round(7.5 * RATE)], estimates[-1]
    np.testing.assert_allclose(rested.theta, stopped.theta, rtol=1e-12)
    np.testing.assert_allclose(rested.covariance, stopped.covariance, rtol=0.2)  # of the last, unfinished cluster
    assert (np.abs(rested.theta[0] - TRUTH) < 4 * standard_errors(rested)).all()
    np.testing.assert_allclose(rested.theta[0, :, 0], TRUTH[0], rtol=0.01)


@pytest.mark.parametrize(("bits", "forgetting"), slow.but_first([(10, 1.0), (11, 1.0), (10, 0.9995)]))
def test_noise_of_a_coarse_encoder_biases_no_estimate(bits, forgetting):
    """Each of 72 values is within 3 standard errors; with noise in the regressor, the inertia is 0.5 to 2 % small."""
    runs = [recorded(10.0, 0.0, 2**bits, seed, size=0.6) for seed in range(3)]
    estimates = [fed(OnlineEstimator(RATE, forgetting=forgetting), run)[-1] for run in runs]
    for now in estimates:
        assert (np.abs(now.theta[0] - TRUTH) < 3 * standard_errors(now)).all()
    inertia = np.mean([now.theta[0, :, 0] for now in estimates], axis=0)
    np.testing.assert_allclose(inertia, TRUTH[0], rtol=0.003)


def test_smoothing_in_fast_rotation_biases_no_estimate():
    """A window of 0.2 s contains most of a turn; the sine of the smoothed angle is not the smoothed sine."""
    time = np.arange(2400) / RATE
    torque = 2.4 + 1.2 * np.sin(2 * np.pi * 0.31 * time) + 0.7 * np.sin(2 * np.pi * 1.9 * time)
    position = moved(torque)
    assert np.abs(np.diff(position)).max() * RATE > 20.0  # [rad/s]
    now = fed(
        OnlineEstimator(RATE, smoothing=Smoothing(20), position_noise=0.0),
        np.array([time, position, np.append(0.0, torque[:-1])]),
    )[-1]
    np.testing.assert_allclose(now.theta[0], np.tile(TRUTH, (6, 1)), rtol=2e-4)


def test_estimates_with_a_learnt_encoder_are_those_with_a_known_one():
    samples = recorded(6.0, 20.0)[:, :1200]
    estimators = [OnlineEstimator(RATE, **options) for options in ({}, {"counts": COUNTS})]
    learnt, known = (fed(estimator, samples) for estimator in estimators)
    for now, own in zip((learnt, known), estimators, strict=True):
        assert now[-1].time + own.delay / RATE == pytest.approx(samples[0, -1])
    assert learnt[-1].index > 1100, "samples before the encoder is known count, too"
    assert (np.abs(learnt[-1].theta - known[-1].theta)[0] < standard_errors(known[-1])).all()
    assert not any(now.usable.any() for now in learnt[:256])


@pytest.mark.parametrize(("counts", "noise"), [(4096, 0.3), (16_384, 0.0), (1_024_000, 1.0), (0, 1e-4), (0, 0.0)])
def test_the_noise_of_an_encoder_is_learnt_after_rest(counts, noise):
    """A rounded, a noisy or an exact position."""
    rng, time = np.random.default_rng(1), np.arange(2000) / RATE
    position = np.where(time < 0.5, 0.0, 1.2 * np.sin(4.0 * (time - 0.5)) + 0.3 * np.sin(9.0 * (time - 0.5)))
    step = 2 * np.pi / counts if counts else 1.0
    measured = position + noise * step * rng.standard_normal(len(time))
    measured = step * np.rint(measured / step) if counts else measured
    true = step * np.hypot(noise, 1 / np.sqrt(12) if counts else 0.0)
    buffer, none = SampleBuffer(), np.zeros(1)
    learnt = next(value for one in measured[:, None] if (value := buffer.take(none, one, none)) is not None)
    assert 0.6 * true < learnt < 1.7 * true + 5e-6


def test_an_environment_that_tells_no_encoder_lets_it_be_learnt():
    def last(**options):
        env = gym.make(PENDULUM, rate=RATE, counts=COUNTS, torque_noise=0.0)
        env.unwrapped.counts = None  # as of an environment that does not tell
        env = EstimateParameters(env, schemes=["dynamic"], **options)
        env.reset(seed=0)
        return np.array([*play_two_tones(env, 1200)[-1]["estimates"]["dynamic"]["theta"].values()])

    unknown, known, fine = last(), last(counts=COUNTS), last(counts=1_024_000)
    truth = np.array(list(PAPER.values()))
    assert np.abs(unknown / known - 1).max() < 0.01
    assert np.abs(fine / truth - 1).max() > 2 * np.abs(unknown / truth - 1).max()
