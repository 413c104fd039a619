"""Inertia that a slow sweep does not determine is not used: nothing is simulated, advised or exported by it."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.checks.remedies import WrongColumn
from estimators.comparison import compare
from estimators.diagnosis.addition import add
from estimators.identification import identify
from pendulum_env.physics import BASE, Model, ModelError
from pendulum_env.plant import make_plant
from pendulum_env.recording import Recording
from tests import slow
from tests.cases import diagnosed
from workbench.narrator.diagnosis import describe_addition, describe_unstable

JOINT = {"gravity": 0.02, "viscous": 0.05, "coulomb": 0.3}


def sweep(seed=0, offset=0.0, inertia=2e-4, speed=0.5, ramp=0.3, **law) -> Recording:
    """Compute the torque of a prescribed slow motion both ways, with slow reversals: friction is nearly all of it."""
    joint, rate = JOINT | law, 200.0
    rng, time = np.random.default_rng(seed), np.arange(0, 60.0, 1 / rate)
    weights = np.hanning(int(ramp * rate) + 2)
    velocity = np.convolve(np.where(time % 20.0 < 10.0, speed, -speed), weights / weights.sum(), mode="same")
    position = np.cumsum(velocity) / rate - 1.0
    torque = inertia * np.gradient(velocity, time) + joint["viscous"] * velocity + joint["gravity"] * np.sin(position)
    torque += joint["coulomb"] * np.sign(velocity) + offset + 0.01 * rng.standard_normal(len(time))
    step = 2 * np.pi / 4096
    return Recording(time, step * np.round(position / step), torque, name="sweep")


@pytest.fixture(scope="module", params=slow.but_first(range(2)))
def run(request) -> Recording:
    return sweep(request.param)


def test_nothing_is_missing_and_nothing_is_simulated(run):
    found = diagnosed([run])
    assert not found.selected and not found.unexplained
    assert found.suggestion is None and found.no_experiment
    assert found.model.estimates["inertia"].is_unknown
    assert all(np.isnan(own.position_rms) for own in found.steps[-1].errors.values())
    friction = found.model.estimates["coulomb"].value + 0.5 * found.model.estimates["viscous"].value
    assert friction == pytest.approx(0.325, abs=0.002)
    assert not any(isinstance(own, WrongColumn) for own in found.findings)


def test_an_offset_beside_it_is_found():
    found = diagnosed([sweep(6, offset=0.02)])
    assert any("torque_offset" in group for group in found.effects)
    (selected,) = found.selected
    speed = 0.5 if selected == "viscous_asymmetry" else 1.0  # at one speed both ways, an asymmetry is an offset
    assert speed * found.model.estimates[selected].value == pytest.approx(0.02, rel=0.2)


def test_the_model_is_saved_as_unknown_and_compared_in_torque_alone(run, tmp_path):
    found = identify([run])
    assert all(own.model.estimates["inertia"].is_unknown for own in found.schemes.values())
    found.least_squares.save(tmp_path / "m.json")
    model = Model.load(tmp_path / "m.json")
    assert model.estimates["inertia"].is_unknown
    compared = compare(model, [run])
    assert np.isnan(compared.joint.errors.position_rms) and describe_unstable(compared)
    assert compared.joint.errors.torque_rms < 1.2 * compared.joint.noise_floor
    assert not any(np.isfinite(own.simulated_position).any() for own in compared.recordings)


def test_the_model_simulates_nothing():
    model = Model.build(BASE, [3e-5, 0.02, 0.05, 0.3], [4e-5, 0.001, 0.01, 0.01]).mark_unknown(["inertia"])
    with pytest.raises(ModelError, match="inertia"):
        model.simulate(0.01, np.zeros(10), 0.0, 0.0)
    with pytest.raises(ModelError, match="inertia"):
        make_plant(model=model)
    known = replace(
        model, estimates=model.estimates | {"inertia": replace(model.estimates["inertia"], is_unknown=False)}
    )
    assert np.isfinite(known.simulate(0.01, np.zeros(10), 0.0, 0.0).position).all()


def test_an_effect_is_judged_by_torque_alone(run):
    found = add(Model.build(BASE, [1e-4, 0.02, 0.05, 0.3]), "torque_offset", [run])
    assert found.objection is not None
    assert np.isnan(found.after.errors["holdout"].position_rms)
    shifted = replace(run, torque=run.torque + 0.02)
    added = add(Model.build(BASE, [1e-4, 0.02, 0.05, 0.3]), "torque_offset", [shifted])
    assert added.objection is None and "nan" not in describe_addition(added)
