"""The machines of `benchmarks.mujoco_plant`: MuJoCo's equation of motion is the paper's, until something is hidden."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from benchmarks.mujoco_plant import DRIVES, LIBRARY, MACHINES, OUTSIDE, Plant, case, missed, simulate

SIZES = {"inertia": 0.03, "gravity": 1.2, "viscous": 0.02, "coulomb": 0.06}


@pytest.mark.parametrize("kind", MACHINES)
def test_with_nothing_hidden_least_squares_on_the_exact_motion_finds_the_plant(kind):
    machine = MACHINES[kind]
    true = [machine.inertia, machine.gravity, machine.viscous, machine.coulomb]
    run = simulate(Plant(kind, *true), "sines", 500.0, 4.0 / machine.pace, 100_000, 0.0, 1)
    q, v, a = run.exact
    use = np.abs(v) > 0.05 * np.abs(v).max()
    phi = np.column_stack([a, np.sin(q), v, np.sign(v)])[use]
    theta = np.linalg.lstsq(phi, run.command[use], rcond=None)[0]
    np.testing.assert_allclose(theta, true, rtol=1e-3, atol=1e-4 * max(true))


@pytest.mark.parametrize("name", [one for one in (*LIBRARY, *OUTSIDE) if one != "encoder_eccentricity"])
def test_what_is_hidden_changes_the_torque(name):
    """By more than the base model can make up for; of the encoder's own error the exact motion knows nothing."""
    plants = (Plant("direct drive", **SIZES, hidden=hidden, seed=3) for hidden in ((), (name,)))
    nothing, hidden = (missed(simulate(plant, "sines", 500.0, 4.0, 100_000, 0.0, 1)) for plant in plants)
    assert nothing < 1e-4 < 1e-3 < hidden


@pytest.mark.parametrize("drive", DRIVES)
def test_the_same_seed_gives_the_same_recording(drive):
    plant = Plant("servo", **{name: 0.05 * value for name, value in SIZES.items()})
    one, same, other = (simulate(plant, drive, 200.0, 1.0, 4096, 0.01, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.torque, same.torque)
    assert np.abs(one.torque - other.torque).max() > 0.01


def test_a_random_case_matters_and_its_held_out_run_is_another():
    _, run, held, entry = case(("stribeck",), 5)
    assert entry["effect_share"]["train"]["refit"] > 0.03
    assert not np.array_equal(run.command, held.command)
