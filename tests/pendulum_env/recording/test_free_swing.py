"""A recording without torque is a free swing, unless a column of an unknown name could be the torque."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import scipy.integrate

from pendulum_env.recording import RecordingError, read_recording
from robots.arms import ArmRecording, read_arm_recording
from tests.notes import list_notes

TIME = np.arange(600) / 100
ANGLE = 1.2 * np.exp(-0.2 * TIME) * np.cos(5 * TIME)


def table(path: Path, header: str, *others: np.ndarray | list[str]) -> Path:
    columns = [[f"{t:.2f}" for t in TIME], [f"{q:.6f}" for q in ANGLE], *[[str(x) for x in other] for other in others]]
    path.write_text("\n".join([header, *map(",".join, zip(*columns, strict=True))]) + "\n")
    return path


HARMLESS: dict[str, tuple[np.ndarray | list[str], ...]] = {
    "time,angle": (),
    "t,theta,omega,alpha": (np.gradient(ANGLE, TIME), np.arange(600) % 7),
    "Time (s),Angle (rad),Acceleration (m/s^2)": (np.arange(600),),
    "time,angle,sample_number": (np.arange(600),),
    "time,angle,comment": (["ok", *["late"] * 599],),
    "time,angle,x,y": (np.sin(ANGLE), -np.cos(ANGLE)),
    "time,angle,Light [lx]": (np.arange(600),),
    "time,angle,": ([""] * 600,),
}


@pytest.mark.parametrize("header", HARMLESS)
def test_a_file_without_torque_is_a_free_swing(tmp_path: Path, header: str) -> None:
    recording = read_recording(table(tmp_path / "swing.csv", header, *HARMLESS[header]))
    assert not recording.torque.any() and recording.torque.shape == recording.position.shape
    np.testing.assert_allclose(recording.position, ANGLE, atol=1e-6)
    assert any("free swing" in note for note in list_notes(recording))


@pytest.mark.parametrize("name", ["m1", "Kraft", "load [V]", "F (N)", "setpoint", "current"])
def test_a_column_that_may_be_the_torque_is_asked_for(tmp_path: Path, name: str) -> None:
    file = table(tmp_path / "run.csv", f"time,angle,{name}", np.cos(TIME))
    with pytest.raises(RecordingError, match="--columns torque=none") as refusal:
        read_recording(file)
    assert "no column for torque" in str(refusal.value)
    for said in ("none", None):
        recording = read_recording(file, columns={"torque": said})
        assert not recording.torque.any() and any("free swing" in note for note in list_notes(recording))


@pytest.mark.parametrize(
    ("start", "hold", "torque"),
    [(1.3, 0.62, 0.0), (2.8, 0.3, 0.0), (3.0, 0.5, 0.0), (1.3, 0.0, 0.0), (3.12, 0.0, 0.0), (1.3, 0.62, 1e-12)],
)
def test_rest_before_the_release_is_left_out(start: float, hold: float, torque: float) -> None:
    def slope(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -30.0 * np.sin(state[0]) - 0.1 * state[1] - 0.1 * np.tanh(state[1] / 0.01)]

    time = np.arange(1200) / 120.0
    q = scipy.integrate.solve_ivp(slope, (0, 10), [start, 0.0], t_eval=time, rtol=1e-8).y[0]
    q = np.append(np.full(round(hold * 120), start), q)
    q = q + np.random.default_rng(1).normal(0, 5e-4, len(q))
    columns = {"torque": np.full(len(q), torque)} if torque else {}  # rounding counts as zero
    recording = read_recording({"time": np.arange(len(q)) / 120.0, "position": q, **columns})
    lost = (len(q) - len(recording)) / 120.0
    assert lost == pytest.approx(hold, abs=0.05)
    assert any("held" in note for note in list_notes(recording)) == (hold > 0)


@pytest.mark.parametrize("start", [0.7, -1.4])
def test_rest_and_a_raise_by_hand_before_the_release_are_left_out(start: float) -> None:
    def slope(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -30.0 * np.sin(state[0]) - 0.3 * state[1]]

    q = scipy.integrate.solve_ivp(slope, (0, 12), [start, 0.0], t_eval=np.arange(2400) / 200.0, rtol=1e-8).y[0]
    raised = start * 0.5 * (1 - np.cos(np.linspace(0, np.pi, 300)))
    q = np.concatenate([np.zeros(400), raised, np.full(200, start), q])
    q = q + np.random.default_rng(1).normal(0, 5e-4, len(q))
    recording = read_recording({"time": np.arange(len(q)) / 200.0, "position": q})
    assert len(q) - len(recording) == pytest.approx(900, abs=10)


@pytest.mark.parametrize("counted", [True, False])
def test_rest_before_each_release_is_left_out(counted: bool) -> None:
    """Of swings in one file, with a column that counts them or gaps between them."""
    swing = 1.2 * np.exp(-0.2 * TIME) * np.cos(5 * TIME)
    holds = (50, 80, 120)
    q = np.concatenate([np.append(np.full(hold, 1.2), swing) for hold in holds])
    number = np.repeat(np.arange(3), [600 + hold for hold in holds])
    time = np.arange(len(q)) / 100 + (0.0 if counted else 5.0 * number)
    recording = read_recording({"time": time, "position": q, **({"segment": number} if counted else {})})
    assert len(recording) == pytest.approx(3 * 600, abs=20) and len(recording.starts) == 3
    assert all(abs(recording.position[start] - 1.2) < 0.05 for start in recording.starts)


def test_a_velocity_in_every_third_row_is_integrated() -> None:
    gyro = np.where(np.arange(len(TIME)) % 3 == 0, np.gradient(ANGLE, TIME), np.nan)
    recording = read_recording({"time": TIME, "gyro": gyro}, columns={"velocity": "gyro:rad/s", "torque": "none"})
    assert np.ptp(recording.position) == pytest.approx(np.ptp(ANGLE), rel=0.02)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_gyroscope_with_an_offset_and_late_stamps_has_the_angle_of_its_swing(seed: int) -> None:
    def slope(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -30.0 * np.sin(state[0]) - 1.0 * state[1]]

    time, rng = np.arange(2400) / 100.0, np.random.default_rng(seed)
    q, v = scipy.integrate.solve_ivp(slope, (0, 24), [2.0, 0.0], t_eval=time, rtol=1e-8, atol=1e-9).y
    q, v = np.append(np.full(200, 2.0), q), np.append(np.zeros(200), v)
    stamps = np.round(np.arange(len(q)) / 100.0 + rng.normal(0, 3e-4, len(q)), 3)
    gyro = v + 2e-3 + rng.normal(0, 1e-3, len(q))
    recording = read_recording({"time": stamps, "gyro": gyro}, columns={"velocity": "gyro:rad/s", "torque": "none"})
    first = len(q) - len(recording)
    assert first == pytest.approx(200, abs=5)
    error = recording.position - q[first:]
    assert np.std(error) < 3e-3 and np.std(np.diff(error)) < 1e-4


def test_the_line_that_is_offered_keeps_what_was_said_and_a_column_named_none_is_a_column(tmp_path: Path) -> None:
    file = table(tmp_path / "none.csv", "time,angle,none", np.cos(TIME))
    assert read_recording(file, columns={"torque": "none"}).torque.any()
    file = table(tmp_path / "run.csv", "clock,arm,m1", np.cos(TIME))
    with pytest.raises(RecordingError, match="--columns time=clock,position=arm:rad,torque=none"):
        read_recording(file, columns={"time": "clock", "position": "arm:rad"})


def test_arrays_of_other_kinds_and_an_entry_of_none_are_no_torque(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", time=TIME, angle=ANGLE, rate=100.0, author="me", is_new=TIME > 3)
    assert not read_recording(tmp_path / "run.npz").torque.any()
    assert read_recording({"time": TIME, "position": ANGLE, "torque": None, "velocity": None}).is_free
    remarks = pa.array([None, *["late"] * 599])
    assert read_recording(pa.table({"time": TIME, "angle": ANGLE, "remark": remarks})).is_free


def test_an_arm_needs_torque(tmp_path: Path) -> None:
    np.savez(tmp_path / "arm.npz", time=TIME, position_a=ANGLE, position_b=ANGLE)
    with pytest.raises(RecordingError, match="columns of torque, there is none for a, b"):
        read_arm_recording(tmp_path / "arm.npz", ["a", "b"])
    with pytest.raises(RecordingError, match="needs the torque of every joint"):
        read_arm_recording(tmp_path / "arm.npz", ["a", "b"], columns={"torque_a": "none", "torque_b": "none"})
    with pytest.raises(RecordingError, match="needs the torque of every joint"):
        ArmRecording(TIME, np.column_stack([ANGLE, ANGLE]), names=("a", "b"))
