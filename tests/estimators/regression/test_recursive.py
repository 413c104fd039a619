import numpy as np

from estimators.regression.least_squares import Equations
from estimators.regression.recursive import PRIOR, choose_indices, compute_history
from tests.paper_recursion import State, start, step


def test_history_equals_the_recursion():
    """To 1e-9; the recursion itself, which starts from 1e7, needs long doubles to be that exact."""
    rng = np.random.default_rng(0)
    phi, usable = rng.standard_normal((1000, 4)) * [30.0, 1.0, 5.0, 1.0], rng.random(1000) < 0.7
    y, points, state = phi @ [0.1, 2.0, 0.3, 0.9] + 0.1 * rng.standard_normal(1000), np.array([20, 500, 999]), start(4)
    course, state = (
        compute_history(Equations(phi, y), usable, points),
        State(*(np.longdouble(part) for part in state[:2])),
    )
    for k, row in enumerate(np.longdouble(phi)):
        state = step(state, row, np.longdouble(y[k])) if usable[k] else state
        for j in np.flatnonzero(points == k):
            np.testing.assert_allclose(course.theta[j], state.theta.astype(float), rtol=1e-9)
            scale = np.sqrt(np.outer(*2 * [np.diag(state.P)])).astype(float)
            covariance = course.root[j] @ course.root[j].T
            np.testing.assert_allclose(covariance / scale, state.P.astype(float) / scale, atol=1e-9)


def test_history_before_any_equation_is_the_prior_and_its_points_end_at_the_last_one():
    course = compute_history(Equations(np.ones((10, 2)), np.ones(10)), np.arange(10) >= 5, np.array([3, 9]))
    np.testing.assert_allclose(course.theta[0], 0, atol=1e-12)
    np.testing.assert_allclose(course.root[0] @ course.root[0].T, PRIOR * np.eye(2))
    np.testing.assert_allclose(course.theta[1], 0.5, rtol=1e-6)  # two equal columns share what they explain
    assert (choose_indices(1000, 4).tolist(), choose_indices(3, 200).tolist()) == ([250, 500, 749, 999], [1, 2])
