"""Estimates whose sign no noise explains."""

import pytest

from estimators.checks.signs import NegativeParameters, find_driving_friction
from pendulum_env.physics import BASE, Model, effect
from pendulum_env.physics.table import FrictionBySpeed


@pytest.mark.parametrize(
    ("terms", "theta", "std", "told"),
    [
        (BASE, (2.0, 0.1, -0.2), 0.01, "coulomb"),
        (BASE, (2.0, -0.2, -0.2), 0.01, "viscous coulomb"),
        (BASE, (2.0, 0.1, -0.031), 0.01, "coulomb"),
        (BASE, (2.0, 0.1, -0.029), 0.01, None),  # or it may be noise
        (BASE, (2.0, 0.1, -0.2), 0.0, None),  # or what was told
        ([*BASE, effect("stribeck")()], (2.0, 0.1, -0.2, 0.5), 0.01, "coulomb"),
        ([*BASE, FrictionBySpeed()], (2.0, 0.1, -0.2, 0.5, 0.5, 0.5), 0.01, None),  # the table holds all of it
    ],
)
def test_friction_that_surely_drives_is_said_whatever_else_outweighs_it(terms, theta, std, told):
    found = find_driving_friction(Model.build(terms, [0.1, *theta], [0.01, 0.01, 0.01, std, *theta[3:]]))
    assert found == ([NegativeParameters(tuple(told.split()))] if told else [])
