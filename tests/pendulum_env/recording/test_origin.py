"""How to read a file otherwise, ready to paste: what is pasted does what was said."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from pendulum_env.recording import Recording, RecordingError, read_recording
from tests.notes import list_notes
from tests.options import options as options
from workbench.narrator.notes import WARNING

TIME = np.arange(2000) / 500
ANGLE = 0.8 * np.sin(3 * TIME) + 0.3 * np.sin(7 * TIME)


@pytest.fixture
def write(tmp_path: Path):
    def write(**columns: np.ndarray) -> Path:
        columns = {"time": TIME, "torque": np.sin(3 * TIME + 0.4)} | columns
        path = tmp_path / "run.npz"
        np.savez(path, **columns)
        return path

    return write


def pasted(path: Path, option: str) -> Recording:
    """The file as an option of the command line reads it, from a shell."""
    name, text = shlex.split(option)
    assert name == "--columns"
    return read_recording(path, columns=dict(part.split("=", 1) for part in re.split(r",(?=\w+=)", text)))


@pytest.mark.parametrize(
    ("header", "scale", "named"),
    [
        ("q", 1.0, None),
        ("ang_deg", np.degrees(1), None),
        ("pos_estimate", 1 / (2 * np.pi), None),  # of an ODrive, whose name alone tells its unit
        ("Winkel [deg]", np.degrees(1), "Winkel [deg]"),
        ("enc", 4096 / (2 * np.pi), "enc:counts/4096"),
        ("motor", -6 * np.degrees(1), "-motor:deg/6+30"),
        ("motor, left", np.degrees(1), "motor, left:deg-0.5:rad"),
    ],
)
def test_a_shifted_zero_is_pasted_whatever_the_column_was(write, header, scale, named):
    path = write(**{header: scale * ANGLE})
    read = read_recording(path, columns={} if named is None else {"position": named})
    moved = read_recording(path, columns=read.origin.shift_zero(np.radians(-20.0), 1))
    away = np.angle(np.exp(1j * (moved.position - read.position)))  # a zero is one of each turn
    assert np.degrees(away) == pytest.approx(-20.0, abs=0.06)  # the last digit that is told


def test_what_is_no_angle_has_no_shift_and_a_goal_goes_along(write):
    assert read_recording(write(x=ANGLE), columns={"position": "x:mm"}).origin.shift_zero(0.3, 1) is None
    path = write(ang_deg=np.degrees(ANGLE), goal=np.degrees(ANGLE))
    columns = read_recording(path).origin.shift_zero(np.radians(12.0), 0)
    assert columns == {"position": "ang_deg:deg+12", "reference": "goal:deg+12"}
    moved = read_recording(path, columns=columns)
    assert moved.reference == pytest.approx(moved.position, abs=1e-9)


def test_a_turned_sign_turns_what_was_added_and_keeps_what_else_was_said(write):
    path = write(q=ANGLE, clock=1e3 * TIME, dq=-np.gradient(ANGLE, TIME))
    columns = {"time": "clock:ms", "torque": "-torque*2-0.5", "velocity": "none"}
    read = read_recording(path, columns=columns)
    mended = read.origin.flip_sign("torque")
    assert mended == columns | {"torque": "torque*2+0.5"}
    turned = read_recording(path, columns=mended)
    assert turned.torque == pytest.approx(-read.torque) and turned.velocity is None


@pytest.mark.parametrize(
    ("columns", "named", "remedy"),
    [
        ({"angle_rad": 150 * ANGLE}, {}, "read it with --columns position=angle_rad:deg if it is in degrees"),
        ({"ang": 150 * ANGLE}, {"position": "ang:rad"}, "read it with --columns position=ang:deg if it is in degrees"),
        ({"ang": 9e3 * ANGLE}, {"position": "ang:deg"}, "check its unit and gain"),
    ],
)
def test_a_unit_that_is_said_wrongly_is_warned_of_in_the_words_that_refuse_a_guess(write, columns, named, remedy):
    """959 rad/s, said by a user to be rad/s, are no less absurd than a guess."""
    (note,) = (note for note in list_notes(read_recording(write(**columns), columns=named)) if note.startswith(WARNING))
    assert "faster than any joint" in note and note.endswith(remedy)


def test_a_remedy_for_a_velocity_can_be_pasted(write):
    path = write(q=ANGLE, dq=-np.gradient(ANGLE, TIME))
    with pytest.raises(ValueError, match="opposite sign") as refused:
        read_recording(path)
    mended = pasted(path, str(refused.value).partition("read it with ")[2])
    assert mended.velocity == pytest.approx(np.gradient(ANGLE, TIME))


def test_a_ratio_keeps_the_unit_of_a_known_name_and_is_told_for_velocity(write):
    rate = np.gradient(ANGLE, TIME)
    path = write(pos_estimate=8 * ANGLE / (2 * np.pi), vel_estimate=8 * rate / (2 * np.pi))  # of the motor, in turns
    with pytest.raises(RecordingError) as refusal:
        read_recording(path, columns={"position": "-pos_estimate/8", "torque": "-torque"})
    told = re.search("--columns .*$", str(refusal.value))
    recording = pasted(path, told[0])
    np.testing.assert_allclose(recording.position, -ANGLE, atol=1e-9)
    np.testing.assert_allclose(recording.velocity, -rate, atol=1e-9)
    of_moteus = {"position": ANGLE / np.pi, "velocity": rate / np.pi, "mode": 10 + 0 * TIME, "fault": 0 * TIME}
    named = {"position": "position/2", "velocity": "velocity/2"}
    np.testing.assert_allclose(read_recording(write(**of_moteus), columns=named).position, ANGLE, atol=1e-9)


@pytest.mark.parametrize("conversion", ["*2*pi", "*6.2832", "*2*pi/8"])
def test_a_ratio_that_converts_the_unit_of_a_known_name_converts_it_once(write, conversion):
    ratio = 8 if conversion.endswith("/8") else 1
    path = write(pos_estimate=ratio * ANGLE / (2 * np.pi))
    recording = read_recording(path, columns={"position": f"pos_estimate{conversion}"})
    np.testing.assert_allclose(recording.position, ANGLE, rtol=1e-5)
    assert not any(note.startswith(WARNING) for note in list_notes(recording))


@pytest.mark.parametrize("factor", [2 * np.pi / 8, 1 / 6.25])
def test_a_factor_on_the_unit_of_a_known_name_is_warned_of_with_the_other_reading(write, factor):
    path = write(pos_estimate=ANGLE / (2 * np.pi))
    recording = read_recording(path, columns={"position": f"pos_estimate*{factor:.6f}"})
    np.testing.assert_allclose(recording.position, factor * ANGLE, rtol=1e-5)
    (note,) = (note for note in list_notes(recording) if note.startswith(WARNING))
    told = read_recording(path, columns={"position": note.partition("write ")[2]})
    np.testing.assert_allclose(told.position, factor * ANGLE / (2 * np.pi), rtol=1e-5)
    for plain in ("pos_estimate", "-pos_estimate", "pos_estimate+0.1", f"pos_estimate:rev*{factor:.6f}"):
        read = read_recording(path, columns={"position": plain, "torque": "-torque" if plain[0] == "-" else "torque"})
        assert not any(note.startswith(WARNING) for note in list_notes(read)), plain


def test_a_column_that_is_not_read_has_no_other_sign(write):
    read = read_recording(write(q=ANGLE, sensor=ANGLE), columns={"torque": "none", "load_torque": "sensor"})
    assert read.origin.flip_sign("load_torque") is None  # without a motor it is the torque
    assert read.origin.flip_sign("torque") == {"torque": "-sensor"}


@pytest.mark.parametrize("columns", [{"torque": "none", "load_torque": "s"}, {"load_torque": "s", "torque": "none"}])
def test_a_load_torque_alone_is_the_torque(write, columns):
    read = read_recording(write(q=ANGLE, s=0.3 * np.sin(ANGLE)), columns=columns)
    np.testing.assert_allclose(read.torque, 0.3 * np.sin(ANGLE), atol=1e-6)
    assert read.load_torque is None and read.origin.flip_sign("torque") == {"torque": "-s"}
    by_name = read_recording(write(q=ANGLE, load_torque=0.3 * np.sin(ANGLE)), columns={"torque": "none"})
    np.testing.assert_allclose(by_name.torque, read.torque)
