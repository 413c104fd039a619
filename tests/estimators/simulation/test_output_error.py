"""Output error over segments, on recordings of a simulator that shares no model code."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.data.regression_data import RegressionData
from estimators.simulation import output_error
from estimators.simulation.free_running import simulate_all
from estimators.weak_form.point import Point
from pendulum_env.physics import BASE, effect
from tests.cases import recorded

TRUTH = {"inertia": 0.09, "gravity": 2.0, "viscous": 0.35, "coulomb": 0.9}


def prepared_of(effects: dict[str, dict[str, float]], **experiment: float) -> RegressionData:
    plant = Plant(**TRUTH, effects=effects)
    return RegressionData.from_recordings(recorded(plant, Experiment(rate=1000.0, seconds=8.0, seed=3, **experiment)))


def test_a_wrong_start_leads_to_the_true_parameters():
    prepared = prepared_of({}, counts=1_024_000, torque_noise=0.02)
    start = np.array(list(TRUTH.values())) * [1.1, 0.9, 1.2, 0.85]
    point = output_error.fit_segments(prepared.segments, Point(BASE, start))
    assert point.theta == pytest.approx(list(TRUTH.values()), rel=3e-3)


@pytest.mark.parametrize("excitation", ["triangle", "two_tone"])
def test_a_start_with_wrong_friction_leads_to_the_same_fit(excitation):
    plant = Plant(**TRUTH)
    run = recorded(plant, Experiment(excitation=excitation, rate=500.0, seconds=8.0, seed=3, counts=16_384))
    segments, truth = RegressionData.from_recordings(run).segments, np.array(list(TRUTH.values()))
    starts = truth, truth * [1.2, 1.0, 0.2, 1.2]
    ends = [output_error.fit_segments(segments, Point(BASE, start)) for start in starts]
    errors = [output_error.compute_rms(segments, end) for end in ends]
    assert errors[1] < 1.05 * errors[0]
    assert ends[1].theta == pytest.approx(ends[0].theta, rel=0.01)


def test_standard_errors_cover_the_truth():
    prepared = prepared_of({}, counts=65_536, torque_noise=0.05)
    point = output_error.fit_segments(prepared.segments, Point(BASE, np.array(list(TRUTH.values()))))
    model = output_error.make_model(prepared.segments, point)
    z = [(model.estimates[name].value - true) / model.estimates[name].std for name, true in TRUTH.items()]
    assert np.abs(z).max() < 4
    assert all(0 < model.estimates[name].std < 0.05 * true for name, true in TRUTH.items())


@pytest.mark.slow
def test_friction_that_windows_hardly_see_is_found_by_what_it_does_to_motion():
    # 8192 counts: windows clear of reversals hold little of presliding, which lasts a hundredth of a turn after them
    stiffness = 60.0
    prepared = prepared_of({"presliding": {"dahl_sigma": stiffness}}, counts=8192, torque_noise=0.02)
    terms = (*BASE, effect("presliding")(displacement=0.008))
    start = np.array([*TRUTH.values(), TRUTH["coulomb"]]) * [1.0, 1.0, 1.0, 1.0, 0.8]
    point = output_error.fit_segments(prepared.segments, Point(terms, start))
    assert point.theta[-1] == pytest.approx(TRUTH["coulomb"], rel=0.05)
    assert point.terms[-1].nonlinear_values["displacement"] == pytest.approx(TRUTH["coulomb"] / stiffness, rel=0.05)


def test_an_error_of_the_initial_state_alone_leaves_no_residual():
    prepared = prepared_of({}, counts=1_024_000, torque_noise=0.0)
    (segments,) = prepared.segments
    point = Point(BASE, np.array(list(TRUTH.values())))
    exact = output_error.compute_rms([segments], point)
    shifted = np.array(segments.velocity) + 2e-3

    off = replace(segments, velocity=shifted)
    assert output_error.compute_rms([off], point) < 3 * exact
    assert output_error.compute_rms([off], Point(BASE, point.theta * 1.02)) > 10 * exact


def test_errors_by_torque_noise_are_as_large_as_their_estimate_on_average():
    """Mean of ratios: an estimate from few draws would be too small in some segments, and the mean too large."""
    segments = RegressionData.from_recordings(
        recorded(
            Plant(**TRUTH),
            *(Experiment(rate=1000.0, seconds=8.0, torque_noise=0.1, seed=k, excitation="steps") for k in range(4)),
        )
    ).segments
    point, rng = Point(BASE, np.array([*TRUTH.values()])), np.random.default_rng(1)
    paths = simulate_all(segments, [(BASE, point.theta)])
    measured = [
        replace(segment, torque=output_error.redraw_torque(segment, rng), position=path[:, 0])
        for _ in range(10)
        for segment, path in zip(segments, paths, strict=True)
    ]
    squares = output_error.compute_segment_rms(measured, point) ** 2
    ratios = squares.reshape(10, -1) / output_error.compute_noise(segments, point, has_free_states=True)
    assert 0.85 < ratios.mean() < 1.2
