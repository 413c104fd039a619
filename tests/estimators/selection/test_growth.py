"""Growth of errors along a measured motion, by which free running shows nothing where friction falls with the speed."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.data.regression_data import RegressionData
from estimators.selection.motion_score import compute_growth
from pendulum_env.physics import BASE, Model, effect
from tests.cases import recorded

INERTIA = 0.09  # [kg m^2]


@pytest.fixture(scope="module")
def segments():
    run = recorded(Plant(), Experiment(rate=500.0, seconds=12.0, excitation="multisine", seed=1))
    return RegressionData.from_recordings(run).segments


def test_errors_grow_by_the_slope_of_friction_over_inertia(segments):
    """Viscous friction b < 0 amplifies errors by exp(-b t / J) while the joint moves; positive friction does not."""
    for viscous in (-0.09, -0.18, 0.35):
        growth = compute_growth(segments, Model.build(BASE, [INERTIA, 2.0, viscous, 0.8]))
        seconds = []
        for part in segments:
            index = part.first + np.arange(1, len(part.torque))[:, None]
            seconds.append(part.windows.moving[index].sum(axis=0) / 500.0)
        expected = np.exp(max(-viscous, 0.0) / INERTIA * np.concatenate(seconds))
        np.testing.assert_allclose(growth, expected, rtol=0.02)


def test_fast_motion_is_stable_beside_stribeck_friction(segments):
    stribeck = effect("stribeck")(stribeck_velocity=0.02)
    growth = compute_growth(segments, Model.build([*BASE, stribeck], [INERTIA, 2.0, 0.35, 0.8, 0.3]))
    assert np.median(growth) < 1.5 < growth.max()
