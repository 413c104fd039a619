"""Gains of motors, from what an arm is known to carry, or from joints whose torque is known."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import six_joint
from estimators import identify
from estimators.arms.gains import in_torque, without_loads
from estimators.regression.equations import IdentificationError
from pendulum_env.arms.body import read_body
from pendulum_env.arms.joints import arm_base
from pendulum_env.arms.recording import read_arm_recording
from pendulum_env.recording import RecordingError
from pendulum_env.recording.study import Carried
from tests.robots import Joint, simulate, urdf, write

GAINS = np.array([1.0, 9.0, 7.5, 3.2, 2.1, 1.4])  # [N m/A], the first unknown to none


@pytest.fixture(scope="module")
def logged():
    """The arm empty and with 2 kg at its flange, in amperes at all joints but the first."""
    weight = Carried(2.0, (0.03, 0.02, 0.09))
    load = six_joint.Load(weight.mass, weight.center, (1e-5, 1e-5, 1e-5))
    runs = [six_joint.simulate(1, seconds=8.0), six_joint.simulate(2, seconds=8.0, load=load)]
    currents = dict.fromkeys(six_joint.JOINTS[1:], "A")
    return [
        replace(run, torque=run.torque / GAINS, currents=currents, carried=carried)
        for run, carried in zip(runs, (None, weight), strict=True)
    ]


def test_a_known_weight_tells_the_gains_of_the_joints_that_feel_it(logged, six):
    found = in_torque(logged, six)
    assert set(six_joint.JOINTS[1:5]) <= set(found.gains)
    for joint, gain in found.gains.items():
        true = GAINS[six_joint.JOINTS.index(joint)]
        assert abs(gain.value - true) < max(4 * gain.std, 0.02 * true) and gain.unit == "N m/A"
    empty = found.recordings[0]
    assert not set(empty.currents) & set(found.gains)
    assert empty.torque[:, 1] == pytest.approx(logged[0].torque[:, 1] * found.gains["shoulder"].value)


def test_a_current_that_counts_the_other_way_round_is_said_to(logged, six):
    signs = np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    with pytest.raises(RecordingError, match="the known weight acts on joint 'elbow' with the other sign"):
        in_torque([replace(run, torque=run.torque * signs) for run in logged], six)


def test_one_joint_in_torque_tells_the_gains_of_those_that_move_the_same_links(logged, six):
    empty = logged[0]
    found = in_torque([empty], six)
    assert found.gains.keys() == set(six_joint.JOINTS[1:]) and not found.recordings[0].currents
    assert "the other joints tell it" in found.texts(six)[0]
    for joint, gain in found.gains.items():
        error = gain.value / GAINS[six_joint.JOINTS.index(joint)] - 1.0
        assert abs(error) < (0.05 if joint == "flange" else 0.015) and abs(error) < 4 * gain.std / gain.value
        assert gain.loads == 0
    scale = np.array([1.0, 60.0, 0.01, 0.5, 200.0, 30.0])
    (other,) = in_torque([replace(empty, torque=empty.torque * GAINS / scale)], six).recordings
    assert other.torque == pytest.approx(found.recordings[0].torque, rel=1e-6, abs=1e-9)


def test_joints_that_do_not_feel_the_same_links_tell_no_gains(logged, tmp_path, six):
    empty = logged[0]
    for signs, told in (
        ([1.0, 1.0, -1.0, 1.0, -1.0, 1.0], r"currents of elbow and pitch count .*: say -COLUMN for them$"),
        ([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0], "currents of shoulder, .* say -COLUMN for them, or for the joints in N m"),
    ):
        with pytest.raises(RecordingError, match=told):
            in_torque([replace(empty, torque=empty.torque * signs)], six)
    with pytest.raises(RecordingError, match=r"no gains let all joints feel the same links .*: say --rotors"):
        (tmp_path / "arm.urdf").write_text(six_joint.urdf())
        in_torque([empty], read_body(tmp_path / "arm.urdf", rotors=False))


def test_a_joint_that_shares_nothing_with_others_keeps_its_currents(tmp_path):
    """Two links about vertical axes and a quill that slides along them: it feels no mass that they tell."""
    quill = (
        Joint("shoulder", "", "0 0 1", "0 0 0.4", 4.0, "0.15 0.02 0.01", (0.02, 0.06, 0.07),
              viscous=0.8, coulomb=1.1, sweep=0.9),
        Joint("elbow", "shoulder", "0 0 1", "0.3 0 0", 2.0, "0.12 0.01 0.02", (0.01, 0.03, 0.03),
              viscous=0.4, coulomb=0.6, sweep=1.0),
        Joint("quill", "elbow", "0 0 1", "0.25 0 0", 1.2, "0 0 -0.1", (0.01, 0.01, 0.002), slides=True,
              viscous=40.0, coulomb=8.0, sweep=0.1),
    )  # fmt: skip
    (tmp_path / "arm.urdf").write_text(urdf(quill))
    body = read_body(tmp_path / "arm.urdf")
    write(simulate(quill, {}, seconds=8.0), tmp_path / "run.csv")
    recording = read_arm_recording(tmp_path / "run.csv", body.joints)
    found = in_torque([replace(recording, currents=dict.fromkeys(body.joints[1:], "A"))], body)
    assert [*found.gains] == ["elbow"] and found.gains["elbow"].value == pytest.approx(1.0, rel=0.02)
    assert [*found.recordings[0].currents] == ["quill"]


def test_where_every_torque_is_a_current_all_is_per_ampere_of_one_joint(logged, six):
    gains = GAINS * [2.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    currents = dict.fromkeys(six_joint.JOINTS, "A")
    alone = replace(logged[0], torque=logged[0].torque * GAINS / gains, currents=currents)
    found = in_torque([alone], six)
    assert found.unit == "A@shoulder" and found.gains.keys() == {*six_joint.JOINTS} - {
        "shoulder"
    }  # its links weigh most
    for joint, gain in found.gains.items():
        true = gains[six_joint.JOINTS.index(joint)] / GAINS[1]
        assert abs(gain.value - true) < min(4 * gain.std, 0.06 * true)
    assert "all are in A@shoulder" in found.texts(six)[0] and "A@shoulder/A" in found.texts(six)[1]
    model = identify(found.recordings[0], arm_base(six), "filtered_dynamic")["filtered_dynamic"].model
    torques = replace(logged[0], torque=logged[0].torque * GAINS, currents={})
    known = identify(torques, arm_base(six), "filtered_dynamic")["filtered_dynamic"].model
    assert model.torque_unit == "A@shoulder" and model.estimates["mx@elbow"].unit == "A@shoulder s^2/m"
    for name in ("mx@elbow", "Izz@base", "viscous@shoulder", "coulomb@elbow"):
        assert model.estimates[name].value * GAINS[1] == pytest.approx(known.estimates[name].value, rel=0.01)
    for unit in ("N m", "A@elbow_of_another"):  # a model in another unit
        (left,) = in_torque([alone], six, unit).recordings
        with pytest.raises(RecordingError, match="joint 'base': torque is in A, and nothing tells its gain: give it"):
            identify(left, arm_base(six))
    assert in_torque([alone], six, "A@elbow").unit == "A@elbow"
    with pytest.raises(RecordingError, match="current of joint 'shoulder' counts against the weight and inertia"):
        in_torque([replace(alone, torque=-alone.torque)], six)
    with pytest.raises(RecordingError, match="the known weight shows in no joint's current"):
        in_torque([alone, replace(alone, carried=Carried(2.0, (0.03, 0.02, 0.09)))], six)  # nothing hangs there


def test_the_bare_arm_is_that_of_fitted_and_held_out_recordings_together(logged):
    empty, loaded = logged
    heavier = replace(loaded, carried=Carried(3.0, loaded.carried.center))
    assert without_loads([empty, loaded], [empty, heavier]) == ([empty], [empty])
    assert without_loads([loaded, heavier]) == ([loaded], [])
    with pytest.raises(IdentificationError, match="every held-out recording has a known load, which is no part"):
        without_loads([empty], [loaded])
    with pytest.raises(IdentificationError, match="every fitted recording has a known load"):
        without_loads([loaded], [empty])


def test_gains_come_of_recordings_in_one_unit(logged, six):
    empty, loaded = logged
    known = replace(empty, torque=empty.torque * GAINS, currents={})  # in N m
    alone = in_torque([known, loaded], six)
    assert not alone.gains and alone.recordings[1].currents == loaded.currents
    milli = replace(loaded, name="milli", torque=loaded.torque * 1e3, currents=dict.fromkeys(loaded.currents, "mA"))
    with pytest.raises(RecordingError, match="milli: torque of joint 'shoulder' is in mA, and in A in"):
        in_torque([empty, milli], six)
    both = in_torque([known, empty, loaded], six)
    assert both.gains["shoulder"].value == pytest.approx(GAINS[1], rel=0.02)
