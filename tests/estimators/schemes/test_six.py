"""Laws that the six schemes obey, and what goes wrong without the care they take."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from estimators.schemes import six
from estimators.schemes.six import (
    LowPass,
    Scheme,
    apply_low_pass,
    compute_energy_view,
    compute_impulse_view,
    compute_torque_view,
)
from estimators.signals.measurements import Smoothing, add_states, measure
from pendulum_env.physics import BASE, effects
from pendulum_env.recording import Recording
from tests.cases import TRUTH

TERMS = [*BASE, *(effect() for effect in effects().values())]


def fit(scheme: Scheme, recording: Recording, smoothing: Smoothing | None = None) -> np.ndarray:
    equations, usable = scheme.regression(measure(recording, smoothing), BASE)
    return np.linalg.lstsq(equations.phi[usable], equations.y[usable], rcond=None)[0]


def means(values: np.ndarray) -> np.ndarray:
    """Mean over the sample before each one, by Simpson's rule on every other sample of a fine grid."""
    return (values[:-2:2] + 4 * values[1:-1:2] + values[2::2]) / 6


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.id)
def test_power_is_torque_times_velocity_and_impulse_its_integral(term):
    """Each view of each column of each effect, on a motion known in closed form on a fine grid."""
    fine = np.arange(801) * 0.00025 + 1.03  # moves forwards, away from kinks of the default shapes
    coarse = slice(0, None, 2)
    q, v, a = 1.5 * np.sin(2 * fine - 2), 3 * np.cos(2 * fine - 2), -6 * np.sin(2 * fine - 2)
    tau = 2 + np.sin(9 * fine)
    period = 0.0005
    m = measure(Recording(np.arange(500) * period, np.zeros(500), np.ones(500), name="made"), Smoothing(0))

    def made(part: slice, step: float) -> dataclasses.dataclass:
        held = np.convolve(tau[part], [0.5, 0.5])[: len(tau[part])]
        plain = dataclasses.replace(
            m, time=fine[part], position=q[part], velocity=v[part], acceleration=a[part], torque=tau[part], held=held
        )
        return add_states(dataclasses.replace(plain, period=step), [term])

    exact, sampled = made(slice(None), 0.5 * period), made(coarse, period)
    if term.id in exact.memory:  # states are those of the samples
        states = tuple(np.interp(fine, fine[coarse], s) for s in sampled.memory[term.id])
        exact = dataclasses.replace(exact, memory={term.id: states})
    for column in (*term.columns, *term.fixed):
        torque = compute_torque_view(exact, column)
        size = np.abs(torque).max() + 1e-9
        inner = slice(20, -4)  # a delay of 5 ms does not know what was before
        np.testing.assert_allclose(
            compute_impulse_view(sampled, column)[1:][inner], means(torque)[inner], atol=2e-3 * size
        )
        np.testing.assert_allclose(
            compute_energy_view(sampled, column)[1:][inner], means(torque * v)[inner], atol=6e-3 * size
        )


def test_filter_is_the_bilinear_one_of_the_paper():
    """lambda (1 - F) of a running sum, F discretised by the bilinear rule, is the average of its increments."""
    rng, cutoff, period = np.random.default_rng(0), 200.0, 0.001
    rate = rng.normal(size=500)
    total = np.cumsum(rate) * period
    b, a = bilinear([cutoff], [1.0, cutoff], fs=1 / period)
    # the sum is 0 up to its start
    filtered = lfilter(b, a, np.r_[0.0, total])[1:]
    once = apply_low_pass(rate, cutoff, period)
    np.testing.assert_allclose(once, cutoff * (total - filtered), atol=1e-9)
    twice = apply_low_pass(rate, cutoff, period, order=2)
    np.testing.assert_allclose(twice, apply_low_pass(once, cutoff, period))


def test_cutoff_beyond_nyquist_is_refused(exact):
    with pytest.raises(ValueError, match=r"filter at 2000 rad/s needs samples at more than 636\.6 Hz"):
        six.scheme("filtered_dynamic", operator=LowPass(cutoff=2000.0)).regression(measure(exact), BASE)


def test_stick_leaves_no_trace(sticky):
    """The gate stands before F: a slow filter remembers stick beyond any guard, and a mask behind it comes too late."""
    slow = six.scheme("filtered_dynamic", operator=LowPass(cutoff=20.0))
    for one in (slow, six.scheme("dynamic"), six.scheme("energy")):  # energy needs no mask
        assert np.abs(fit(one, sticky) / TRUTH - 1).max() < 0.01
    m = measure(sticky)
    equations, _ = six.scheme("filtered_dynamic", operator=LowPass(cutoff=20.0), guard=None).regression(m, BASE)
    late = m.find_clear(0.02)
    behind = np.linalg.lstsq(equations.phi[late], equations.y[late], rcond=None)[0]
    assert np.abs(behind / TRUTH - 1).max() > 0.03


def test_second_order_filter_keeps_encoder_noise_out_of_the_inertia(paper_run):
    """Without smoothing; the paper's first-order filter leaves a bias."""
    count = 2 * np.pi / 65_536
    coarse = dataclasses.replace(paper_run, position=np.round(paper_run.position / count) * count)
    raw = Smoothing(0, slowest=0.12)  # five times the noise of such a velocity
    schemes = (six.scheme("filtered_dynamic", operator=LowPass(order=order)) for order in (1, 2))
    bias = [fit(scheme, coarse, raw)[0] / TRUTH[0] - 1 for scheme in schemes]
    smoothed = fit(six.scheme("filtered_dynamic"), coarse)[0] / TRUTH[0] - 1
    assert bias[0] < -0.005
    assert abs(bias[1]) < 0.2 * abs(bias[0])
    assert abs(smoothed) < 0.002


def test_a_mass_that_jumps_does_no_work():
    payload = effects()["payload_change"](moment=0.5)
    time = np.arange(2000) / 1000
    m = measure(Recording(time, np.sin(5 * time), np.cos(time), name="wave"), Smoothing(0))
    inertia = payload.columns[0]
    energy = np.cumsum(compute_energy_view(m, inertia)) * m.period
    momentum = np.cumsum(compute_impulse_view(m, inertia)) * m.period
    at = int(np.searchsorted(m.time, 0.5))
    assert np.abs(energy[: at - 1]).max() == np.abs(momentum[: at - 1]).max() == 0
    after = m.velocity[at + 2 :]
    np.testing.assert_allclose(energy[at + 2 :], 0.5 * (after**2 - m.velocity[at] ** 2), atol=0.03)
    np.testing.assert_allclose(momentum[at + 2 :], after - m.velocity[at], atol=0.03)
