"""The parameters of a known model are a start of the fit: it does not end at a less likely point."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.data.regression_data import RegressionData
from estimators.weak_form.point import Point
from pendulum_env.physics import Model
from pendulum_env.physics.actuation import BackEmf
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


@pytest.fixture(scope="module")
def rows(recording):
    torque = RegressionData.from_recordings((recording,)).torque
    return RolloutRows(Rollouts((recording,)), torque, known=Model.build(TERMS, THETA))


def mean_error(rows, point):
    return float(np.abs(rows.rollouts.compute_position_errors([point])).mean())


def test_fit_is_at_least_as_likely_as_a_known_model(rows):
    own = mean_error(rows, Point(TERMS, np.array(THETA)))
    fit = rows.fit(TERMS, exactly=True)
    assert mean_error(rows, fit) < 1.1 * own + 1e-5
    assert fit.theta == pytest.approx(THETA, rel=0.1, abs=0.002)


def test_a_fit_with_more_terms_starts_from_the_known_model(rows):
    """Friction that depends on the load adds back-EMF, which is zero in a model without it."""
    own = mean_error(rows, Point(TERMS, np.array(THETA)))
    fit = replace(rows).fit((*TERMS, BackEmf()))
    assert mean_error(rows, fit) < 1.1 * own + 1e-5
    assert fit.linear_values["viscous"] + fit.linear_values["back_emf"] == pytest.approx(VISCOUS, rel=0.1)


def test_the_final_fit_is_at_least_as_likely_as_a_known_model(rows):
    """A search fits pieces of long recordings, and its fit may be far from that of the whole recordings."""
    own, fine = mean_error(rows, Point(TERMS, np.array(THETA))), rows.fine
    fine.fits.set_start(Point(TERMS, np.array([0.05, 2.0, 0.4])))
    assert mean_error(fine, fine.fit(TERMS)) < 1.1 * own + 1e-5
