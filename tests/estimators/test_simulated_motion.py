"""`simulate`: a model under a torque moves as by an independent integrator, and wrong arguments are explained."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from estimators import compare, identify, simulate
from pendulum_env.errors import UserError
from pendulum_env.physics import BASE, Gravity, Inertia, Model, ModelError, Viscous
from pendulum_env.plant import PAPER, hide, paper_plant
from pendulum_env.units import JointUnits
from robots.arms import arm_base
from robots.arms.body import parse_body
from robots.arms.env import PlanarArm
from robots.arms.model import ArmModel
from tests.runge_kutta import simulate_stick_slip

INERTIA, GRAVITY, VISCOUS = 0.0895, 2.01, 0.3638
SMOOTH = Model.build((Inertia(), Gravity(), Viscous()), [INERTIA, GRAVITY, VISCOUS])
PAPER_MODEL = Model.build(BASE, list(PAPER.values()))


def sway(t: float) -> float:
    return 3.0 * np.sin(12.07 * t) + 3.0 * np.sin(2.25 * t)


def integrate(torque: np.ndarray, rate: float, start: tuple[float, float]) -> np.ndarray:
    """Position and velocity (2, N) of the pendulum without dry friction, period by period with DOP853."""
    states = [np.array(start)]
    for tau in torque[:-1]:
        slope = lambda t, x, tau=tau: [x[1], (tau - GRAVITY * np.sin(x[0]) - VISCOUS * x[1]) / INERTIA]  # noqa: E731
        states.append(solve_ivp(slope, (0.0, 1.0 / rate), states[-1], method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1])
    return np.array(states).T


@pytest.mark.parametrize(("rate", "start"), [(1000.0, (0.0, 0.0)), (100, (1.0, -3.0)), (37.0, (3.0, 0.5))])
def test_a_pendulum_with_viscous_friction_moves_as_by_another_integrator(rate, start):
    torque = np.array([sway(k / rate) for k in range(round(3 * rate))])
    run = simulate(SMOOTH, torque, rate, position=start[0], velocity=start[1])
    position, velocity = integrate(torque, rate, start)
    np.testing.assert_allclose(run.position, position, atol=5e-5)  # second order in steps of 1 ms
    np.testing.assert_allclose(run.velocity, velocity, atol=5e-4)
    np.testing.assert_array_equal(run.torque, torque)
    np.testing.assert_allclose(run.time, np.arange(len(torque)) / rate, rtol=1e-14)
    assert list(run.columns) == ["time", "position", "torque", "velocity"] and run.rate == pytest.approx(rate)


def test_a_function_of_time_is_the_array_of_its_samples():
    by_function = simulate(SMOOTH, sway, 250, seconds=2.0, name="sway")
    by_array = simulate(SMOOTH, [sway(k / 250) for k in range(500)], 250)
    np.testing.assert_array_equal(by_function.position, by_array.position)
    assert by_function.name == "sway" and len(by_function) == 500
    steps = simulate(SMOOTH, lambda t: 1.0 if t < 0.5 else 0.0, 100, seconds=1.0)
    assert steps.torque.tolist() == [1.0] * 50 + [0.0] * 50


def test_dry_friction_sticks_as_by_another_integrator():
    torque = np.array([sway(k / 500) for k in range(1500)])
    position, velocity, _ = simulate_stick_slip(
        lambda t, q, v, u: u - GRAVITY * np.sin(q) - VISCOUS * v, lambda *_: PAPER["coulomb"], INERTIA, torque, 1 / 500
    )
    run = simulate(PAPER_MODEL, torque, 500)
    np.testing.assert_allclose(run.position, position[:-1], atol=5e-5)
    np.testing.assert_allclose(run.velocity, velocity[:-1], atol=2e-3)
    held = simulate(PAPER_MODEL, np.full(100, 0.9), 100)  # less than dry friction
    assert not held.position.any() and not held.velocity.any()


def test_what_is_simulated_is_identified_and_leaves_no_residual():
    plant = hide(paper_plant(), "stribeck=0.4")
    run = simulate(plant, sway, 500, seconds=10.0)
    assert identify(simulate(PAPER_MODEL, sway, 500, seconds=10.0))["energy"].model.theta == pytest.approx(
        list(PAPER.values()), rel=2e-3
    )
    assert compare(plant, run).errors.torque_rms < 0.02 < 5 * compare(PAPER_MODEL, run).errors.torque_rms


def test_the_torque_is_in_the_unit_of_the_model_and_of_a_result():
    model = identify(simulate(PAPER_MODEL, sway, 500, seconds=10.0))
    assert simulate(model, np.ones(10), 100).torque_unit == "N m"
    in_amperes = PAPER_MODEL.convert_units(JointUnits("A"))
    assert simulate(in_amperes, np.ones(10), 100).torque_unit == "A"


@pytest.mark.parametrize(
    ("arguments", "options", "error", "says"),
    [
        ((BASE, np.ones(9), 100), {}, TypeError, "is not a model"),
        ((SMOOTH, np.ones(9), 0), {}, UserError, "rate cannot be 0: give a number above zero"),
        ((SMOOTH, np.ones(9), "1 kHz"), {}, TypeError, "rate='1 kHz': give a number"),
        ((SMOOTH, np.ones(9), 100), {"position": np.nan}, UserError, "position cannot be nan: give a finite number"),
        ((SMOOTH, np.ones((9, 2)), 100), {}, UserError, r"torque has the shape \(9, 2\)"),
        ((SMOOTH, [1.0], 100), {}, UserError, r"torque has the shape \(1,\): .* two or more samples"),
        ((SMOOTH, [1.0, np.inf], 100), {}, UserError, "torque is inf at sample 1: give finite numbers"),
        ((SMOOTH, ["a", "b"], 100), {}, TypeError, "give an array of numbers, or a function of time"),
        ((SMOOTH, sway, 100), {}, UserError, "give its duration, seconds=10.0"),
        ((SMOOTH, sway, 1e6), {"seconds": 1e3}, UserError, "give a shorter time"),
        ((SMOOTH, np.ones(9), 100), {"seconds": 2.0}, UserError, "leave seconds out"),
        ((SMOOTH, np.ones(9), 100), {"velosity": 1.0}, ValueError, "did you mean velocity"),
        ((Model.build((Gravity(), Viscous()), [2.0, 0.3]), np.ones(9), 100), {}, ModelError, "lacks the term inertia"),
        ((SMOOTH.mark_unknown(["inertia"]), np.ones(9), 100), {}, ModelError, "the inertia is unknown"),
    ],
)
def test_wrong_arguments_are_explained(arguments, options, error, says):
    with pytest.raises(error, match=says):
        simulate(*arguments, **options)


def test_an_arm_is_refused():
    with pytest.raises(UserError, match="an arm has no motion to simulate here"):
        simulate(ArmModel(arm_base(parse_body(PlanarArm().urdf))), np.ones(9), 100)
