import numpy as np
import pytest

from estimators.regression.equations import Equations
from estimators.regression.recursive import PRIOR, State, evenly, history, start, step
from estimators.schemes import six
from estimators.schemes.six import SCHEMES, Integral
from estimators.signals.measurements import measure
from pendulum_env.physics import BASE


def run(equations: Equations, mask: np.ndarray, points: np.ndarray, dtype: type = np.float64) -> list[State]:
    state, states = start(equations.phi.shape[1]), []
    state = State(state.theta.astype(dtype), state.P.astype(dtype))
    phi, y = equations.phi.astype(dtype), equations.y.astype(dtype)
    for k in range(points[-1] + 1):
        if mask[k]:
            state = step(state, phi[k], y[k])
        if k in points:
            states.append(state)
    return states


@pytest.mark.parametrize(
    "scheme", [*SCHEMES, six.scheme("energy", operator=Integral(None))], ids=lambda scheme: scheme.id
)
def test_history_equals_the_recursion(scheme, exact):
    """To 1e-9; the recursion itself, which starts from 1e7, needs long doubles to be that exact."""
    equations, usable = scheme.regression(measure(exact), BASE)
    points = np.array([200, 500, 1000])
    course = history(equations, usable, points)
    for k, state in enumerate(run(equations, usable, points, np.longdouble)):
        np.testing.assert_allclose(course.theta[k], state.theta.astype(float), rtol=1e-9)
        scale = np.sqrt(np.outer(*2 * [np.diag(state.P)])).astype(float)
        np.testing.assert_allclose(course.P[k] / scale, state.P.astype(float) / scale, atol=1e-9)


def test_error_is_the_one_before_the_update():
    first = step(start(2), np.array([1.0, 0.0]), 5.0)
    second = step(first, np.array([1.0, 0.0]), 7.0)
    assert first.error == 5.0
    assert second.error == pytest.approx(2.0, abs=1e-5)


def test_history_before_any_equation_is_the_prior():
    equations = Equations(np.ones((10, 2)), np.ones(10))
    course = history(equations, np.arange(10) >= 5, np.array([3, 9]))
    np.testing.assert_allclose(course.theta[0], 0, atol=1e-12)
    np.testing.assert_allclose(course.P[0], PRIOR * np.eye(2))
    np.testing.assert_allclose(course.theta[1], 0.5, rtol=1e-6)  # two equal columns share what they explain


def test_evenly_ends_at_the_last_equation():
    assert evenly(1000, 4).tolist() == [250, 500, 749, 999]
    assert evenly(3, 200).tolist() == [1, 2]
