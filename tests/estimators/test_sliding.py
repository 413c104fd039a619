"""A joint whose position is told in metres slides: masses, forces and metres, without a robot's file."""

import numpy as np
import pytest

from estimators import compare, diagnose, identify
from estimators.regression.least_squares import IdentificationError
from pendulum_env.physics import Model
from pendulum_env.recording import read_recording
from workbench.export import export

MASS, VISCOUS, COULOMB = 3.0, 12.0, 0.8
UNITS = {"inertia": "kg", "viscous": "N s/m", "coulomb": "N"}


@pytest.fixture(scope="module")
def carriage():
    """Recording of a carriage under forces of three frequencies [s, m, N]."""
    period, count = 0.004, 3000
    time = period * np.arange(count)
    force = 6.0 * np.sin(2.1 * time) + 5.0 * np.sin(7.3 * time + 1.0) + 4.0 * np.sin(17.9 * time)

    def slope(state, k):
        _, velocity = state
        return np.array([velocity, (force[k] - VISCOUS * velocity - COULOMB * np.tanh(velocity / 1e-3)) / MASS])

    state, path = np.zeros(2), np.empty((count, 2))
    for k in range(count):
        path[k] = state
        for _ in range(4):
            state = state + 0.25 * period * slope(state + 0.125 * period * slope(state, k), k)
    noise = np.random.default_rng(0).normal(size=(2, count))
    data = {"time": time, "x": 1e3 * path[:, 0] + 2e-3 * noise[0], "f": force + 0.02 * noise[1]}
    return read_recording(data, columns={"position": "x:mm", "torque": "f:N"})


def test_parameters_of_a_carriage_are_in_newtons_and_metres(carriage, tmp_path):
    found = identify(carriage, ["inertia", "viscous", "coulomb"])
    model = found.least_squares
    assert {name: own.unit for name, own in model.items()} == UNITS
    assert [float(own) for own in model.values()] == pytest.approx([MASS, VISCOUS, COULOMB], rel=0.03)
    model.save(tmp_path / "model.json")
    again = Model.load(tmp_path / "model.json")
    assert again.units() == carriage.units and {name: own.unit for name, own in again.items()} == UNITS
    program = export(again, "python").content
    assert "torque [N]" in program and "position: Value  # [m]" in program and "[rad" not in program
    units = compare(again, carriage).json()["units"]
    assert units == {"": {"position": "m", "torque": "N"}}


def test_no_effect_of_turns_is_looked_for_at_a_joint_that_slides(carriage):
    found = diagnose(carriage, base=["inertia", "viscous", "coulomb"], only=["cogging", "quadratic_drag", "spring"])
    assert {one.effect for one in found.candidates} == {"quadratic_drag", "spring"} and not found.selected
    assert '"rad' not in str(found.json()).replace("'", '"')
    with pytest.raises(IdentificationError, match="cogging"):
        diagnose(carriage, base=["inertia"], only=["cogging"])
