"""Errors of segments as innovations, on recordings of a simulator that shares no model code."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.simulation import output_error
from estimators.simulation.free_running import choose_segments
from estimators.weak_form.point import Point
from pendulum_env.physics import BASE
from tests.cases import PLANT, TRUTH, recorded

AT = Point(BASE, TRUTH)


def each(seeds: range, counts: int = 1_024_000) -> list[RegressionData]:
    of_all = {"rate": 500.0, "seconds": 10.0, "counts": counts, "torque_noise": 0.05}
    runs = recorded(PLANT, *(Experiment(seed=seed, **of_all) for seed in seeds))
    return [RegressionData.from_recordings([run]) for run in runs]


@pytest.mark.parametrize("counts", [8192, 1_024_000])
def test_at_the_true_parameters_innovations_are_as_large_as_expected_and_unrelated(counts: int):
    (prepared,) = each(range(5, 6), counts)
    segments = [choose_segments(windows, 0.5) for windows in prepared.data.windows]
    filters = output_error.make_innovations(segments, AT)
    new, plain = (
        output_error.compute_errors(segments, [AT], used)[0].reshape(len(segments[0].first), -1)
        for used in (filters, ())
    )
    assert np.median(np.sqrt(np.mean(new**2, axis=1))) == pytest.approx(1.0, abs=0.25)

    def relation(errors: np.ndarray) -> float:
        return float(np.median(np.sum(errors[:, 1:] * errors[:, :-1], axis=1) / np.sum(errors**2, axis=1)))

    assert relation(plain) > 0.6
    assert abs(relation(new)) < 0.3


def gain(seeds: range, counts: int = 1_024_000) -> float:
    """Error of the fit by innovations over that of windows, geometric mean over the parameters."""
    errors = []
    for prepared in each(seeds, counts):
        start, _ = fit_terms(prepared, BASE)
        segments = [choose_segments(windows, 0.5) for windows in prepared.data.windows]
        found = output_error.fit_maximum_likelihood(segments, Point(BASE, start.theta))
        errors.append(np.abs(np.array([start.theta, found.theta]) / AT.theta - 1))
    windows, innovations = np.sqrt(np.mean(np.square(errors), axis=0))
    return float(np.exp(np.mean(np.log(innovations / windows))))


@pytest.mark.slow
def test_a_coarse_encoder_hides_less_from_innovations_than_from_windows():
    assert gain(range(10, 16), counts=8192) < 0.8
