"""What a user chooses and fixes, and what is told of fits: percent, covariance, unstable stretches."""

from dataclasses import replace

import numpy as np
import pytest

from estimators import add, compare, diagnose, identify
from estimators.data.fits import fit_terms
from estimators.data.model_errors import compute_errors
from estimators.data.regression_data import RegressionData
from estimators.simulation.free_running import compute_deviation, compute_growth, select_segments
from pendulum_env.backends import record
from pendulum_env.errors import UserError
from pendulum_env.excitation import excitation
from pendulum_env.physics import BASE, Model
from pendulum_env.plant import make_plant, paper_plant
from pendulum_env.recording import Recording
from workbench.narrator.diagnosis import describe_unstable


def run(seed: int = 1, seconds: float = 6.0, plant: Model | None = None, torque_noise: float = 0.02) -> Recording:
    rng = np.random.default_rng(seed)
    return record(plant, excitation("paper", 1, seconds), seconds, 500.0, rng=rng, torque_noise=torque_noise)


@pytest.fixture(scope="module")
def days():
    plant = make_plant(effects="stribeck")
    return [record(plant, excitation("paper", k, 8.0), 8.0, 500.0, rng=k) for k in (1, 2)]


def test_only_what_is_asked_for_is_looked_for(days):
    found = diagnose(*days, only=["stribeck", "quadratic_drag", "cogging"], without=["cogging"])
    assert found.selected == ("stribeck",)
    assert {candidate.effect for candidate in found.candidates} == {"stribeck", "quadratic_drag"}
    with pytest.raises(ValueError, match="did you mean stribeck"):
        diagnose(*days, only=["stribek"])
    with pytest.raises(UserError, match="no effect is left"):
        diagnose(*days, only=["stribeck"], without=["stribeck"])


def test_what_is_known_is_kept_and_the_rest_is_recovered_beside_it(days):
    found = diagnose(*days, only=["stribeck"], fixed={"gravity": 2.01}, bounds={"stribeck": (0.0, 0.44)})
    told = found.model.estimates
    assert (told["gravity"].value, told["gravity"].std) == (2.01, 0.0)
    assert told["stribeck"].value == 0.44  # 0.45 is hidden
    assert abs(told["inertia"].value - 0.0895) < 5e-5


@pytest.mark.parametrize("scheme", ["dynamic", "energy", "filtered_hamiltonian"])
def test_schemes_keep_what_is_known_and_stay_within_bounds(scheme):
    one = run(seconds=8.0)
    free = identify(one, schemes=scheme)[scheme].model.estimates
    told = identify(one, schemes=scheme, fixed={"inertia": 0.0895}, bounds={"viscous": (0.0, 0.3)})[scheme].model
    assert (told.estimates["inertia"].value, told.estimates["inertia"].std) == (0.0895, 0.0)
    assert told.estimates["viscous"].value == 0.3 and told.estimates["coulomb"].value > free["coulomb"].value
    known = identify(one, schemes=scheme, fixed={"viscous": 0.3638})[scheme].model.estimates
    assert known["coulomb"].std < 0.8 * free["coulomb"].std  # the two are told apart by speed alone
    assert abs(known["coulomb"].value - 0.9163) < 4 * known["coulomb"].std


def test_add_takes_limits_too(days):
    added = add(Model.build(BASE, 0.1), "stribeck", *days, fixed={"gravity": 2.01}, bounds={"stribeck": (0.0, 0.3)})
    assert added.model.estimates["gravity"].value == 2.01
    assert added.model.estimates["stribeck"].value == pytest.approx(0.3)


def test_fit_in_percent_is_relative_to_what_there_was_to_explain():
    prepared = RegressionData.from_recordings([run()])
    errors = compute_errors(prepared, paper_plant({"gravity": 1.0}))
    assert errors.torque_fit == pytest.approx(100 * (1 - errors.torque_rms / np.std(prepared.data.torque.recorded)))
    assert errors.position_fit == pytest.approx(100 * (1 - errors.position_rms / compute_deviation(prepared.segments)))


def test_correlations_are_those_of_repeated_fits():
    runs = [run(k, 4.0, torque_noise=0.1) for k in range(40)]
    models = [fit_terms(RegressionData.from_recordings([one]), BASE)[0] for one in runs]
    seen = np.corrcoef(np.array([model.theta for model in models]).T)
    told = np.mean([model.correlation for model in models], axis=0)
    assert seen[2, 3] < -0.5
    np.testing.assert_allclose(told, seen, atol=0.35)


def test_growth_of_an_error_upright_is_that_of_the_linear_equation():
    (segments,) = RegressionData.from_recordings([run()]).segments
    rest = {name: np.zeros_like(getattr(segments, name)) for name in ("position", "velocity", "torque")}
    upright = replace(segments, **rest | {"position": rest["position"] + np.pi})
    theta = np.array([0.0895, 2.01, 0.0, 0.0])
    expected = np.cosh(np.sqrt(2.01 / 0.0895) * (len(segments.position) - 1) / 500.0)
    np.testing.assert_allclose(compute_growth(upright, BASE, theta), expected, rtol=1e-3)
    hanging = replace(upright, position=rest["position"])
    assert (compute_growth(hanging, BASE, theta) < 1.01).all()
    some = np.arange(len(segments.first)) % 2 == 0
    np.testing.assert_array_equal(
        compute_growth(select_segments(upright, some), BASE, theta), compute_growth(upright, BASE, theta)[some]
    )


def test_windows_with_the_arm_upright_are_not_counted():
    time = np.arange(0, 10, 0.002)
    model = paper_plant({"viscous": 0.05, "coulomb": 0.0})
    lift = np.pi / 2 * (1 + np.tanh(2 * (time - 5)))  # hangs for five seconds, then stands
    position = lift + 0.3 * np.sin(5 * time) + 0.2 * np.sin(8 * time)
    velocity, acceleration = np.gradient(position, time), np.gradient(np.gradient(position, time), time)
    torque = 0.0895 * acceleration + 2.01 * np.sin(position) + 0.05 * velocity
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(time))
    recording = Recording(time, position, torque + noise, name="lifted")
    held, lifted = compare(model, recording), RegressionData.from_recordings([recording])
    assert 0.3 < held.joint.unstable < 0.6 and "small error grows tenfold" in str(describe_unstable(held))
    assert held.json()["joint"]["unstable"] == held.joint.unstable
    assert held.joint.errors.position_rms < 0.5 * compute_errors(lifted, model).position_rms
    assert describe_unstable(compare(paper_plant(), run())) is None
