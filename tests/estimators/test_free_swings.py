"""Free swings: pendulums that are let go, without any torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import identify
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from tests.once import once

INERTIA = 0.01
TRUTH = {"gravity": 0.5, "viscous": 2e-3, "coulomb": 3e-3}
INERTIA_TOO = {"inertia": INERTIA}
RATIOS = {name: value / INERTIA for name, value in TRUTH.items()}


@once("benchmarks")
def swinging(start: float = 2.6, hidden: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = (), **base: float):
    """A pendulum of a course, let go at rest: 20 s at 200 Hz with 4096 counts per turn."""
    plant = Plant(**(INERTIA_TOO | TRUTH | base), effects={id: dict(values) for id, values in hidden})
    experiment = Experiment(rate=200.0, seconds=20.0, start=(start, 0.0), counts=4096, torque_noise=0.0)
    (run,) = simulate([(plant, experiment)], [np.zeros(experiment.samples)])
    return Recording(f"from {start:g} rad", run.time, run.position, run.torque)


@once("benchmarks")
def pushed(scale: float = 0.2) -> Recording:
    """The same pendulum under torque."""
    plant = Plant(INERTIA, **TRUTH)
    experiment = Experiment(rate=200.0, seconds=20.0, scale=scale, counts=4096, torque_noise=1e-3, seed=3)
    (run,) = simulate([(plant, experiment)])
    return Recording("pushed", run.time, run.position, run.torque)


def assert_recovered(model: Model, truth: dict[str, float], errors: float = 3.5) -> None:
    for name, value in truth.items():
        estimate = model.estimates[name]
        assert abs(estimate.value - value) < errors * estimate.std and estimate.std < 0.25 * value, name


def test_parameters_relative_to_the_inertia():
    found = identify(swinging())
    assert found.torque_unit == "rad/s^2" and [doubt.withheld for doubt in found.doubts] == [()]
    for own in found.schemes.values():
        assert_recovered(own.model, RATIOS, 4.5)
        units = {name: estimate.unit for name, estimate in own.model.estimates.items()}
        assert units == {"inertia": "1", "gravity": "rad/s^2", "viscous": "1/s", "coulomb": "rad/s^2"}
    assert [found[id].unit for id in ("dynamic", "energy", "filtered_power")] == ["rad/s^2", "rad^2/s^2", "rad^2/s^3"]


@pytest.mark.parametrize("name, value", [("inertia", INERTIA), ("gravity", 0.5)])
def test_a_known_parameter_gives_the_others(name, value):
    found = identify(swinging(), fixed={name: value})
    assert found.torque_unit == "N m" and not found.doubts
    for model in (*(own.model for own in found.schemes.values()), found.windows):
        assert model.estimates[name].value == value and model.estimates[name].std == 0.0
        assert_recovered(model, {own: truth for own, truth in (INERTIA_TOO | TRUTH).items() if own != name}, 4.5)


def test_all_is_proportional_to_the_inertia():
    relative, absolute = identify(swinging()), identify(swinging(), fixed={"inertia": INERTIA})
    for id, own in relative.schemes.items():
        assert INERTIA * own.model.theta == pytest.approx(absolute[id].model.theta)
        assert INERTIA * own.residual_rms == pytest.approx(absolute[id].residual_rms)


def test_torque_of_rounding_is_none():
    run = swinging()
    rounded = replace(run, torque=1e-12 * np.sin(run.time))
    assert identify(rounded).json() == identify(run).json()


def test_several_swings_share_their_parameters():
    found = identify([swinging(2.6), swinging(1.2)])
    assert_recovered(found.windows, RATIOS)


def test_friction_that_is_not_there_is_not_told_from_none():
    for name in ("viscous", "coulomb"):
        estimate = identify(swinging(**{name: 0.0})).windows.estimates[name]
        assert abs(estimate.value) < 4 * estimate.std and estimate.std < 0.05 * RATIOS[name]
