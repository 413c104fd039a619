"""Friction of the link behind an elastic joint, which delays its motion, is no delay of the torque."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import diagnose
from tests.cases import recorded

MOTOR, LINK = 0.03, 0.06  # [kg m^2]
STIFFNESS, DAMPING, FRICTION = 60.0, 0.12, 0.12  # [N m/rad], and twice [N m s/rad]
BASIC = {"inertia": MOTOR + LINK, "gravity": 2.0, "viscous": 0.15, "coulomb": 0.4}


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "size"), [(1, 0.8), (2, 0.8), (5, 0.7)])
def test_an_elastic_joint_whose_torque_is_exact_has_no_dead_time(seed, size):
    """The rigid model takes it for torque that is logged late, and a dead time then undoes the correction."""
    elastic = {"Jm": 0.055, "bl_k": 192.0, "bl_d": 0.11}
    plant = Plant(inertia=0.09, gravity=1.5, viscous=0.15, coulomb=0.0, effects={"joint_flexibility": elastic})
    experiment = Experiment(rate=1000.0, seconds=30.0, seed=1, counts=262_144, torque_noise=0.0, torque_step=1e-4)
    steps = np.repeat(np.random.default_rng(seed).uniform(-1, 1, 260), 120)[:30_000]
    command = size * (steps + 0.6 * np.sin(2 * np.pi * 0.31 * np.arange(30_000) / 1000.0))
    found = diagnose(recorded(plant, experiment, commands=[command]), only=["joint_flexibility", "dead_time"])
    assert found.selected == ("joint_flexibility",) and not found.data.timing.has_moved
    for name, truth in (
        ("inertia", 0.09),
        ("joint_flexibility", 0.035),
        ("joint_flexibility.resonance", (192.0 / 0.035) ** 0.5),
    ):
        estimate = found.model.estimates[name]
        assert abs(estimate.value - truth) < 3 * estimate.std < 0.01 * truth, name
