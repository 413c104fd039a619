import numpy as np
import pytest

from pendulum_env.arms.recording import ArmRecording, read_arm_recording
from pendulum_env.recording import RecordingError, write_recording

JOINTS = ("shoulder", "elbow")
TIME = np.arange(400) / 200
POSITION = np.column_stack([np.sin(3 * TIME), np.cos(5 * TIME)])
TORQUE = np.column_stack([np.cos(3 * TIME), np.sin(4 * TIME)])


def table(path, **columns):
    names = ",".join(columns)
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=names, comments="")
    return path


def test_what_is_written_is_read(tmp_path):
    recording = ArmRecording.of("run", JOINTS, TIME, POSITION, TORQUE)
    write_recording(recording, tmp_path / "run.csv")
    again = read_arm_recording(tmp_path / "run.csv", JOINTS)
    assert np.array_equal(again.position, POSITION) and np.array_equal(again.torque, TORQUE)
    assert again.summary.endswith("400 samples, 2 joints")


def test_a_gap_ends_a_segment_of_all_joints(tmp_path):
    kept = np.r_[:150, 250:400]
    columns = {"position_1": POSITION[kept, 0], "position_2": POSITION[kept, 1]}
    columns |= {"torque_1": TORQUE[kept, 0], "torque_2": TORQUE[kept, 1]}
    recording = read_arm_recording(table(tmp_path / "run.csv", time=TIME[kept], **columns), JOINTS)
    assert [len(segment) for segment in recording.segments] == [150, 150]


def test_columns_are_named_with_units_where_their_names_do_not_tell(tmp_path):
    path = table(
        tmp_path / "run.csv",
        t=TIME,
        a=np.degrees(POSITION[:, 0]),
        position_elbow=POSITION[:, 1],
        **{"torque_shoulder": TORQUE[:, 0], "torque_elbow": TORQUE[:, 1]},
    )
    recording = read_arm_recording(path, JOINTS, columns={"position_shoulder": "a:deg"})
    assert np.allclose(recording.position, POSITION)


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        (
            {"position_shoulder": 0, "torque_shoulder": 0, "torque_elbow": 1},
            "2 joints need as many columns of position",
        ),
        ({"position_1": 0, "torque_1": 0}, "none for shoulder, elbow"),
        (
            {"position_shoulder": 0, "position_elbow": 1, "position_wrist": 1, "torque_1": 0, "torque_2": 1},
            "column 'position_wrist' is of no joint",
        ),
    ],
)
def test_columns_that_do_not_fit_the_robot_are_refused(tmp_path, columns, told):
    values = {name: (POSITION if name.startswith("position") else TORQUE)[:, k] for name, k in columns.items()}
    with pytest.raises(RecordingError, match=told):
        read_arm_recording(table(tmp_path / "run.csv", time=TIME, **values), JOINTS)


def test_an_unknown_name_of_a_column_is_refused(tmp_path):
    path = table(tmp_path / "run.csv", time=TIME)
    with pytest.raises(ValueError, match="unknown column of the arm 'torque_elbo': did you mean torque_elbow"):
        read_arm_recording(path, JOINTS, columns={"torque_elbo": "x"})
    with pytest.raises(RecordingError, match="position of shape"):
        ArmRecording.of("run", JOINTS, TIME, POSITION[:, :1], TORQUE)


def test_what_is_noted_of_a_column_can_be_pasted_for_its_joint(tmp_path):
    time, q, v = np.arange(4000) / 200.0, np.empty(4000), 0.0
    torque, q[0] = 40 * np.sin(0.4 * time) * np.sin(2 * time), 1.0
    for k in range(3999):  # a motor of 1 kg m^2 on a spring, more than a turn: it could be degrees
        v += (torque[k] - 9.81 * q[k] - 0.2 * v) / 200.0
        q[k + 1] = q[k] + v / 200.0
    path = table(tmp_path / "run.csv", time=time, position_hip=q, torque_hip=torque)
    recording = read_arm_recording(path, ("hip",))
    assert "read it with --columns position_hip=position_hip:deg,torque_hip=torque_hip" in recording.notes[-1]


def test_temperatures_of_some_joints_may_be_there(tmp_path):
    time = np.arange(0, 1, 0.01)
    q, u = np.sin(3 * time), np.cos(5 * time)
    table = np.column_stack([time, q, 2 * q, u, 3 * u, 30 + time])
    names = "time,position_hip,position_knee,torque_hip,torque_knee,temperature_knee[degC]"
    path = tmp_path / "warm.csv"
    np.savetxt(path, table, delimiter=",", header=names, comments="")
    recording = read_arm_recording(path, ("hip", "knee"))
    assert recording.temperature is not None
    np.testing.assert_allclose(recording.temperature[:, 0], 25.0)  # nobody has measured it
    np.testing.assert_allclose(recording.temperature[:, 1], 30 + time, atol=1e-9)
    np.testing.assert_allclose(recording.split(0.5)[1].joints[1].temperature, 30 + time[50:], atol=1e-9)
    write_recording(recording, tmp_path / "again.csv")
    again = read_arm_recording(tmp_path / "again.csv", ("hip", "knee"))
    np.testing.assert_allclose(again.temperature, recording.temperature)
