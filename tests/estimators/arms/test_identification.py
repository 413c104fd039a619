from dataclasses import replace

import numpy as np
import pytest

from benchmarks.two_link import Multisine, TwoLink
from estimators.arms.balance import VIEWS, measure_arm, rows
from estimators.arms.identification import ARM_SCHEMES, compare_arm, identify_arm
from estimators.regression.equations import IdentificationError
from estimators.regression.recursive import start, step
from estimators.schemes.six import PAPER
from pendulum_env.arms.joints import Links, friction
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import ModelError

ARM = TwoLink()
RATE = 1000.0
ENCODER = 2 * np.pi / 1_024_000  # the paper's


def run(seed, seconds=10.0, noise=0.02):
    time = np.arange(0, seconds, 1 / RATE)
    torque = Multisine.paper(seed, (5.0, 2.5))
    position, _ = ARM.simulate(torque, time)
    position = np.round(position / ENCODER) * ENCODER
    measured = torque.held(time, 1 / RATE)
    measured += noise * np.random.default_rng(seed).normal(size=measured.shape)
    return ArmRecording.of(f"run {seed}", ("shoulder", "elbow"), time, position, measured)


@pytest.fixture(scope="module")
def recording():
    return run(0)


@pytest.fixture(scope="module")
def found(recording, body):
    return identify_arm(recording, body)


@pytest.fixture(scope="module")
def truth(body):
    return np.concatenate([body.values, np.ravel(np.column_stack([ARM.viscous, ARM.coulomb]))])


@pytest.mark.parametrize("scheme", ARM_SCHEMES, ids=lambda scheme: scheme.id)
def test_each_scheme_finds_all_base_parameters_and_frictions_within_one_per_cent(found, truth, scheme):
    theta = found[scheme.id].model.theta
    some = np.abs(truth) > 1e-9
    assert np.abs(theta[some] / truth[some] - 1).max() < 0.01
    assert np.abs(theta[~some]).max() < 1e-3  # first moments across symmetric links [kg m]


def test_standard_errors_are_those_of_the_errors(found, truth):
    for scheme in ("dynamic", "filtered_dynamic", "hamiltonian", "energy"):
        model = found[scheme].model
        std = np.array([estimate.std for estimate in model.estimates.values()])
        assert np.all(np.abs(model.theta - truth) < 4 * std)


def test_the_hamiltonian_pair_equals_the_dynamic_pair(found):
    filtered, dynamic = found["filtered_hamiltonian"].model, found["filtered_dynamic"].model
    assert np.allclose(filtered.theta, dynamic.theta, rtol=1e-9)
    assert np.allclose(found["hamiltonian"].model.theta, found["dynamic"].model.theta, rtol=2e-4, atol=1e-5)


def test_with_the_momentum_of_the_dynamic_model_friction_is_as_the_dynamic_models(recording, body):
    paper = {scheme.id: scheme for scheme in PAPER}
    chosen = [paper[id] for id in ("dynamic", "filtered_dynamic", "hamiltonian", "filtered_hamiltonian")]
    found = identify_arm(recording, body, schemes=chosen)
    for one, other in (("hamiltonian", "dynamic"), ("filtered_hamiltonian", "filtered_dynamic")):
        assert np.allclose(found[one].model.theta, found[other].model.theta, rtol=1e-3, atol=1e-5)
    with pytest.raises(ValueError, match="put dynamic before it"):
        identify_arm(recording, body, schemes=[paper["hamiltonian"]])


def test_the_recursion_ends_at_the_batch_estimate(found):
    for one in found.schemes.values():
        assert np.allclose(one.convergence.theta[-1], one.model.theta, rtol=1e-4, atol=1e-5)
        assert len(one.convergence.time) > 100


def test_the_papers_recursion_takes_the_rows_one_by_one(recording, body):
    (m,) = measure_arm(recording)
    equations = rows(m, (Links(body), *friction(body)), VIEWS["impulse"])
    clear = [joint.clear(0.02) for joint in m]
    state = start(equations[0].phi.shape[1])
    for k in range(2, 3000):
        for own, usable in zip(equations, clear, strict=True):
            if usable[k]:
                state = step(state, own.phi[k], own.y[k])
    assert np.allclose(state.theta[[1, 2, 4, 5]], body.values[[1, 2, 4, 5]], rtol=0.02)


def test_a_joint_that_sticks_is_left_out_of_its_own_row_alone(body, truth):
    still = replace(ARM, coulomb=(6.0, ARM.coulomb[1]))  # half of the time the shoulder sticks
    time = np.arange(0, 6, 1 / RATE)
    torque = Multisine.paper(3, (5.0, 2.5))
    position, velocity = still.simulate(torque, time)
    recording = ArmRecording.of("stuck", body.joints, time, position, torque.held(time, 1 / RATE))
    assert 0.3 < np.mean(velocity[:, 0] == 0) < 0.7
    found = identify_arm(recording, body, schemes=ARM_SCHEMES[:2])
    for one in found.schemes.values():
        assert one.model.estimates["coulomb@shoulder"].value == pytest.approx(6.0, rel=0.01)
        assert one.model.estimates["coulomb@elbow"].value == pytest.approx(ARM.coulomb[1], rel=0.01)


def test_torque_of_another_run_is_predicted(found, body, tmp_path):
    model = found["filtered_dynamic"].model
    errors = compare_arm(model, run(7, 5.0))
    assert all(error.share < 0.02 for error in errors)
    wrong = ArmModel.build(model.terms, model.theta * np.where(np.arange(len(model.theta)) == 2, 1.2, 1.0))
    assert compare_arm(wrong, run(7, 5.0))[0].torque_rms > 3 * errors[0].torque_rms
    model.save(tmp_path / "arm.json")
    assert np.array_equal(ArmModel.load(tmp_path / "arm.json", body).theta, model.theta)


def test_a_model_of_another_arm_is_refused(found, body, tmp_path):
    path = tmp_path / "arm.json"
    found["dynamic"].model.save(path)
    path.write_text(path.read_text().replace('"shoulder",', '"hip",'))
    with pytest.raises(ModelError, match=r"arm\.json: is of an arm with joints hip, elbow, not shoulder, elbow"):
        ArmModel.load(path, body)


def test_an_arm_that_does_not_move_is_refused(body):
    time = np.arange(0, 3, 1 / RATE)
    torque = Multisine.paper(0, (5.0, 0.1))
    position = np.column_stack([np.sin(time), 0 * time])
    recording = ArmRecording.of("half", body.joints, time, position, torque.held(time, 1 / RATE))
    with pytest.raises(IdentificationError, match="joint 'elbow' never moves"):
        identify_arm(recording, body)
