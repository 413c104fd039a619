from dataclasses import replace

import numpy as np
import pytest

from benchmarks.two_link import Multisine, TwoLink
from estimators import compare, identify
from estimators.regression.least_squares import IdentificationError
from estimators.schemes import six
from estimators.schemes.balance import adapt_to_arms
from estimators.schemes.identifiability import Gap, Undetermined, find_undetermined_links, find_unidentifiable
from estimators.schemes.six import PAPER, SCHEMES, Integral
from estimators.signals.measurements import measure_segments
from pendulum_env.physics import BASE, Model, ModelError
from pendulum_env.physics.joints import Links
from pendulum_env.recording import Recording
from robots.arms import arm_base, friction
from robots.arms.body import read_body
from robots.arms.model import ArmModel
from robots.arms.recording import ArmRecording
from tests.robots.arms.test_body import chain, written
from tests.two_link import record_arm

ARM = TwoLink()
RATE = 1000.0
LIVELY = {"scale": (5.0, 2.5), "counts": 1_024_000}  # the paper's encoder


@pytest.fixture(scope="module")
def recording():
    return record_arm(**LIVELY)


@pytest.fixture(scope="module")
def found(recording, body):
    return identify(recording, arm_base(body))


@pytest.fixture(scope="module")
def truth(body):
    return np.concatenate([body.values, np.ravel(np.column_stack([ARM.viscous, ARM.coulomb]))])


@pytest.mark.parametrize("scheme", adapt_to_arms(SCHEMES), ids=lambda scheme: scheme.id)
def test_each_scheme_finds_all_base_parameters_and_frictions_within_one_per_cent(found, truth, scheme):
    theta = found[scheme.id].model.theta
    some = np.abs(truth) > 1e-9
    assert np.abs(theta[some] / truth[some] - 1).max() < 0.01
    assert np.abs(theta[~some]).max() < 1e-3  # first moments across symmetric links [kg m]


def test_rows_that_are_summed_from_the_start_are_so_joint_by_joint(recording, body, truth):
    summed = six.scheme("dynamic", operator=Integral(window=None))
    model = identify(recording, arm_base(body), schemes=[summed])["dynamic"].model
    for name, true in zip(model.estimates, truth, strict=True):
        if name.startswith(("viscous", "coulomb")):
            own = model.estimates[name]
            assert abs(own.value - true) < 4 * own.std < 0.02


def test_with_the_momentum_of_the_dynamic_model_friction_is_as_the_dynamic_models(recording, body):
    paper = {scheme.id: scheme for scheme in PAPER}
    chosen = [paper[id] for id in ("dynamic", "filtered_dynamic", "hamiltonian", "filtered_hamiltonian")]
    found = identify(recording, arm_base(body), chosen)
    for one, other in (("hamiltonian", "dynamic"), ("filtered_hamiltonian", "filtered_dynamic")):
        assert np.allclose(found[one].model.theta, found[other].model.theta, rtol=1e-3, atol=1e-5)
    with pytest.raises(ValueError, match="put dynamic before it"):
        identify(recording, arm_base(body), [paper["hamiltonian"]])


def test_a_joint_that_sticks_is_left_out_of_its_own_row_alone(body, truth):
    still = replace(ARM, coulomb=(6.0, ARM.coulomb[1]))  # half of the time the shoulder sticks
    time = np.arange(0, 6, 1 / RATE)
    torque = Multisine.paper(3, (5.0, 2.5))
    position, velocity = still.simulate(torque, time)
    recording = ArmRecording.from_arrays("stuck", body.joints, time, position, torque.held(time, 1 / RATE))
    assert 0.3 < np.mean(velocity[:, 0] == 0) < 0.7
    found = identify(recording, arm_base(body), ("dynamic", "filtered_dynamic"))
    for one in found.schemes.values():
        assert one.model.estimates["coulomb@shoulder"].value == pytest.approx(6.0, rel=0.01)
        assert one.model.estimates["coulomb@elbow"].value == pytest.approx(ARM.coulomb[1], rel=0.01)


def test_torque_of_another_run_is_predicted(found, body, tmp_path):
    model = found["filtered_dynamic"].model
    other = record_arm(seed=7, seconds=5.0, **LIVELY)
    errors = compare(model, other).joint.errors
    assert max(errors.shares.values()) < 0.02
    wrong = ArmModel.build(model.terms, model.theta * np.where(np.arange(len(model.theta)) == 2, 1.2, 1.0))
    assert compare(wrong, other).joint.errors.joints["shoulder"] > 3 * errors.joints["shoulder"]
    model.save(path := tmp_path / "arm.json")
    assert np.array_equal(ArmModel.load(path, body).theta, model.theta)
    path.write_text(path.read_text().replace('"shoulder",', '"hip",'))
    with pytest.raises(ModelError, match=r"arm\.json: is of an arm with joints hip, elbow, not shoulder, elbow"):
        ArmModel.load(path, body)


def test_recordings_of_another_plant_are_refused(recording, body):
    with pytest.raises(TypeError, match=r"run 0: is of an arm with joints shoulder, elbow, and .* of a pendulum"):
        identify(recording)
    for other, joints in (
        (recording.joints[0], "a pendulum"),
        (replace(recording, names=("hip", "knee")), "hip, knee"),
    ):
        with pytest.raises(
            TypeError, match=f"is of .*{joints}, and the terms are of an arm with joints shoulder, elbow"
        ):
            identify(other, arm_base(body))
    with pytest.raises(ValueError, match="known of pendulums alone"):
        identify(recording, arm_base(body), fixed={"viscous@elbow": 0.3})


def test_an_arm_that_does_not_move_is_refused(body):
    time = np.arange(0, 3, 1 / RATE)
    torque = Multisine.paper(0, (5.0, 0.1))
    position = np.column_stack([np.sin(time), 0 * time])
    recording = ArmRecording.from_arrays("half", body.joints, time, position, torque.held(time, 1 / RATE))
    with pytest.raises(IdentificationError, match="joint 'elbow' never moves"):
        identify(recording, arm_base(body))


def test_a_parameter_that_the_motion_does_not_show_is_unknown(body, truth, tmp_path):
    time = np.arange(0, 4, 1 / RATE)
    slow = np.column_stack([0.4 * np.sin(1.5 * time), 0.3 * np.cos(2.0 * time)])  # next to no acceleration
    q, v, a = slow, np.gradient(slow, time, axis=0), np.gradient(np.gradient(slow, time, axis=0), time, axis=0)
    torque = body.torque(q, v, a) @ body.values + np.array(ARM.viscous) * v + np.array(ARM.coulomb) * np.sign(v)
    torque += 0.6 * np.random.default_rng(0).normal(size=q.shape)
    run = ArmRecording.from_arrays("poor", body.joints, time, q, torque)
    found = identify(run, arm_base(body), ("dynamic", "filtered_dynamic"))
    own = found["filtered_dynamic"]
    assert own.withheld == {"Iyy@shoulder", "Iyy@elbow", "mz@shoulder"}  # a slow pendulum is a spring against inertia
    assert Undetermined(Gap.LARGE_ERROR, ("Iyy@elbow", "Iyy@shoulder", "mz@shoulder")) in found.findings
    assert own.json()["theta"]["Iyy@elbow"]["value"] is None
    assert own.json()["theta"]["mz@elbow"]["value"] == pytest.approx(truth[body.names.index("mz@elbow")], rel=0.2)
    own.model.save(tmp_path / "arm.json")
    again = ArmModel.load(tmp_path / "arm.json", body).estimates
    assert {name for name, estimate in again.items() if estimate.text == "unknown"} == own.withheld


def test_a_pendulum_and_an_arm_of_one_joint_call_the_same_errors_unknown(tmp_path):
    rod = read_body(written(tmp_path, chain(1)))
    time = np.arange(0, 4, 1e-3)
    recording = Recording(time, np.sin(3 * time), 2.0 * np.sin(5 * time), name="swing")  # up to 3 rad/s and 2 N m
    measured, (q, v) = measure_segments(recording), (np.sin(3 * time)[:, None], 3 * np.cos(3 * time)[:, None])
    gravity = rod.names.index("mz@joint0")
    for errors, expected in (
        ((0.015, 1.9, 0.6, 1.9), set()),
        ((0.02, 1.9, 0.6, 1.9), {0}),
        ((0.015, 2.1, 0.6, 1.9), {1}),
        ((0.015, 1.9, 0.7, 2.1), {2, 3}),
    ):
        pendulum = Model.build(BASE, (0.05, 0.1, 0.1, 0.1), errors)
        told = {doubt.withheld[0] for doubt in find_unidentifiable(pendulum, measured)}
        assert told == {BASE[k].id for k in expected}
        theta, std = np.full(len(rod.base), 1e-3), np.zeros(len(rod.base))
        theta[rod.names.index("Iyy@joint0")], std[rod.names.index("Iyy@joint0")] = 0.05, errors[0]
        theta[gravity], std[gravity] = 0.1 / 9.81, errors[1] / 9.81
        arm = ArmModel.build((Links(rod), *friction(rod)), [*theta, 0.1, 0.1], [*std, *errors[2:]])
        names = ("Iyy@joint0", "mz@joint0", "viscous@joint0", "coulomb@joint0")
        assert set(find_undetermined_links(arm, q, v, recording.torque[:, None])) == {names[k] for k in expected}
