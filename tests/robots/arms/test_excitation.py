"""Motions from knot to knot: their limits, whatever is asked for, what they teach, and an arm that follows them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.arm_excitation import deviation, random_fourier
from benchmarks.two_link import TwoLink
from estimators import identify
from estimators.regression.least_squares import IdentificationError
from pendulum_env.plant import PAPER
from robots.arms import arm_base
from robots.arms.body import read_body
from robots.arms.env import PlanarArm
from robots.arms.excitation import (
    INFORMATION_PRIOR,
    MotionBatch,
    compute_parameter_scales,
    design_excitation,
    is_clear_of_stick,
    stop_motion,
)
from robots.arms.following import follow
from robots.arms.limits import Limits, find_limits
from robots.arms.plane import find_planar_links
from robots.arms.reference import KNOT_PERIOD, TICK, make_torque_rows


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    angle=st.floats(0.05, 6.0),
    speed=st.floats(0.3, 10.0),
    slowness=st.floats(1.0, 30.0),
)
def test_angle_speed_and_acceleration_are_kept_whatever_is_asked_for(body, seed, angle, speed, slowness):
    both = np.ones(2)
    limits = Limits(-angle * both, angle * both, speed * both, np.inf * both, speed / KNOT_PERIOD / slowness * both)
    motions, rng = MotionBatch(body, limits, 1), np.random.default_rng(seed)
    start, speeds = motions.position[0], [motions.speed]
    for _ in range(60):
        motions.advance(rng.choice([-1.0, -0.3, 0.0, 1.0], (1, 2)) if seed % 2 else np.ones((1, 2)))
        speeds.append(motions.speed)
    motion = stop_motion(body, motions, start, speeds)
    time = np.linspace(0, motion.seconds, 5001)
    q, v, a = motion(time)
    assert np.abs(q).max() <= angle * (1 + 1e-9)
    assert np.abs(v).max() <= speed * (1 + 1e-9)
    assert np.abs(a).max() <= limits.acceleration.max() * (1 + 1e-9)


def test_velocity_and_acceleration_are_derivatives_without_jumps(body):
    motion = design_excitation(body, 3.0)
    time = np.arange(0, motion.seconds, 1e-4)
    q, v, a = motion(time)
    assert np.abs(np.gradient(q, time, axis=0) - v)[1:-1].max() < 1e-4
    assert np.abs(np.gradient(v, time, axis=0) - a)[1:-1].max() < 0.05
    steepest = 2 * motion.speeds.max() / KNOT_PERIOD**2  # from one full acceleration to the other within a knot
    assert np.abs(np.diff(a, axis=0)).max() <= 1e-4 * steepest * (1 + 1e-9)
    for end in (0, -1):
        assert np.allclose(v[end], 0, atol=1e-2) and np.allclose(a[end], 0, atol=0.5)
    assert np.allclose(motion(np.array([motion.seconds, motion.seconds + 5.0]))[1], 0)


def test_what_a_motion_is_said_to_teach_is_what_its_rows_hold(body):
    motions, rng = MotionBatch(body, find_limits(body, max_torque=12.0), 1), np.random.default_rng(0)
    start, speeds = motions.position[0], [motions.speed]
    for _ in range(20):
        motions.advance(rng.uniform(-1, 1, (1, 2)))
        speeds.append(motions.speed)
    taught = motions.information[0].copy()
    q, v, a = stop_motion(body, motions, start, speeds)(np.arange(TICK / 2, 20 * KNOT_PERIOD, TICK))
    rows = make_torque_rows(body, q, v, a) * compute_parameter_scales(body)
    rows = rows[is_clear_of_stick(v, a)]
    np.testing.assert_allclose(taught, INFORMATION_PRIOR * np.eye(rows.shape[1]) + rows.T @ rows, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_an_arm_of_six_joints_is_taught_more_of_than_by_the_best_of_random_series(six):
    motion = design_excitation(six, 10.0)
    time = np.arange(0, motion.seconds, 1e-3)
    q, v, _ = motion(time)
    low, high = six.position_limits
    assert (q > low).all() and (q < high).all() and (np.abs(v) <= six.velocity_limits).all()
    assert (np.abs(motion.body.torque(*motion(time[::10])) @ six.values) <= six.torque_limits * 1.01).all()
    series = random_fourier(six, 10.0, np.random.default_rng(0))
    assert deviation(motion, 10.0) < 0.8 * deviation(series, 10.0)


def test_a_simulated_arm_that_follows_has_smaller_standard_errors_and_is_right(body):
    errors = {}
    for motion in (design_excitation(body, 5.0, max_torque=12.0), random_fourier(body, 5.0, np.random.default_rng(0))):
        arm = PlanarArm(find_planar_links(body), joints=body.joints, torque_noise=0.1)
        recording = follow(arm, motion, 5000, 12.0, rng=np.random.default_rng(1))
        model = identify(recording, arm_base(body), "filtered_dynamic")["filtered_dynamic"].model
        links = find_planar_links(body)
        truth = np.concatenate([body.values, [own for link in links for own in (link.viscous, link.coulomb)]])
        std = np.array([model.estimates[column.name].std for column in model.columns])
        assert np.abs((model.theta - truth) / std).max() < 4.5
        errors[str(motion)] = np.sqrt(np.mean((std[:6] / compute_parameter_scales(body)[:6]) ** 2))
    planned, series = errors.values()
    assert planned < 0.8 * series


@pytest.mark.parametrize(
    ("bounds", "told"),
    [
        ({"max_torque": 1e-3}, "needs more torque than the joints have"),
        ({"max_speed": -1.0}, "max_speed is -1"),
        ({"max_angle": np.nan}, "max_angle is nan"),
        ({"seconds": 0.0}, "a motion of 0 s is too short"),
    ],
)
def test_what_no_arm_can_do_is_refused(six, bounds, told):
    with pytest.raises(IdentificationError, match=told):
        design_excitation(six, **{"seconds": 1.0, **bounds})


def test_friction_that_a_file_sets_to_zero_has_a_size_all_the_same(body, tmp_path):
    text = TwoLink().urdf().replace("</joint>", '<dynamics damping="0.1" friction="0"/></joint>')
    (tmp_path / "arm.urdf").write_text(text)
    own = compute_parameter_scales(read_body(tmp_path / "arm.urdf"))
    assert (own > 0).all() and own[-4:-2] == pytest.approx(0.1) and own[-2:] == pytest.approx(PAPER["coulomb"])
