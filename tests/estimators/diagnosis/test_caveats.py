import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.diagnosis.caveats import PartOfTurn
from tests.cases import diagnosed, recorded
from tests.motions import record_motion

TIME = np.arange(6000) / 500.0
SPRING = Plant(0.09, 2.0, 0.35, 0.3, {"spring": {"spring_k": 0.5, "spring_q0": 0.0}})


def test_gravity_is_conditional_where_an_effect_of_the_angle_is_seen_over_part_of_a_turn():
    within = 2.2 * np.sin(4 * TIME) + 0.9 * np.sin(9.3 * TIME + 1)
    around = 3.4 * np.sin(1.1 * TIME) + 1.5 * np.sin(4.1 * TIME)
    found = {}
    for command in (within, around):
        experiment = Experiment(seed=3, seconds=12.0, rate=500.0)
        (run,) = recorded(SPRING, experiment, commands=[command])
        found[np.ptp(run.position) > 2 * np.pi] = diagnosed([run], only=["spring", "cogging", "stribeck"])
    assert all(one.selected == ("spring",) for one in found.values())
    caveats = {
        is_whole: [own for own in one.findings if isinstance(own, PartOfTurn)] for is_whole, one in found.items()
    }
    assert not caveats[True]
    (caveat,) = caveats[False]
    assert caveat.effects == ("spring",) and 0.5 < caveat.angle.value < 2 * np.pi


@pytest.mark.parametrize("torque", [lambda q: 0.15 * q**3, lambda q: 0.2 * q * np.abs(q)], ids=["hardening", "hose"])
def test_the_error_of_gravity_covers_the_other_laws_of_the_angle_that_fit_part_of_a_turn(torque):
    """A straight spring, less gravity, draws a weak cubic one; a wave of three to the turn draws q |q|."""
    found = diagnosed([record_motion(lambda q, v: torque(q) + 0.1 * v, 0.8)], only=["spring", "cogging", "stribeck"])
    gravity = found.model.estimates["gravity"]
    assert found.selected and abs(gravity.value - 2.0) < 3 * gravity.std
    inertia = found.model.estimates["inertia"]
    assert abs(inertia.value - 0.09) < 3 * inertia.std < 0.01 * 0.09


def test_a_spring_that_alone_fits_leaves_the_error_of_gravity_small():
    found = diagnosed([record_motion(lambda q, v: 0.5 * q + 0.1 * v, 1.5)], only=["spring", "cogging", "stribeck"])
    gravity = found.model.estimates["gravity"]
    assert found.selected == ("spring",) and abs(gravity.value - 2.0) < 3 * gravity.std < 0.01 * 2.0
