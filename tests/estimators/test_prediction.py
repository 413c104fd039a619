"""Results as arrays: what a model predicts of recordings, sample by sample."""

import numpy as np
import pytest

from benchmarks import six_joint
from estimators import Prediction, compare, diagnose, identify
from pendulum_env.physics import Model
from robots.arms import arm_base
from tests.robots.servos.in_loop.test_in_loop import MODEL, recorded


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def missed(own: Prediction) -> np.ndarray:
    error = own.simulated_position - own.position
    return error[np.isfinite(error)]


@pytest.fixture(scope="module")
def wrong(exact) -> Model:
    """A model whose inertia is 10 % too large."""
    model = identify(exact)["dynamic"].model
    return model.with_values({"inertia": 1.1 * model.estimates["inertia"].value})


def test_torque_of_a_wrong_inertia_is_off_by_what_the_acceleration_takes(exact, wrong):
    (own,) = compare(wrong, exact).recordings
    assert own.name == exact.name and own.residual.shape == own.time.shape == (len(exact),)
    known = np.isfinite(own.residual)
    assert np.array_equal(known, np.isfinite(own.torque)) and np.mean(known) > 0.5
    assert np.array_equal(own.residual[known], (own.torque - own.predicted_torque)[known])
    acceleration = np.gradient(np.gradient(exact.position, exact.time), exact.time)
    least = -0.1 / 1.1 * wrong.estimates["inertia"].value * acceleration
    assert np.corrcoef(own.residual[known], least[known])[0, 1] > 0.95
    assert rms(own.residual[known] - least[known]) < 0.4 * rms(least[known])  # windows are smooth, differences are not


def test_errors_are_those_of_the_counted_samples(exact, paper_run, wrong):
    found = compare(wrong, [exact, paper_run])
    for own, distance in zip(found.recordings, found.recording_errors, strict=True):
        assert rms(own.residual[own.is_counted]) == pytest.approx(distance.errors.torque_rms, rel=1e-9)
        assert rms(own.residual[np.isfinite(own.residual)]) == pytest.approx(distance.errors.torque_rms, rel=0.05)
        assert rms(missed(own)) == pytest.approx(distance.errors.position_rms, rel=0.1)
        assert own.is_held_out is None
    assert found.errors == found.joint.errors


def test_each_second_of_motion_is_what_the_model_does_from_the_measured_state(exact, wrong):
    (own,) = compare(wrong, exact).recordings
    begins = np.flatnonzero(np.isfinite(own.simulated_position))[0]
    stretch = slice(begins, begins + 100)
    velocity = np.gradient(exact.position, exact.time)[begins]
    path = wrong.simulate(1 / exact.rate, exact.torque[stretch], exact.position[begins], velocity).position[:100, 0]
    np.testing.assert_allclose(own.simulated_position[stretch], path, atol=2e-3)


def test_parts_of_a_diagnosis_are_told_apart(exact):
    found = diagnose(exact, only=["stribeck"])
    (own,) = found.recordings
    errors, held_out = found.steps[-1].errors, own.is_held_out
    for name, part in (("train", ~held_out), ("holdout", held_out)):
        assert rms(own.residual[own.is_counted & part]) == pytest.approx(errors[name].torque_rms, rel=1e-9)
    assert held_out[-1] and not held_out[0] and np.mean(held_out) == pytest.approx(0.3, abs=0.01)


def test_a_servo_in_the_loop_is_predicted_by_its_position():
    servo = recorded({}, gains=(4.0,))
    off = MODEL.with_values({"coulomb": 0.16})
    found = compare(off, servo)
    (own,) = found.recordings
    assert np.mean(np.isfinite(own.simulated_position)) > 0.98
    assert np.mean(np.abs(missed(own))) == pytest.approx(found.errors.motion, rel=0.02)
    with pytest.raises(ValueError, match="horizon"):
        diagnose(servo, horizon=1.0)


def test_an_arm_has_a_column_a_joint():
    body, run = six_joint.body(), six_joint.simulate(1, seconds=5.0)
    found = compare(identify(run, arm_base(body), "filtered_dynamic")["filtered_dynamic"].model, run)
    (own,) = found.recordings
    assert own.residual.shape == own.position.shape == (len(run), len(body.joints))
    assert np.isnan(own.simulated_position).all()
    for k, at in enumerate(body.joints):
        assert np.array_equal(own.columns[f"residual_{at}"], own.residual[:, k], equal_nan=True)
        counted = own.residual[own.is_counted[:, k], k]
        assert rms(counted) == pytest.approx(found.errors.joints[at], rel=1e-9)
        assert rms(own.residual[np.isfinite(own.residual[:, k]), k]) == pytest.approx(rms(counted), rel=0.1)
    with pytest.raises(ValueError, match="horizon"):
        compare(found, run, horizon=2.0)
