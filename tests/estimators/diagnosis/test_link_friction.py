"""Friction of the link behind an elastic joint, which delays its motion, is no delay of the torque."""

import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import diagnose
from tests.cases import recorded

MOTOR, LINK = 0.03, 0.06  # [kg m^2]
STIFFNESS, DAMPING, FRICTION = 60.0, 0.12, 0.12  # [N m/rad], and twice [N m s/rad]
BASIC = {"inertia": MOTOR + LINK, "gravity": 2.0, "viscous": 0.15, "coulomb": 0.4}


def test_viscous_friction_of_the_link_is_estimated_beside_its_elastic_joint():
    elastic = {"Jm": MOTOR, "bl_k": STIFFNESS, "bl_d": DAMPING, "bl_b": FRICTION}
    runs = (Experiment(rate=500.0, seconds=15.0, seed=seed, excitation="multisine") for seed in (5, 6))
    fitted, held_out = recorded(Plant(**BASIC, effects={"joint_flexibility": elastic}), *runs)
    found = diagnose([fitted], [held_out], only=["joint_flexibility", "actuator_lag", "dead_time"])
    assert found.selected == ("joint_flexibility",)
    truth = BASIC | {"viscous": BASIC["viscous"] + FRICTION}
    truth |= {"joint_flexibility": LINK, "joint_flexibility.viscous": FRICTION / LINK}
    for name, value in truth.items():
        estimate = found.model.estimates[name]
        assert estimate.value == pytest.approx(value, abs=3 * estimate.std), name
        assert 0 < estimate.std < 0.15 * value, name
