"""What a body can be."""

import numpy as np

from estimators.checks.physical import impossible
from pendulum_env.physics import BASE, Model, Samples, Term
from pendulum_env.physics.actuation import ActuatorLag
from pendulum_env.physics.limits import limited_term

X = Samples(*np.ones((4, 3)))


def of(effect: Term) -> Model:
    return Model.build([*BASE, effect], [0.1, 2.0, 0.1, 0.1], [0.01] * 4)


def test_a_lag_of_seconds_is_no_drives():
    assert impossible(of(ActuatorLag(0.01)), X) == []
    assert impossible(of(ActuatorLag(2.0)), X) == ["actuator_lag.time_constant = 2 s, the most that it may be"]


def test_what_a_user_bounds_may_lie_at_its_bound():
    narrow = limited_term(ActuatorLag(0.01), {"actuator_lag.time_constant": (0.001, 0.01)})
    assert impossible(of(narrow), X) == []
