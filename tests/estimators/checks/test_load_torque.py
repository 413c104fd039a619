"""A load torque that was measured: it is known like a weight, and determines the torque constant of a current."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.checks.remedies import find_wrong_columns
from estimators.checks.torque_constant import UnknownConstant
from estimators.comparison import compare
from estimators.identification import identify
from estimators.schemes.six import SCHEMES
from pendulum_env.physics import BASE, KnownLoad, Model, effect
from pendulum_env.physics import simulate as fly
from pendulum_env.recording import Recording, RecordingError, read_recording
from tests.cases import diagnosed
from tests.terms import Table

K = 0.11  # [N m/A]
JOINT = {"inertia": 0.03, "gravity": 0.6, "viscous": 0.08, "coulomb": 0.1}


USUAL = {"excitation": "two_tone", "scale": 0.4, "rate": 500.0, "counts": 65_536, "torque_noise": 0.005}


def brake(amplitude=0.9, seconds=20.0, seed=0, **told) -> Recording:
    """Simulate a joint under a motor and a second motor whose torque is measured, by another simulator."""
    pushed = {"periodic_disturbance": {"dist_a": amplitude, "dist_w": 4.3, "dist_ph": 0.4}}
    about = Experiment(**USUAL | {"seconds": seconds, "seed": seed} | told)
    ((run),) = simulate([(Plant(**JOINT, effects=pushed), about)])
    noise = 0.005 * np.random.default_rng(seed).standard_normal(len(run.time))
    load = amplitude * np.sin(4.3 * run.time + 0.4) + noise
    return Recording(run.time, run.position, run.torque, load_torque=load, name="brake")


def in_amperes(recording: Recording, constant: float = K) -> Recording:
    return replace(recording, torque=recording.torque / constant, torque_unit="A")


def z_scores(model: Model) -> list[float]:
    return [(own.value - JOINT[name]) / own.std for name, own in model.estimates.items()]


@pytest.mark.parametrize("seed", [0, 1])
def test_a_load_torque_determines_the_torque_constant_of_one_recording(seed):
    found = identify([in_amperes(brake(seed=seed))], schemes=["dynamic"])
    constant = found.torque_constant
    assert abs(constant.value - K) < 3 * constant.std < 0.02 * K
    assert constant.unit == "N m/A" and constant.by_load_torque
    assert max(map(abs, z_scores(found["dynamic"].model))) < 4


@pytest.mark.parametrize("seed", [0, 1])
def test_a_brake_determines_the_torque_constant_too(seed):
    """A brake opposes the motion, as friction that grows with load does."""
    falling = {"friction_drift": {"drift_a": 6.0, "drift_T": 8.0, "drift_b": 0.0}}
    about = Experiment(**USUAL | {"scale": 0.6, "seconds": 20.0, "seed": seed})
    ((run),) = simulate([(Plant(**JOINT, effects=falling), about)])
    load = -6.0 * JOINT["coulomb"] * np.exp(-run.time / 8.0) * np.sign(np.gradient(run.position))
    recording = Recording(run.time, run.position, run.torque, load_torque=load, name="brake")
    constant = identify([in_amperes(recording)], schemes=["dynamic"]).torque_constant
    assert abs(constant.value - K) < 3 * constant.std < 0.05 * K


def test_without_or_with_a_constant_load_torque_the_constant_is_unknown():
    run = in_amperes(brake(seconds=10.0))
    for load in (None, np.full(len(run), 0.3)):
        with_less = identify([replace(run, load_torque=load)], schemes=["dynamic"])
        assert with_less.torque_constant is None


def test_all_schemes_take_a_load_torque_alike():
    run = brake(counts=None, rate=1000.0, torque_noise=0.0)
    run = replace(run, load_torque=0.9 * np.sin(4.3 * run.time + 0.4))
    found = identify([run])
    for scheme in SCHEMES:
        np.testing.assert_allclose(found[scheme.id].model.theta, list(JOINT.values()), rtol=1e-3, err_msg=scheme.id)


def test_a_load_torque_leaves_parameters_unbiased_and_nothing_missing():
    run = brake()
    found = diagnosed([run])
    assert not found.selected and not found.disagreements
    assert max(map(abs, z_scores(found.model))) < 4
    ignored = identify([replace(run, load_torque=None)], schemes=["dynamic"])["dynamic"].model
    assert abs(ignored.estimates["gravity"].value - JOINT["gravity"]) > 0.1 * JOINT["gravity"]


def test_free_running_simulation_is_driven_by_the_load_torque():
    run, model = brake(), Model.build(BASE, list(JOINT.values()))
    known, ignored = (compare(model, [own]).joint.errors for own in (run, replace(run, load_torque=None)))
    assert known.position_rms < 0.01 < 0.1 < ignored.position_rms
    assert known.torque_rms < 0.1 * ignored.torque_rms


def test_a_joint_without_a_motor_is_identified_by_the_torque_that_turns_it():
    run = brake(amplitude=1.5, scale=0.0, torque_noise=0.0)
    assert not run.torque.any()
    model = identify([run], schemes=["dynamic"])["dynamic"].model
    assert max(map(abs, z_scores(model))) < 4


def test_a_load_torque_of_the_wrong_sign_is_refused_where_a_current_was_logged():
    run = in_amperes(brake(seconds=10.0))
    found = identify([replace(run, load_torque=-run.load_torque)], schemes=["dynamic"])
    assert found.torque_constant is None
    assert any(
        isinstance(own, UnknownConstant) and own.constant is not None and own.by_load_torque for own in found.findings
    )


def test_the_opposite_sign_of_a_load_torque_is_reported(tmp_path):
    run = brake(seconds=10.0)
    right, wrong = (
        read_recording(write(tmp_path / "a.csv", time=run.time, q=run.position, tau=run.torque, load_torque=load))
        for load in (run.load_torque, -run.load_torque)
    )
    for recording, is_wrong in ((right, False), (wrong, True)):
        for found in (identify([recording], schemes=["dynamic"]), diagnosed([recording])):
            columns = [remedy.columns for finding in found.findings for remedy in finding.remedies]
            assert any(own.get("load_torque") == "-load_torque" for own in columns) == is_wrong


@pytest.mark.parametrize("law", ["viscous", "coulomb", "gravity"])
def test_noise_of_a_sensor_does_not_turn_a_load_torque_that_the_model_explains(law):
    share = 0.5 * JOINT[law]
    about = Experiment(**USUAL | {"counts": 1_024_000, "seconds": 10.0, "seed": 1})
    ((run),) = simulate([(Plant(**JOINT | {law: JOINT[law] + share}), about)])
    velocity = np.gradient(run.position, run.time)
    columns = {"viscous": velocity, "coulomb": np.sign(velocity), "gravity": np.sin(run.position)}
    for seed in range(4):
        noise = 0.02 * np.random.default_rng(seed).standard_normal(len(run.time))
        recording = Recording(run.time, run.position, run.torque, load_torque=noise - share * columns[law])
        found = identify([recording], schemes=["dynamic"])
        assert not find_wrong_columns(found["dynamic"].model, [recording])


@pytest.mark.parametrize("terms", [BASE, (*BASE, Table())])  # a simulation of a table is not compiled
def test_a_simulation_under_a_load_torque_is_that_under_the_sum_of_both(terms):
    theta = np.array([0.03, 0.6, 0.08, 0.1, *[1.0] * (len(terms) - len(BASE))])
    n = np.arange(500)
    torque, load = 0.8 * np.sin(0.03 * n), np.column_stack([0.5 * np.cos(0.05 * n), 0.2 * np.sin(0.01 * n)])
    known = KnownLoad(torque=load)
    both = fly(terms, theta, 2e-3, torque, 0.1, 0.0, load=known).position
    summed = fly(terms, theta, 2e-3, torque[:, None] + load, 0.1, 0.0).position
    np.testing.assert_allclose(both, summed, atol=1e-9)


def test_a_delay_of_the_command_does_not_delay_the_load_torque():
    n = np.arange(500)
    late, load = effect("dead_time")(0.01), 0.5 * np.cos(0.05 * n)[:, None]
    theta = np.array([0.03, 0.6, 0.08, 0.1])
    delayed = fly((*BASE, late), theta, 1e-3, np.zeros(500), 0.1, 0.0, load=KnownLoad(torque=load)).position
    at_once = fly(BASE, theta, 1e-3, load[:, 0], 0.1, 0.0).position
    np.testing.assert_allclose(delayed, at_once, atol=1e-12)


def write(path: Path, **columns) -> Path:
    header = ",".join(columns)
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=header, comments="", fmt="%.9g")
    return path


def test_a_load_torque_on_an_uneven_clock_is_interpolated_at_its_instants(tmp_path):
    run = brake(seconds=6.0)
    time = run.time + 2e-5 * np.random.default_rng(0).uniform(-1, 1, len(run))
    smooth = np.sin(4.3 * time)
    motion = {"time": time, "q": np.interp(time, run.time, run.position), "tau": run.torque}
    read = read_recording(write(tmp_path / "uneven.csv", **motion, load_torque=smooth))
    np.testing.assert_allclose(read.load_torque, np.sin(4.3 * (read.time + time[0])), atol=1e-4)


def test_usual_names_of_a_load_torque_are_known():
    run = brake(seconds=2.0)
    motion = {"time": run.time, "q": run.position}
    for name in ("load_torque", "tau_load", "dyno_torque", "torque_load", "tau_load_Nm"):
        both = read_recording({**motion, "tau": run.torque, name: run.load_torque})
        np.testing.assert_allclose(both.load_torque, run.load_torque)
        alone = read_recording({**motion, name: run.torque})
        np.testing.assert_allclose(alone.torque, run.torque)
        assert alone.load_torque is None


def test_a_torque_that_was_measured_twice_counts_once(tmp_path):
    run = brake(amplitude=0.0, seconds=4.0)
    motion = {"time": run.time, "q": run.position, "torque_cmd": run.torque}
    sensor = run.torque + 0.01 * np.random.default_rng(0).standard_normal(len(run))
    read = read_recording({**motion, "torque_sensor": sensor})
    assert read.load_torque is None
    inertia = identify([read], schemes=["dynamic"])["dynamic"].model.estimates["inertia"]
    assert inertia.value == pytest.approx(0.03, rel=0.05)
    path = write(tmp_path / "a.csv", **motion, load_torque=sensor)
    with pytest.raises(RecordingError, match="'load_torque': 'none'"):
        read_recording(path)
    assert read_recording(path, columns={"load_torque": "none"}).load_torque is None
    assert read_recording(path, columns={"load_torque": "load_torque"}).load_torque is not None


def test_beside_a_current_a_load_torque_is_not_taken_for_the_torque(tmp_path):
    run = brake(seconds=2.0)
    path = write(tmp_path / "a.csv", time=run.time, q=run.position, current=run.torque / K, load_torque=run.torque)
    with pytest.raises(ValueError, match="current"):
        read_recording(path)
    read = read_recording(path, columns={"torque": "current:A*?", "load_torque": "-load_torque:mNm"})
    np.testing.assert_allclose(read.load_torque, -1e-3 * run.torque, atol=1e-6)
