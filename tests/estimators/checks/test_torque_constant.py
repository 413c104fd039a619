"""Known loads: they are no part of the model, and tell the torque constant where a current was logged."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.checks.channel import estimate_alignment
from estimators.checks.torque_constant import GearLosses, UnknownConstant, estimate_torque_constant, find_gain_doubts
from estimators.comparison import compare
from estimators.data.fit_data import FitData
from estimators.diagnosis.addition import add
from estimators.identification import identify
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.six import SCHEMES
from estimators.weak_form.preparation import prepare_windows
from pendulum_env.physics import BASE, Estimate, KnownLoad, Model, ModelError, effect
from pendulum_env.physics import simulate as fly
from pendulum_env.recording import Load, Recording
from pendulum_env.recording.channel import TorqueConstant
from tests.cases import diagnosed

K = 0.873  # [N m/A]
UNLOADED = {"inertia": 0.03, "gravity": 0.6, "viscous": 0.15, "coulomb": 0.25}
ARMS = [(0.0, 0.2), (0.3, 0.1), (0.3, 0.2), (0.5, 0.15), (0.5, 0.2), (0.8, 0.15), (0.8, 0.2), (1.0, 0.2)]  # [kg], [m]
LOADS = [Load(m * r * r, 9.81 * m * r) for m, r in ARMS]
HELD = {"excitation": "pd_loop", "rate": 200.0, "counts": 16_384, "gains": (25.0, 1.0), "torque_limit": 10.0}


def bench(law="none", loads=LOADS, seed=0, seconds=10.0, **told: float) -> list[Recording]:
    """Currents of a servo on a bench with known loads, by another simulator; each load is another plant to it."""
    cases = []
    for k, load in enumerate(loads):
        weight = UNLOADED["gravity"] + load.gravity
        friction = {
            "motor": {"load_mu": 0.12},
            "both": {"load_mu": 0.12, "load_w": weight},
            "output": {"load_out": 0.12 * weight},
        }
        effects = {"load_dependent_friction": friction[law]} if law in friction else {}
        of_both = {"inertia": UNLOADED["inertia"] + load.inertia, "gravity": weight}
        usual = HELD | {"seconds": seconds, "seed": 100 * seed + k, "torque_noise": 0.005}
        cases.append((Plant(**UNLOADED | of_both, effects=effects), Experiment(**usual | told)))
    return [
        Recording(run.time, run.position, run.torque / K, load=load, torque_unit="A", name=f"load {k}")
        for k, (load, run) in enumerate(zip(loads, simulate(cases), strict=True))
    ]


def in_newton_metres(recordings: list[Recording]) -> list[Recording]:
    return [replace(recording, torque=K * recording.torque, torque_unit="N m") for recording in recordings]


# ------------------------------------------------------------------------------------------ torque is torque


EXACT = {"excitation": "two_tone", "rate": 1000.0, "counts": None, "torque_noise": 0.0, "scale": 0.5}
THREE = (LOADS[0], LOADS[2], LOADS[4])


def test_all_schemes_find_it_from_a_current_alike():
    found = identify(bench("none", THREE, **EXACT))
    assert found.torque_constant.value == pytest.approx(K, rel=1e-4)
    for scheme in SCHEMES:
        theta = found[scheme.id].model.theta
        np.testing.assert_allclose(theta, list(UNLOADED.values()), rtol=3e-4, err_msg=scheme.id)


def test_a_simulation_with_a_load_is_that_of_a_heavier_pendulum():
    theta, load = np.array([0.03, 0.6, 0.15, 0.25]), KnownLoad(np.array([0.0, 0.02]), np.array([0.0, 0.9]))
    torque = 2 * np.sin(0.03 * np.arange(2000))
    both = fly(BASE, theta, 1e-3, torque, 0.0, 0.0, load=load).position
    light, heavy = (fly(BASE, theta + more, 1e-3, torque, 0.0, 0.0).position for more in (0, [0.02, 0.9, 0, 0]))
    np.testing.assert_allclose(both, np.hstack([light, heavy]), atol=1e-12)


# ----------------------------------------------------------------------------------------- torque is a current


@pytest.mark.parametrize("law", ["none", "motor", "both", "output"])
def test_the_torque_constant_is_right_whatever_friction_does_under_load(law):
    found = estimate_torque_constant(bench(law))
    if law == "both":  # |i + w sin q| is no sum of what presses from either side, and the error says so
        assert abs(found.value - K) < 3 * found.std < 0.2 * K
    else:
        assert found.value == pytest.approx(K, rel=0.005)
        assert found.std < 0.005 * K
    assert found.loads == len(LOADS)


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_friction_by_the_torque_of_the_motor_leaves_the_torque_constant_exact(scale):
    """The torque changes its sign within windows, where the mean of |tau| is not that of the mean torque."""
    found = estimate_torque_constant(bench("motor", THREE, seed=1, **EXACT | {"scale": scale}))
    assert found.value == pytest.approx(K, rel=1e-5)


def test_friction_under_known_loads_is_told_from_a_delay():
    found = estimate_alignment(in_newton_metres(bench("output", THREE, seed=4)))
    assert not found.is_found and found.delay_std < 1e-4


def test_what_a_voltage_and_a_motor_that_always_drives_leave_open_is_said():
    (run,) = bench(loads=LOADS[2:3], seconds=5.0)
    always = replace(run, torque=np.sign(np.gradient(run.position)), torque_unit="V")
    model = Model.build(BASE, list(UNLOADED.values()))
    one_number, back_emf = find_gain_doubts(model, TorqueConstant(0.5, 0.01, "V", 2), prepare_windows([always]))
    assert isinstance(one_number, GearLosses) and one_number.share == 1.0
    assert back_emf.constant.value == pytest.approx(0.3)  # 0.15 N m s/rad of viscous friction over 0.5 N m/V
    assert find_gain_doubts(model, TorqueConstant(0.5, 0.01, "A", 2), prepare_windows([run])) == []


def test_two_loads_are_enough_and_a_recording_without_one_is_a_load_of_none():
    """Of one recording that differs from others: left out, nothing would be known, which is no scatter."""
    light, heavy = bench(loads=(LOADS[0], LOADS[6]))
    found = estimate_torque_constant([replace(light, load=None), heavy])
    assert found == estimate_torque_constant([light, heavy])
    some = [bench(loads=[LOADS[k]], seed=seed, seconds=5.0)[0] for seed, k in enumerate((6, 6, 6, 0))]
    for constant in (found, estimate_torque_constant(some)):
        assert constant.value == pytest.approx(K, rel=0.01)


def test_standard_errors_of_the_torque_constant_are_honest():
    z = []
    for seed in range(8):
        found = estimate_torque_constant(bench(loads=THREE, seed=seed, seconds=5.0, counts=None))
        z.append((found.value - K) / found.std)
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.8


def test_without_loads_that_differ_all_is_in_amperes_and_a_finding_says_why():
    one, other = (replace(recording, load=LOADS[3]) for recording in bench(loads=(LOADS[3],), seed=0)[:1] * 2)
    for runs, why in (
        ([one, other], UnknownConstant("A", loads=1)),
        ([replace(one, load=None)], UnknownConstant("A", loads=0)),
    ):
        found = identify(runs)
        assert estimate_torque_constant(runs) == why and why in found.findings
        assert found.torque_constant is None and found.torque_unit == "A"
        for result in found.schemes.values():
            assert [e.unit for e in result.model.estimates.values()] == ["A s^2", "A", "A s/rad", "A"]
            gravity = result.model.estimates["gravity"].value
            assert gravity == pytest.approx((UNLOADED["gravity"] + LOADS[3].gravity) / K, rel=0.02)
        assert [found[id].unit for id in ("dynamic", "energy", "filtered_power")] == ["A", "A rad", "A rad/s"]
        assert "N m" not in json.dumps(found.json()).replace("N m/A", "")


def test_what_tells_no_torque_constant_is_said():
    light, heavy = runs = bench(loads=(LOADS[0], LOADS[6]))
    still = replace(heavy, position=np.zeros(len(heavy)), velocity=None)
    assert estimate_torque_constant([light, still]) == UnknownConstant("A", loads=2, moved=1)
    more = estimate_torque_constant([*runs, replace(still, load=LOADS[3])])
    assert more.value == pytest.approx(estimate_torque_constant(runs).value, rel=1e-3)
    barely = Load(LOADS[3].inertia + 1e-5, LOADS[3].gravity + 1e-3)
    first, second = bench(loads=(LOADS[3], LOADS[3]))
    uncertain = estimate_torque_constant([first, replace(second, load=barely)])
    assert isinstance(uncertain, UnknownConstant) and uncertain.inverse is not None
    turned = estimate_torque_constant([replace(run, torque=-run.torque) for run in runs])
    assert isinstance(turned, UnknownConstant) and turned.constant.value < 0
    with pytest.raises(IdentificationError, match="torque is in A in load 0 and in N m in load 1: read all recordings"):
        identify([light, replace(heavy, torque_unit="N m")])


@pytest.mark.slow
def test_errors_of_parameters_include_that_of_the_torque_constant():
    runs = bench(loads=(LOADS[0], LOADS[6]))
    found, known = identify(runs, schemes="dynamic"), identify(in_newton_metres(runs), schemes="dynamic")
    own, given = found["dynamic"].model.estimates, known["dynamic"].model.estimates
    assert all(own[name].std >= 0.99 * given[name].std for name in own)
    wide = FitData.from_recordings(runs)
    loose = replace(wide.recordings[0].torque_constant, std=0.05 * K)
    widened = identify([replace(r, torque_constant=loose) for r in wide.recordings], schemes="dynamic")["dynamic"]
    # I = K phi - dI: of a fit to a light and a heavy recording, an error of K moves inertia by more than its share
    assert widened.model.estimates["inertia"].std > 0.05 * UNLOADED["inertia"]
    stds = [estimate.std for estimate in widened.model.estimates.values()]
    np.testing.assert_allclose(widened.convergence.std[-1], stds, rtol=1e-9)


@pytest.mark.slow
def test_a_diagnosis_in_amperes_names_friction_under_load_and_finds_the_joint():
    found = diagnosed(bench("motor", seconds=7.0))
    assert found.selected == ("load_dependent_friction",)
    assert found.torque_constant.value == pytest.approx(K, rel=0.01)
    theta = {name: e.value for name, e in found.model.estimates.items()}
    for name, value in UNLOADED.items():
        assert theta[name] == pytest.approx(value, rel=0.03), name
    assert theta["load_dependent_friction"] == pytest.approx(0.12, rel=0.05)
    constant = Estimate(found.torque_constant.value, found.torque_constant.std, "N m/A")
    assert Model.from_json(found.model.json()).torque_constant == constant


def test_friction_that_is_pressed_by_the_load_itself_takes_each_load_into_account():
    """Its weight is that of the joint alone: known loads add their own."""
    runs = in_newton_metres(bench("output", (LOADS[0], LOADS[3], LOADS[7])))
    equations = prepare_windows(runs).equations((*BASE, effect("load_dependent_friction")(UNLOADED["gravity"])))
    columns = [0, 1, 2, 3, 5]  # without friction by what the motor presses
    theta = np.linalg.lstsq(equations.phi[:, columns], equations.y, rcond=None)[0]
    np.testing.assert_allclose(theta, [*UNLOADED.values(), 0.12], rtol=0.03)


def test_an_effect_is_added_under_known_loads():
    found = add(Model.build(BASE, list(UNLOADED.values())), "load_dependent_friction", bench("motor", LOADS[:6:2]))
    assert found.findings == () and found.objection is None
    assert found.model.torque_constant.value == pytest.approx(K, rel=0.01)
    assert found.model.estimates["load_dependent_friction"].value == pytest.approx(0.12, rel=0.05)


# -------------------------------------------------------------------------------------- models and their units


def test_a_model_turns_the_current_of_other_recordings_into_torque():
    runs = bench()
    model = replace(Model.build(BASE, list(UNLOADED.values())), torque_constant=Estimate(K, 0.002, "N m/A"))
    found = compare(model, runs[2])
    assert found.torque_constant == TorqueConstant(K, 0.002, "A")
    assert found.joint.errors.torque_rms < 1.3 * found.joint.noise_floor
    with pytest.raises(IdentificationError, match="the recordings are in A with an unknown torque constant"):
        compare(replace(model, torque_constant=None), runs[2])
    assert compare(replace(model, torque_constant=None), runs[:3]).torque_constant.loads == 3


def test_a_model_per_ampere_is_compared_with_currents_only(tmp_path):
    run = replace(bench()[0], load=None)
    model = identify(run, schemes="dynamic")["dynamic"].model
    model.save(tmp_path / "model.json")
    assert Model.load(tmp_path / "model.json") == model
    found = compare(model, run)
    assert found.torque_unit == "A" and "N m" not in json.dumps(found.json())
    with pytest.raises(ModelError, match="the model is per A, and the recordings are in N m: read them alike"):
        compare(model, in_newton_metres([run]))
