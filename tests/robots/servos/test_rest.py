"""Rest of a servo near its goal."""

import numpy as np
import pytest

from pendulum_env.physics import BASE, Model, find_term
from pendulum_env.recording import Recording
from robots.servos import ServoDrive
from robots.servos.rest import find_rest_band

TIME = np.arange(400) / 100.0


def find(kp, ki=0.0, gravity=0.5, effect=None, values=()):
    position = np.pi / 2 + 0.3 * np.sin(2 * TIME)  # level in the middle
    drive = ServoDrive(output="torque", kp=kp, ki=ki)
    recording = Recording(TIME, position, np.ones(400), reference=position, drive=drive, name="log")
    terms = BASE if effect is None else (*BASE, find_term(effect)())
    return find_rest_band(Model.build(terms, [0.01, gravity, 0.05, 0.1, *values]), [recording])


def test_friction_and_weight_over_the_stiffness_keep_a_servo_from_its_goal():
    band = find(kp=8.0)
    assert band.friction.value == pytest.approx(0.1 / 8.0)
    assert band.weight.value == pytest.approx(0.5 / 8.0, rel=0.05)
    assert find(kp=8.0 * band.factor * 1.01) is None
    assert find(kp=16.0).distance.value == pytest.approx(band.distance.value / 2)


def test_an_integral_or_a_stiff_servo_has_no_band():
    assert find(kp=8.0, ki=1.0) is None and find(kp=100.0) is None


@pytest.mark.parametrize(("effect", "values"), [("presliding", (0.1,)), ("friction_drift", (0.0, 0.3))])
def test_springs_and_drifts_leave_the_band_of_dry_friction(effect, values):
    assert find(kp=8.0, effect=effect, values=values).friction.value == pytest.approx(0.1 / 8.0)


def test_friction_that_grows_with_the_torque_is_that_at_the_edge_of_stick():
    band = find(kp=8.0, effect="load_dependent_friction", values=(0.3, 0.0))
    weight = band.weight.value * 8.0
    assert band.distance.value == pytest.approx((weight + 0.1) / 0.7 / 8.0, rel=1e-3)  # T = |w| + fc + mu T
