import numpy as np
import pytest

from pendulum_env.recording import NoteKind, RecordingError, write_recording
from robots.arms import ArmRecording, find_logged_joints, read_arm_recording
from tests.notes import list_notes
from tests.options import options as options
from tests.pendulum_env.recording.test_files import moved

JOINTS = ("shoulder", "elbow")
TIME = np.arange(400) / 200
POSITION = np.column_stack([np.sin(3 * TIME), np.cos(5 * TIME)])
TORQUE = np.column_stack([np.cos(3 * TIME), np.sin(4 * TIME)])


ARM = {f"position_{joint}": q for joint, q in zip(JOINTS, POSITION.T, strict=True)}
ARM |= {f"torque_{joint}": tau for joint, tau in zip(JOINTS, TORQUE.T, strict=True)}


def table(path, **columns):
    names = ",".join(columns)
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=names, comments="")
    return path


def test_what_is_written_is_read(tmp_path):
    recording = ArmRecording.from_arrays("run", JOINTS, TIME, POSITION, TORQUE)
    write_recording(recording, tmp_path / "run.csv")
    again = read_arm_recording(tmp_path / "run.csv", JOINTS)
    assert np.array_equal(again.position, POSITION) and np.array_equal(again.torque, TORQUE)
    assert again.summary.endswith("400 samples, 2 joints")


@pytest.mark.parametrize("joints", [("Rotation", "A"), ("wrist_rot", "m"), ("deg", "mA")], ids=str)
def test_the_name_of_a_joint_is_no_unit(tmp_path, joints):
    """The first joint of the SO-100 is `Rotation`, and the rotary axes of machine tools are A, B and C."""
    recording = ArmRecording.from_arrays("run", joints, TIME, POSITION, TORQUE)
    write_recording(recording, tmp_path / "run.csv")
    again = read_arm_recording(tmp_path / "run.csv", joints)
    assert np.array_equal(again.position, POSITION) and np.array_equal(again.torque, TORQUE)
    in_degrees = {f"position_{joint} [deg]": np.degrees(q) for joint, q in zip(joints, POSITION.T, strict=True)}
    in_newton_metres = {f"torque_{joint}": tau for joint, tau in zip(joints, TORQUE.T, strict=True)}
    told = read_arm_recording(table(tmp_path / "told.csv", time=TIME, **in_degrees, **in_newton_metres), joints)
    assert np.allclose(told.position, POSITION)


def test_columns_of_an_arm_may_stand_behind_many_others_and_end_with_a_gap_of_all_joints(tmp_path):
    kept, others = np.r_[:150, 250:400], {f"other_{k}": TIME for k in range(100)}
    numbered = {f"{name.partition('_')[0]}_{1 + (k % 2)}": values for k, (name, values) in enumerate(ARM.items())}
    columns = {name: values[kept] for name, values in (others | {"time": TIME} | numbered).items()}
    recording = read_arm_recording(table(tmp_path / "run.csv", **columns), JOINTS)
    assert [len(segment) for segment in recording.segments] == [150, 150]
    assert np.allclose(recording.torque, TORQUE[kept])


@pytest.mark.parametrize(
    ("names", "joints"),
    [
        (("q_{}", "tau_{}"), ("shoulder_pan_joint", "elbow_joint")),
        (("{}/position", "{}/effort [Nm]"), JOINTS),
        (("{}_angle_deg", "measured torque {}"), JOINTS),
        (("position[{}]", "effort[{}]"), ("0", "1")),
        (("q{}", "tau{}"), ("a_1", "a_2")),  # numbers alone
        (("q_{}", "tau_{}"), ("lift", "A")),
    ],
    ids=str,
)
def test_spellings_of_a_pendulum_are_found_with_a_joint(tmp_path, names, joints):
    labels = [joint.removesuffix("_joint").removeprefix("a_") for joint in joints]
    unit = 180 / np.pi if "deg" in names[0] else 1.0
    columns = {names[0].format(label): unit * q for label, q in zip(labels, POSITION.T, strict=True)}
    columns |= {names[1].format(label): tau for label, tau in zip(labels, TORQUE.T, strict=True)}
    others = {"q_ref_x": TIME, "motor_current": TIME}
    path = table(tmp_path / "run.csv", time=TIME, **columns, **others)
    assert find_logged_joints(path, joints) == joints
    recording = read_arm_recording(path, joints)
    assert np.allclose(recording.position, POSITION) and np.allclose(recording.torque, TORQUE)


@pytest.mark.parametrize(
    ("joints", "numbers"),
    [
        (("joint_1", "joint_2"), (0, 1)),  # no joint has the number 0: in the order of the robot
        (("joint_2", "joint_3"), (1, 2)),
        (("joint_2", "joint_1"), (2, 1)),  # by the numbers of the joints, not in the order of the robot
    ],
    ids=str,
)
def test_numbers_are_joints_only_if_all_of_them_can_be(tmp_path, joints, numbers):
    columns = {f"position_{number}": q for number, q in zip(numbers, POSITION.T, strict=True)}
    columns |= {f"torque_{number}": tau for number, tau in zip(numbers, TORQUE.T, strict=True)}
    path = table(tmp_path / "run.csv", time=TIME, **columns)
    assert find_logged_joints(path, joints) == joints
    for held in ((), ("joint_1",), ("joint_4",)):
        recording = read_arm_recording(path, joints, held=set(held) - {*joints})
        assert np.allclose(recording.position, POSITION) and np.allclose(recording.torque, TORQUE)
        assert not recording.still


def test_numbers_of_some_joints_are_those_of_these_joints(tmp_path):
    joints = "joint_1", "joint_2", "joint_3"
    columns = {f"{joint}/position": q for joint, q in zip(joints[1:], POSITION.T, strict=True)}
    columns |= {f"{joint}/effort": tau for joint, tau in zip(joints[1:], TORQUE.T, strict=True)}
    path = table(tmp_path / "run.csv", time=TIME, **columns)
    assert find_logged_joints(path, joints) == joints[1:]
    recording = read_arm_recording(path, joints[1:], held=joints[:1])
    assert np.allclose(recording.position, POSITION) and np.allclose(recording.torque, TORQUE)


OFF = np.where(TIME < 0.6 * TIME[-1], np.nan, POSITION[:, 1])
ON = np.where(TIME > 0.5 * TIME[-1], np.nan, TORQUE[:, 0])


def test_rows_left_out_of_one_joint_are_left_out_of_all(tmp_path):
    hole = abs(TIME - 1.0) < 0.2
    columns = ARM | {"position_elbow": np.where(hole, np.nan, POSITION[:, 1])}
    recording = read_arm_recording(table(tmp_path / "run.csv", time=TIME, **columns), JOINTS)
    kept = ~hole
    assert recording.starts == (0, int(np.argmax(hole)))
    assert np.allclose(recording.position, POSITION[kept]) and np.allclose(recording.torque, TORQUE[kept])


@pytest.mark.parametrize("is_late", [False, True])
def test_joints_share_one_clock_whatever_each_of_them_shows(tmp_path, is_late):
    """Samples that jitter, or late stamps of uniform samples; one encoder repeats its value in three rows."""
    rng, uniform = np.random.default_rng(3), np.arange(0, 10, 1e-3)
    stamps = uniform + 1e-4 * rng.standard_normal(len(uniform))
    instants = uniform if is_late else stamps
    position = np.column_stack([np.sin(2 * instants), np.sin(7 * instants) + 0.4 * np.cos(3 * instants)])
    position[5000:5003, 1] = position[4999, 1]
    torque = {"torque_shoulder": np.cos(instants), "torque_elbow": np.sin(instants)}
    columns = {"position_shoulder": position[:, 0], "position_elbow": position[:, 1], **torque}
    recording = read_arm_recording(table(tmp_path / "run.csv", time=stamps, **columns), JOINTS)
    time = recording.time - recording.time[0] + instants[0]
    truth = np.column_stack([np.sin(2 * time), np.sin(7 * time) + 0.4 * np.cos(3 * time)])
    assert recording.rate == pytest.approx(1000, rel=1e-3)
    assert np.abs(recording.position - truth).max() < 2e-3
    assert any(note.kind is NoteKind.STALE and note.quantities == ("position_elbow",) for note in recording.notes)


@pytest.mark.parametrize(
    ("columns", "told", "why"),
    [
        (ARM | {"position_elbow": None}, {}, "2 joints need as many columns of position"),
        ({"position_1": TIME, "torque_1": TIME}, {}, "none for shoulder, elbow"),
        (ARM | {"position_knee": TIME}, {}, "column 'position_knee' is of no joint"),
        (ARM, {"torque_elbo": "x"}, "unknown column of the arm 'torque_elbo': did you mean torque_elbow"),
        (
            ARM | {"position_elbow": OFF, "torque_shoulder": ON},
            {},
            "only 0 rows have numbers of all joints",
        ),
        (ARM, {"torque_elbow": "torque_elbow:A*?"}, "'elbow' has no torque constant: .*'torque_elbow=torque_elbow:A"),
        (ARM, {"torque_elbow": "torque_elbow:A"}, r"torque_elbow=torque_elbow:A\*0.1' with the .* gear ratio$"),
        (ARM | {"position_elbow": 0 * TIME}, {}, "joint 'elbow': position_elbow is 0 rad in every row, so nothing can"),
        (
            ARM | {"position_wrist": np.nan * TIME},
            {},
            "column 'position_wrist' has no numbers: leave it out, --col",
        ),
        (ARM | {"position_wrist": TIME}, {"position_wrist": "position_wrist:mile"}, "'mile' of position is not known"),
    ],
)
def test_columns_that_do_not_fit_the_robot_and_what_is_wrong_with_one_joint_are_told(tmp_path, columns, told, why):
    columns = {"time": TIME} | {name: values for name, values in columns.items() if values is not None}
    with pytest.raises(RecordingError, match=why):
        read_arm_recording(table(tmp_path / "run.csv", **columns), JOINTS, held=("wrist",), columns=told)
    with pytest.raises(RecordingError, match="position of shape"):
        ArmRecording.from_arrays("run", JOINTS, TIME, POSITION[:, :1], TORQUE)


def test_what_is_noted_of_a_column_can_be_pasted_for_its_joint(tmp_path):
    time = np.arange(4000) / 200.0
    torque = 40 * np.sin(0.4 * time) * np.sin(2 * time)
    q = moved(torque, lambda t, q, v: 9.81 * q + 0.2 * v, start=1.0)  # on a spring: it could be degrees
    path = table(tmp_path / "run.csv", time=time, position_hip=q, torque_hip=torque)
    recording = read_arm_recording(path, ("hip",))
    assert "read it with --columns position_hip=position_hip:deg,torque_hip=torque_hip" in list_notes(recording)[-1]


def test_temperatures_of_some_joints_may_be_there(tmp_path):
    q, u, warm = POSITION[:, 0], TORQUE[:, 0], {"temperature_knee[degC]": 30 + TIME}
    angles, torques = {"position_hip": q, "position_knee": 2 * q}, {"torque_hip": u, "torque_knee": 3 * u}
    path = table(tmp_path / "warm.csv", time=TIME, **angles, **torques, **warm)
    recording = read_arm_recording(path, ("hip", "knee"))
    np.testing.assert_allclose(recording.temperature[:, 0], 25.0)  # nobody has measured it
    np.testing.assert_allclose(recording.temperature[:, 1], 30 + TIME, atol=1e-9)
    np.testing.assert_allclose(recording.split(0.5)[1].joints[1].temperature, 30 + TIME[200:], atol=1e-9)
    write_recording(recording, tmp_path / "again.csv")
    again = read_arm_recording(tmp_path / "again.csv", ("hip", "knee"))
    np.testing.assert_allclose(again.temperature, recording.temperature)


def test_runs_whose_clock_restarts_have_the_same_time_at_all_joints(tmp_path):
    """Empty cells of one joint about the restart leave the rows out of all joints."""
    time, run = np.concatenate([TIME, TIME]), np.repeat([1.0, 2.0], len(TIME))
    position, torque = np.concatenate([POSITION, POSITION]), np.concatenate([TORQUE, TORQUE])
    empty = np.abs(np.arange(len(time)) - len(TIME)) < 40
    columns = {"segment": run, "position_shoulder": position[:, 0], "torque_shoulder": torque[:, 0]}
    columns |= {"position_elbow": np.where(empty, np.nan, position[:, 1]), "torque_elbow": torque[:, 1]}
    recording = read_arm_recording(table(tmp_path / "run.csv", time=time, **columns), JOINTS)
    assert np.allclose(recording.position, position[~empty]) and len(recording.starts) == 2
