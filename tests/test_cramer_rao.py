"""The Cramer-Rao bound against the covariance of all measurements at once, and what efficient estimates reach."""

import numpy as np
import pytest

from benchmarks.cramer_rao import STUDIES, Steps, bound, draw_recording, fit_windows, linearise
from benchmarks.independent_plant import Experiment, simulate
from estimators.data.regression_data import RegressionData


def test_the_recursion_gives_the_information_of_all_measurements_at_once():
    rng, count = np.random.default_rng(0), 40
    A = np.array([[1.0, 0.01], [-0.02, 0.97]])
    kicked = rng.standard_normal((count, 2, 2)) * [[[1e-3], [0.1]]]
    steps = Steps(np.repeat(A[None], count, axis=0), np.repeat([[5e-4, 0.1]], count, axis=0), kicked)
    position_noise, torque_noise = 1e-3, 0.05
    moved, pushed, rows, kicks = np.c_[np.zeros((2, 2)), np.eye(2)], np.zeros((2, count)), [], []
    for k in range(count):
        rows.append(moved[0].copy())  # of position k by parameters and first state
        kicks.append(pushed[0].copy())  # by the error of every torque
        moved, pushed = A @ moved, A @ pushed
        moved[:, :2] += steps.theta[k]
        pushed[:, k] = steps.torque[k]
    slopes, kicked = np.array(rows), np.array(kicks)
    noise = position_noise**2 * np.eye(count) + torque_noise**2 * kicked @ kicked.T
    expected = np.sqrt(np.diag(np.linalg.inv(slopes.T @ np.linalg.solve(noise, slopes)))[:2])
    np.testing.assert_allclose(bound(steps, position_noise, torque_noise), expected, rtol=1e-6)


@pytest.mark.slow
def test_the_fit_over_windows_comes_near_the_bound_and_does_not_beat_it():
    study = STUDIES[0]
    experiment = Experiment(rate=500.0, seconds=4.0, seed=1)
    (run,) = simulate([(study.plant, experiment)])
    least = bound(linearise(study, run), study.position_noise, experiment.torque_noise)
    truth = np.array([study.plant.inertia, study.plant.gravity, study.plant.viscous, study.plant.coulomb])
    errors = [
        fit_windows(RegressionData.from_recordings([draw_recording(study, run, j)]), ()).theta - truth
        for j in range(60)
    ]
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / least
    assert ratio.min() > 0.75  # sampling error of an RMS over 60: 9 %
    assert ratio.max() < 2.0
    assert np.mean(ratio) == pytest.approx(1.15, abs=0.35)
