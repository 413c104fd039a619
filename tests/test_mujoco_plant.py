"""The machines of `benchmarks.mujoco_plant`: MuJoCo's equation of motion is the paper's, until something is hidden."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from benchmarks.mujoco_plant import LIBRARY, MACHINES, OUTSIDE, Plant, missing_share, simulate

SIZES = {"inertia": 0.03, "gravity": 1.2, "viscous": 0.02, "coulomb": 0.06}


def solved(run, *more):
    """Least squares on the exact motion: inertia, gravity, viscous, coulomb, and what else is asked for by angle."""
    q, v, a = run.exact
    use = np.abs(v) > 0.05 * np.abs(v).max()
    phi = np.column_stack([a, np.sin(q), v, np.sign(v), *(law(q) for law in more)])[use]
    return np.linalg.lstsq(phi, run.command[use], rcond=None)[0]


def hiding(*hidden, seconds=4.0):
    """A run of the direct drive with something hidden."""
    return simulate(Plant("direct drive", **SIZES, hidden=hidden, seed=3), "sines", 500.0, seconds, 100_000, 0.0, 1)


@pytest.mark.parametrize("kind", MACHINES)
def test_with_nothing_hidden_least_squares_on_the_exact_motion_finds_the_plant(kind):
    machine = MACHINES[kind]
    true = [machine.inertia, machine.gravity, machine.viscous, machine.coulomb]
    run = simulate(Plant(kind, *true), "sines", 500.0, 4.0 / machine.pace, 100_000, 0.0, 1)
    np.testing.assert_allclose(solved(run), true, rtol=1e-3, atol=1e-4 * max(true))


@pytest.fixture(scope="module")
def nothing() -> float:
    return missing_share(hiding())


@pytest.mark.parametrize("name", [one for one in (*LIBRARY, *OUTSIDE) if one != "encoder_eccentricity"])
def test_what_is_hidden_changes_the_torque(name, nothing):
    """By more than the base model can make up for; of the encoder's own error the exact motion knows nothing."""
    assert nothing < 1e-4 < 1e-3 < missing_share(hiding(name))


def test_a_tilted_base_pulls_with_the_cosine_of_the_angle():
    theta = solved(hiding("gravity_tilt"), np.cos)
    assert np.hypot(theta[1], theta[4]) == pytest.approx(SIZES["gravity"], rel=1e-3)
    assert abs(theta[4]) == pytest.approx(SIZES["gravity"] * np.sin(0.12), rel=1e-2)
