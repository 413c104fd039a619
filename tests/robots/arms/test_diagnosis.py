"""Effects at joints: data from MuJoCo and from SciPy, neither of which shares code with what is tested."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from benchmarks import six_joint
from benchmarks.six_joint import Hidden
from benchmarks.two_link import TwoLink
from estimators import add, compare, diagnose
from estimators.data.fit_data import FitData
from estimators.diagnosis.conclusion import NoKnownEffect
from estimators.diagnosis.unexplained import HeldOutResidual
from estimators.findings import Verdict
from estimators.regression.least_squares import IdentificationError
from pendulum_env.physics.actuation import TorqueOffset
from pendulum_env.physics.friction import Stribeck, TemperatureDependentFriction
from pendulum_env.physics.potential import Cogging, Spring
from robots.arms import arm_base
from robots.arms.carried_payload import CarriedPayload
from robots.arms.conclusion import MissingRotors
from robots.arms.model import ArmModel
from robots.arms.recording import ArmRecording
from tests.two_link import record_arm

SOME = {"stribeck": Stribeck, "cogging": Cogging}
THREE = six_joint.JOINTS[:3]
RUBS = (1.0,) * len(THREE)


@pytest.fixture(scope="module")
def three():
    """The arm of the first three joints."""
    return six_joint.body(THREE)


def error_at(joint, step):
    return step.errors["holdout"].joints[joint]


def test_torque_of_all_joints_that_was_sampled_is_late_by_half_a_sample():
    """A log of every fifth row, whose torque went on changing until the next; noise is most of it at the last joint."""
    n = 4
    plain = six_joint.simulate(1, seconds=12.0, rubs=[1.0] * n)
    every = slice(None, None, 5)
    sparse = ArmRecording.from_arrays(
        "sparse", plain.names, plain.time[every], plain.position[every], plain.torque[every]
    )
    base = arm_base(six_joint.body(six_joint.JOINTS[:n]))
    given = FitData((sparse,), terms=base).with_timing()
    (law,) = given.timing.alignments
    assert law.channel.is_sampled and law.delay == pytest.approx(2.5 / plain.rate, abs=0.6 / plain.rate)
    assert not FitData((plain,), terms=base).with_timing().timing.has_moved
    (mended,) = given.recordings
    acted = plain.torque[: 5 * len(sparse)].reshape(-1, 5, n).mean(axis=1)
    first = round(mended.time[0] * sparse.rate)
    off = mended.torque - acted[first : first + len(mended)]
    had = (sparse.torque - acted)[first : first + len(mended)]
    assert np.all(np.std(off, axis=0)[:3] < 0.5 * np.std(had, axis=0)[:3])


def test_late_torque_of_one_joint_is_corrected_alone(body):
    plain, late = record_arm(seed=3, seconds=8.0, rate=500.0), 6
    torque = plain.torque.copy()
    torque[late:, 1] = plain.torque[:-late, 1]
    logged = replace(plain, torque=torque)
    given = FitData((logged,), terms=arm_base(body)).with_timing()
    (law,) = given.timing.alignments
    assert law.joint == "elbow" and law.delay == pytest.approx(late / plain.rate, abs=0.1 / plain.rate)
    (corrected,) = given.recordings
    rows = slice(late, len(corrected))
    np.testing.assert_array_equal(corrected.torque[rows, 0], plain.torque[rows, 0])
    off = (own.torque[rows, 1] - plain.torque[rows, 1] for own in (corrected, logged))
    assert np.divide(*map(np.std, off)) < 0.1


def test_torque_of_an_arm_is_timed_again_beside_what_was_found(body):
    """Gears that rub under load hide that torque is late; beside their friction it shows, and nothing is left."""
    plain, share = record_arm(seed=0, seconds=8.0, rate=500.0), 0.4
    drives = plain.torque * np.gradient(plain.position, 1 / plain.rate, axis=0) > 0
    asked = np.where(drives, plain.torque / (1 - share), plain.torque / (1 + share))  # of motors behind such gears
    late = replace(plain, torque=np.roll(asked, 1, axis=0)).slice(1, None)
    assert not FitData((late,), terms=arm_base(body)).with_timing().timing.has_moved
    found = diagnose(late, (), arm_base(body), only=["load_dependent_friction", "cogging"])
    rubs = {f"load_dependent_friction@{joint}" for joint in ("shoulder", "elbow")}
    assert set(found.selected) == rubs and not found.joint_residuals
    assert found.alignments[0].delay == pytest.approx(1 / plain.rate, abs=1.5e-4)
    for name in rubs:
        assert found.model.estimates[name].value == pytest.approx(share, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 4])
def test_rotors_that_the_robot_file_lacks_are_identified(n):
    """Rotors of the first two joints are part of the links' parameters."""
    joints, lacking = six_joint.JOINTS[2:n], replace(six_joint.body(six_joint.JOINTS[:n]), rotors=False)
    found = diagnose(six_joint.simulate(3, rubs=[1.0] * n, seconds=10.0), (), arm_base(lacking))
    assert set(found.selected) == {f"rotor@{joint}" for joint in joints} and not found.joint_residuals
    (missing,) = found.findings
    assert isinstance(missing, MissingRotors) and set(missing.joints) == set(joints) and found.no_experiment is None
    for joint, value in zip(joints, six_joint.ROTORS[2:], strict=False):
        estimate = found.model[f"rotor@{joint}"]
        assert abs(estimate.value - value) < 4 * estimate.std


@pytest.mark.slow
def test_a_missing_rotor_is_a_finding_beside_the_next_step_until_the_user_adds_it():
    """Ripple at the elbow stays unexplained."""
    lacking = replace(six_joint.body(six_joint.JOINTS[:3]), rotors=False)
    recording = six_joint.simulate(3, Hidden("cogging", 2, 2.0), rubs=[1.0] * 3, seconds=10.0)
    missing = MissingRotors((six_joint.JOINTS[2],))
    first = diagnose(recording, (), arm_base(lacking), only=["rotor"])
    assert missing in first.findings and first.joint_residuals
    second = diagnose(recording, (), first.model.terms, only=["rotor"])
    assert second.findings == () and second.joint_residuals
    for found in (first, second):
        assert isinstance(found.no_experiment, NoKnownEffect)


HEAVY = replace(TwoLink(), mass=(1.2, 1.1), inertia=(0.02, 0.012))  # with 0.3 kg at the forearm's centre of mass


@pytest.mark.parametrize(("fitted", "unseen"), [((0,), (4,)), ((0, 4), ()), ((4,), (0,))])
def test_a_payload_in_some_recordings_is_identified_and_the_arm_is_found_without_it(body, fitted, unseen):
    runs = [
        [record_arm(HEAVY if seed == 4 else TwoLink(), seed=seed, rate=500.0) for seed in part]
        for part in (fitted, unseen)
    ]
    found = diagnose(*runs, arm_base(body), library=SOME)
    (payload,), (tried,) = found.findings, found.treatments
    assert isinstance(payload, CarriedPayload) and payload == tried.treatment and tried.is_kept
    assert payload.recordings == ("run 4",) and payload.joint == "elbow"
    mass, place = payload.mass, payload.center["z"]
    assert abs(mass.value - 0.3) < 4 * mass.std < 0.01 and abs(place.value + 0.15) < 4 * place.std < 0.01
    for joint in body.joints:
        assert payload.torque_rms[joint].after.value < 0.1 * payload.torque_rms[joint].before.value
    assert found.selected == () and not found.joint_residuals and found.no_experiment is None
    for name, value in zip(body.names, body.values, strict=True):
        estimate = found.model.estimates[name]
        assert abs(estimate.value - value) < max(4 * estimate.std, 1e-3), name


@pytest.mark.parametrize("friction", [TwoLink.viscous, (0.25, 0.25)])
def test_recordings_that_agree_or_differ_in_friction_show_no_payload(body, friction):
    other = replace(TwoLink(), viscous=friction)
    found = diagnose(
        *(record_arm(*own, rate=500.0) for own in ((TwoLink(), 0), (other, 1))), arm_base(body), library=SOME
    )
    assert found.treatments == found.findings == () and found.selected == ()
    if friction == TwoLink.viscous:
        assert not found.joint_residuals and found.no_experiment is None
    else:
        assert set(found.joint_residuals) == set(body.joints)
        assert found.no_experiment == HeldOutResidual(("run 1",))
        assert all(region.held_out_recordings == ("run 1",) for region in found.unexplained)


@pytest.mark.slow
@pytest.mark.parametrize("is_held_out", [True, False])
def test_a_payload_of_an_arm_of_six_joints_is_identified_beside_an_effect(six, is_held_out):
    load, hidden = six_joint.Load(2.4, (0.05, -0.03, 0.04), (0.004, 0.003, 0.0035)), Hidden("cogging", 2)
    empty = replace(six_joint.simulate(1, hidden, seconds=8.0), name="empty")
    full = replace(six_joint.simulate(2, hidden, seconds=8.0, load=load), name="full")
    fitted, unseen = ([empty], [full]) if is_held_out else ([empty, full], [])
    found = diagnose(fitted, unseen, arm_base(six), library=SOME)
    payload = next(own for own in found.findings if isinstance(own, CarriedPayload))
    assert payload.recordings == ("full",) and found.selected == ("cogging@elbow",) and not found.joint_residuals
    assert payload.mass.value == pytest.approx(2.4, rel=0.01)
    assert [payload.center[axis].value for axis in "xyz"] == pytest.approx(load.center, abs=1e-3)


@pytest.mark.slow
def test_different_payloads_are_identified_each_and_warmer_friction_is_none(three):
    load, other = (six_joint.Load(m, (0.05, -0.03, 0.04), (0.003, 0.003, 0.003)) for m in (2.6, 1.2))
    runs = [
        replace(six_joint.simulate(k, seconds=8.0, load=own, rubs=RUBS), name=f"run {k}")
        for k, own in ((1, None), (2, load))
    ]
    last = replace(six_joint.simulate(3, seconds=8.0, load=other, rubs=RUBS), name="run 3")
    found = diagnose(runs, last, arm_base(three), library=SOME)
    masses = {own.recordings: own.mass.value for own in found.findings if isinstance(own, CarriedPayload)}
    assert masses == {("run 2",): pytest.approx(2.6, rel=0.01), ("run 3",): pytest.approx(1.2, rel=0.01)}
    warm = replace(six_joint.simulate(2, seconds=8.0, rubs=[0.7] * len(THREE)), name="warm")
    found = diagnose(runs[:1], warm, arm_base(three), library=SOME)
    assert found.joint_residuals and not found.treatments


def test_an_effect_is_named_at_its_joint_and_the_error_falls(six):
    found = diagnose(six_joint.simulate(5, Hidden("cogging", 2), seconds=12.0), (), arm_base(six), library=SOME)
    assert found.selected == ("cogging@elbow",)
    estimates = found.model.estimates
    size = np.hypot(estimates["cogging.sin@elbow"].value, estimates["cogging.cos@elbow"].value)
    assert estimates["cogging.order@elbow"].value == 14
    assert size == pytest.approx(0.35 * six_joint.COULOMB[2], rel=0.05)
    assert error_at("elbow", found.steps[-1]) < 0.5 * error_at("elbow", found.steps[0])
    assert found.candidates[0].verdict is Verdict.SELECTED and found.candidates[0].score > 0.9


@pytest.mark.slow
def test_friction_by_temperature_is_named_where_it_is_measured_and_told_per_kelvin(three):
    hidden = Hidden("temperature_dependent_friction", 2)
    recording = six_joint.simulate(6, hidden, seconds=12.0, thermometers=True, rubs=RUBS)
    some = SOME | {TemperatureDependentFriction.id: TemperatureDependentFriction}
    found = diagnose(recording, (), arm_base(three), library=some)
    assert found.selected == ("temperature_dependent_friction@elbow",)
    for part, share in (("viscous", six_joint.VISCOUS_SHARE), ("coulomb", six_joint.COULOMB_SHARE)):
        own = found.model.derived[f"temperature_dependent_friction.{part}_share@elbow"]
        assert own.unit == "%/K"
        assert own.value == pytest.approx(100 * share, abs=4 * own.std) and own.std < 0.1 * abs(own.value)
    unmeasured = diagnose(replace(recording, temperature=None), (), arm_base(three), library=some)
    assert unmeasured.selected == () and "elbow" in unmeasured.joint_residuals


def test_noise_of_an_encoder_that_is_not_white_is_left_unexplained(body):
    run = record_arm(rate=500.0, scale=(5.0, 2.5), noise=0.0)
    wander = lfilter(*butter(4, 15.0, fs=500.0), np.random.default_rng(0).normal(size=run.position.shape), axis=0)
    noisy = replace(run, position=run.position + 4e-3 * wander / wander.std())
    base = arm_base(body)
    plain, found = (diagnose(recording, (), base, library={"stribeck": Stribeck}) for recording in (run, noisy))
    assert plain.joint_residuals == {} and plain.findings == found.findings == ()
    assert found.selected == () and found.joint_residuals


def test_a_law_that_no_effect_is_can_be_kept_as_a_table_of_its_joint(three, tmp_path):
    recording = six_joint.simulate(7, Hidden("cable", 2, share=0.6), seconds=12.0, rubs=RUBS)
    found = diagnose(recording, (), arm_base(three), library={"stribeck": Stribeck})
    assert found.selected == () and "elbow" in found.joint_residuals
    assert found.tables == ("torque_by_angle@elbow",) and found.no_experiment == NoKnownEffect(found.tables)
    assert [one.axis for one in found.unexplained if one.at == "elbow"] == ["position"]
    added = add(found.model, "torque_by_angle@elbow", recording)
    after = error_at("elbow", added.after)
    assert added.objection is None
    assert after < 0.5 * error_at("elbow", added.before)
    unhidden = six_joint.simulate(1, seconds=5.0, rubs=RUBS)
    assert after < 1.3 * compare(found.model, unhidden).joint.errors.joints["elbow"]
    added.after.model.save(path := tmp_path / "model.json")
    again = ArmModel.load(path, three)
    assert again.terms[1:] == added.after.model.terms[1:] == pickle.loads(pickle.dumps(again.terms[1:]))
    assert compare(again, recording).joint.errors == compare(added.after.model, recording).joint.errors


@pytest.mark.slow
def test_where_no_weight_acts_a_table_may_be_a_line(three):
    recording = six_joint.simulate(6, Hidden("spring", 0, share=0.6), seconds=12.0, rubs=RUBS)
    found = diagnose(recording, (), arm_base(three), library={"stribeck": Stribeck})
    assert found.tables == ("torque_by_angle@base",)
    model = add(found.model, found.tables[0], recording).after.model
    *_, table = model.terms
    curve = table.curve(np.array([model.estimates[column.name].value for column in table.columns]))
    slope = np.polyfit(curve.x, curve.value, 1)[0]
    assert slope == pytest.approx(0.6 * six_joint.COULOMB[0], rel=0.03)


def test_effects_at_two_joints_are_named_and_every_effect_is_told_once(body):
    run = record_arm(offset=(0.4, 0.3))
    found = diagnose(run, (), arm_base(body), library={"torque_offset": TorqueOffset, "spring": Spring})
    assert set(found.selected) == {"torque_offset@shoulder", "torque_offset@elbow"}
    told = [candidate.effect for candidate in found.candidates]
    assert len(told) == len(set(told)) and set(told[:2]) == set(found.selected)
    for candidate in found.candidates[:2]:  # judged in the final model, as by its score: without this one alone
        others = tuple(own for own in found.model.terms if own.id != candidate.effect)
        added = add(ArmModel(others), candidate.effect, run)
        joint = candidate.effect.partition("@")[2]
        ratio = error_at(joint, added.after) / error_at(joint, added.before)
        assert candidate.error_ratio == pytest.approx(ratio, rel=0.5)  # other windows
        assert candidate.reason.joint == joint
        assert candidate.reason.ratio == candidate.error_ratio


def test_shape_parameters_have_standard_errors_that_cover_the_truth_and_are_kept(body, tmp_path):
    run = record_arm()
    velocity = np.gradient(run.position[:, 1], 1e-3)
    rubbing = 0.4 * np.exp(-((velocity / 0.5) ** 2)) * np.sign(velocity)
    logged = run.torque + np.column_stack([np.zeros_like(rubbing), rubbing])
    found = diagnose(replace(run, torque=logged), (), arm_base(body), library={"stribeck": Stribeck})
    assert found.selected == ("stribeck@elbow",)
    speed = found.model.estimates["stribeck.stribeck_velocity@elbow"]
    assert 0.0 < speed.std < 0.1 * speed.value and abs(speed.value - 0.5) < 4 * speed.std
    found.model.save(tmp_path / "arm.json")
    assert ArmModel.load(tmp_path / "arm.json", body).estimates == found.model.estimates


@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_a_joint_without_a_motor_hides_nothing_of_others(body, offset):
    driven = record_arm(scale=(3.5, 0.0), offset=(offset, 0.0), rate=500.0)
    let_go = replace(driven, torque=driven.torque * [1.0, 0.0])
    found = diagnose(let_go, (), arm_base(body), library={"torque_offset": TorqueOffset, "spring": Spring})
    assert found.selected == (("torque_offset@shoulder",) if offset else ()) and not found.unexplained
    shares = found.steps[-1].errors["holdout"].shares
    assert shares["shoulder"] < 0.01 and shares["elbow"] is None


def test_a_joint_that_hardly_moves_is_told(body):
    time = np.arange(0, 10, 1e-3)
    position = np.column_stack([np.sin(3 * time), 0.01 * (time > 5)])
    recording = ArmRecording.from_arrays("half", body.joints, time, position, np.cos(3 * time)[:, None] * np.ones(2))
    with pytest.raises(IdentificationError, match="joint 'elbow' is rarely clear of stick"):
        diagnose(recording, (), arm_base(body))
