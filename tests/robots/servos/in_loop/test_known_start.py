"""The parameters of a known model are a start of the fit: it does not end at a less likely point."""

import numpy as np
import pytest

from estimators.data.regression_data import RegressionData
from estimators.weak_form.point import Point
from pendulum_env.physics import Model
from pendulum_env.physics.base import Coulomb, Inertia, Viscous
from pendulum_env.recording import Recording
from robots.servos import ServoDrive
from robots.servos.in_loop.rollout_rows import RolloutRows
from robots.servos.in_loop.rollouts import Rollouts

TERMS, KP, RATE, STEP = (Inertia(), Viscous(), Coulomb()), 2.0, 50.0, 1e-4
INERTIA, VISCOUS, COULOMB = THETA = (0.004, 0.14, 0.06)


@pytest.fixture(scope="module")
def recording():
    """Simulated with set-valued friction; its logged torque is wrong, and so are starts by the torque."""
    time = np.arange(round(20 * RATE)) / RATE
    goal = 0.1 * np.sin(0.4 * time) + 0.05 * np.sign(np.sin(1.1 * time))
    positions, q, v = np.empty(len(time)), 0.0, 0.0
    for k, wanted in enumerate(goal.tolist()):
        positions[k] = q
        for _ in range(round(1 / RATE / STEP)):
            v += STEP * (KP * (wanted - q) - VISCOUS * v) / INERTIA
            v -= max(-STEP * COULOMB / INERTIA, min(STEP * COULOMB / INERTIA, v))
            q += STEP * v
    drive = ServoDrive(output="torque", kp=KP, goal="held", reads="exact", encoder="output")
    return Recording(time, positions, 1e-3 * np.cos(7 * time), reference=goal, drive=drive)


def test_fit_is_at_least_as_likely_as_a_known_model(recording):
    rows = RolloutRows(Rollouts((recording,)), RegressionData.from_recordings((recording,)).torque)
    rows.fits.add_start(Model.build(TERMS, THETA))
    own = np.abs(rows.rollouts.compute_position_errors([Point(TERMS, np.array(THETA))])).mean()
    fit = rows.fit(TERMS, exactly=True)
    assert np.abs(rows.rollouts.compute_position_errors([fit])).mean() < 1.1 * own + 1e-5
    assert fit.theta == pytest.approx(THETA, rel=0.1, abs=0.002)
