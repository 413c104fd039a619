import numpy as np
import pytest

from estimators.regression.least_squares import IdentificationError
from estimators.schemes.six import VIEWS, scheme
from estimators.signals.measurements import Smoothing, choose_smoothing, make_window, measure
from pendulum_env.physics import Gravity, Inertia, Viscous
from pendulum_env.recording import Recording

SWING = np.array([0.1, 2.0, 0.3])  # inertia, gravity, viscous


def integrate_swing(rate: int) -> Recording:
    """Integrate a swing without dry friction by Runge-Kutta, under a torque that is held over each sample."""
    inertia, gravity, viscous = SWING
    steps, n = 2000 // rate, 4 * rate
    torque = 3 * np.sin(7 * np.arange(n) / rate)

    def slope(state: np.ndarray, applied: float) -> np.ndarray:
        return np.array([state[1], (applied - gravity * np.sin(state[0]) - viscous * state[1]) / inertia])

    state, position, h = np.zeros(2), np.empty(n), 1 / 2000
    for k in range(n):
        position[k] = state[0]
        for _ in range(steps):
            one = slope(state, torque[k])
            two = slope(state + 0.5 * h * one, torque[k])
            three = slope(state + 0.5 * h * two, torque[k])
            state = state + h / 6 * (one + 2 * two + 2 * three + slope(state + h * three, torque[k]))
    return Recording(np.arange(n) / rate, position, torque)


@pytest.mark.parametrize("half_width", [0, 2, 5, 40])
def test_window_has_unit_sum_and_no_second_and_fourth_moment(half_width):
    weights, offsets = make_window(half_width), np.arange(-half_width, half_width + 1)
    assert weights.sum() == pytest.approx(1)
    assert weights @ offsets**2 == pytest.approx(0, abs=1e-9 * (1 + half_width) ** 2)
    assert weights @ offsets**4 == pytest.approx(0, abs=1e-9 * (1 + half_width) ** 4)
    np.testing.assert_allclose(weights, weights[::-1], atol=1e-12)


@pytest.mark.parametrize("half_width", [0, 2, 10])
def test_held_torque_matches_acceleration_and_steps_of_velocity_exactly(half_width):
    """Of a free inertia under random held commands, which moves in parabolas: no filter may break I q'' = tau."""
    rng, period, inertia = np.random.default_rng(0), 0.005, 0.1
    torque = rng.normal(size=1000)
    velocity = np.r_[0, np.cumsum(torque[:-1])] * period / inertia
    position = np.r_[0, np.cumsum(velocity[:-1] * period + 0.5 * torque[:-1] / inertia * period**2)]
    m = measure(Recording(np.arange(1000) * period, position, torque, name="free"), Smoothing(half_width))
    np.testing.assert_allclose(inertia * m.acceleration, m.torque, atol=1e-9)
    np.testing.assert_allclose(inertia * np.diff(m.velocity) / period, m.held[1:], atol=1e-9)


def test_smooth_motion_is_differentiated_without_delay():
    time = np.arange(2000) / 1000
    m = measure(Recording(time, np.sin(6 * time), np.sin(6 * time), name="sine"), Smoothing(10))
    np.testing.assert_allclose(m.position, np.sin(6 * m.time), atol=1e-6)
    np.testing.assert_allclose(m.velocity, 6 * np.cos(6 * m.time), atol=3e-5)
    np.testing.assert_allclose(m.acceleration, -36 * np.sin(6 * m.time), atol=1e-4)
    # held commands act half a sample late
    np.testing.assert_allclose(m.torque, np.sin(6 * (m.time - 0.0005)), atol=1e-5)


@pytest.mark.parametrize("view", VIEWS)
def test_balance_of_a_swing_under_held_torque_is_exact_to_fourth_order(view):
    """The error of the true parameters falls by 16 if the samples are twice as dense."""
    terms, errors = (Inertia(), Gravity(), Viscous()), []
    for rate in (100, 200):
        run = integrate_swing(rate)
        equations = scheme("dynamic", view=view).regression(measure(run, Smoothing(2)), terms).equations
        errors.append(np.sqrt(np.mean((equations.y - equations.phi @ SWING)[10:-10] ** 2)))
    assert errors[1] < errors[0] / 10


def test_coarse_encoders_are_smoothed_longer():
    time = np.arange(5000) / 1000
    motion = 2 * np.sin(5 * time)

    def chosen(counts: int) -> int:
        count = 2 * np.pi / counts
        return choose_smoothing(Recording(time, np.round(motion / count) * count, motion, name="sine")).half_width

    assert chosen(1_024_000) < chosen(65_536) < chosen(8192)


def test_guard_leaves_out_stick_and_reversals(exact):
    m = measure(exact)
    clear = m.find_clear(0.02)
    assert m.find_clear(None).all()
    assert 0.5 < clear.mean() < 0.95
    halted = np.flatnonzero(~m.moving | np.r_[False, np.diff(np.sign(m.velocity)) != 0])
    distance = np.abs(np.flatnonzero(clear)[:, None] - halted).min(axis=1) * m.period
    assert distance.min() > 0.02
    assert clear.mean() > m.find_clear(0.05).mean()


def test_too_short_a_recording_is_refused():
    time = np.arange(20) / 1000
    with pytest.raises(IdentificationError, match="20 samples are too few"):
        measure(Recording(time, time**2, time, name="short"))
    time = np.arange(45) / 1000
    with pytest.raises(IdentificationError, match="at least 50 are needed"):
        measure(Recording(time, time**2, time, name="short"), Smoothing(10))
    assert len(measure(Recording(time, time**2, time, name="short"))) > 20


def test_a_reversal_within_the_window_is_found_by_the_shorter_one():
    """The joint turns for 3 ms, which the window of 20 ms smooths away."""
    time = np.arange(1000) / 1000
    velocity = 0.3 - 0.45 * np.exp(-(((time - 0.5) / 0.0018) ** 2))
    position = np.cumsum(velocity) / 1000
    run = Recording(time, position, np.sin(6 * time), name="turns")
    long, short = (measure(run, Smoothing(14, halt_width=width)) for width in (None, 2))
    assert np.count_nonzero(velocity < 0) == 3 and long.velocity.min() > 0.05
    np.testing.assert_array_equal(long.velocity, short.velocity)
    assert long.find_clear(0.0).all()
    missed = short.time[~short.find_clear(0.0)]
    assert missed[0] == pytest.approx(0.5 - 0.018, abs=0.003) and missed[-1] == pytest.approx(0.5 + 0.018, abs=0.003)
