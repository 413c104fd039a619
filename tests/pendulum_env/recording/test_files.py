from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pendulum_env.errors import ColumnError
from pendulum_env.recording import Recording, RecordingError, read_recording, write_recording
from pendulum_env.recording.notes import NoteKind
from tests.notes import list_notes

FORMATS = (".csv", ".csv.gz", ".parquet", ".npz")

Write = Callable[..., Path]
Columns = dict[str, np.ndarray]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write columns by header to a CSV file and give its path; `edit` changes its lines, of which 0 is the header."""

    def _write(columns: Columns, *, delimiter: str = ",", digits: str = "%.10g", edit=None) -> Path:
        rows = np.column_stack(list(columns.values()))
        lines = [delimiter.join(columns), *(delimiter.join(digits % cell for cell in row) for row in rows)]
        path = tmp_path / "run.csv"
        path.write_text("\n".join(edit(lines) if edit else lines) + "\n", encoding="utf-8")
        return path

    return _write


@pytest.fixture
def columns(swing: Recording) -> Columns:
    return {"time": swing.time, "position": swing.position, "torque": swing.torque}


def assert_same(one: Recording, other: Recording, atol: float = 0.0) -> None:
    assert one.starts == other.starts
    for quantity in ("time", "position", "torque", "velocity", "reference", "load_torque"):
        a, b = getattr(one, quantity), getattr(other, quantity)
        assert (a is None) == (b is None), quantity
        if a is not None:
            np.testing.assert_allclose(a, b, rtol=0, atol=atol, err_msg=quantity)


# Writing and reading back


@pytest.mark.parametrize("suffix", FORMATS)
def test_round_trip_is_exact_with_segments_and_reference_or_without(swing, tmp_path: Path, suffix: str) -> None:
    path, time = tmp_path / f"a.run{suffix}", np.arange(900) / 300 + np.repeat([0.0, 0.0021, 5.0], 300)
    goal, starts = np.sin(time), (0, 300, 600)  # the first gap is shorter than a period
    told = {"starts": starts, "reference": goal, "load_torque": np.cos(2 * time)}
    gappy = Recording(time, np.sin(7 * time), np.cos(time), 7 * np.cos(7 * time), **told, name="gappy")
    for recording in (swing, Recording(swing.time, swing.position, swing.torque, name="bare"), gappy):
        write_recording(recording, path)
        back = read_recording(path)
        assert_same(back, recording)
        assert (back.name, len(back.notes)) == ("a.run", int(recording.load_torque is not None))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]  # nothing temporary is left


@pytest.mark.parametrize(("name", "match"), [("run.xlsx", "does not end in .csv"), ("absent/run.csv", "cannot be")])
def test_write_refuses(swing: Recording, tmp_path: Path, name: str, match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        write_recording(swing, tmp_path / name)


# Columns


def test_commanded_torque_is_the_second_choice(write: Write, columns: Columns) -> None:
    torque = columns.pop("torque")
    both = read_recording(write(columns | {"tau_cmd": 2 * torque, "tau": torque}))
    np.testing.assert_allclose(both.torque, torque, atol=1e-8)
    assert list_notes(both) == ("torque is taken from column 'tau'; 'tau_cmd' is there too",)
    alone = read_recording(write(columns | {"tau_cmd": torque}))
    assert list_notes(alone) == ("torque is the commanded one, from column 'tau_cmd'",)


def test_columns_of_a_telemetry_that_are_not_read_are_in_one_note(swing: Recording) -> None:
    log = {f"{name}.data[{k}]": getattr(swing, name) for name in ("position", "torque", "velocity") for k in range(9)}
    named = {name: f"{name}.data[6]" for name in ("position", "torque")}
    (note,) = read_recording({"time": swing.time} | log, columns=named).notes
    assert note.headers[0] == "velocity.data[6]", "the velocity of the same joint"
    assert len(note.headers) == 9


# Text


LABVIEW = ["LabVIEW Measurement", "Writer_Version\t2", "Separator\tTab", "***End_of_Header***", ""]


@pytest.mark.parametrize(
    ("delimiter", "edit"),
    [
        (";", None),
        ("\t", None),
        (" ", None),
        (", ", None),
        (",", lambda lines: ["# rig 3", "", "#", *lines]),
        (",", lambda lines: ["# rig 3", "# " + lines[0], *lines[1:]]),
        (",", lambda lines: ["\ufeff" + lines[0], *lines[1:]]),
        (",", lambda lines: ['"time","position","torque"', *lines[1:]]),
        (",", lambda lines: ["mode,time,position,torque", *(f'"on, running",{line}' for line in lines[1:])]),
        (",", lambda lines: [line + "\r" for line in lines]),
        (",", lambda lines: [lines[0], "", *lines[1:], "", ""]),
        (",", lambda lines: ["Rig 3", "Recorded by,me", "", *lines]),
        (";", lambda lines: [*LABVIEW, lines[0], "[s];[rad];", *lines[1:]]),
    ],
    ids="semicolon tab space padded comments savetxt bom quoted text-column crlf blank-lines title labview".split(),
)
def test_text_dialects(write: Write, columns: Columns, swing: Recording, delimiter: str, edit: Callable | None) -> None:
    recording = read_recording(write(columns, delimiter=delimiter, edit=edit))
    assert_same(recording, Recording(swing.time, swing.position, swing.torque, name="run"), atol=1e-7)
    assert recording.notes == ()


@pytest.mark.parametrize(("between", "zone"), [("T", ""), ("T", "Z"), (" ", "+02:00")])
def test_iso_time_is_counted_from_the_first_row(write: Write, columns: dict, zone: str, between: str) -> None:
    stamps = np.datetime64("2026-02-28T23:59:58", "us") + np.round(1e6 * columns["time"]).astype("timedelta64[us]")

    def dated(lines: list[str]) -> list[str]:
        cells = [str(stamp).replace("T", between) + zone for stamp in stamps]
        return [lines[0], *(f"{stamp},{line.split(',', 1)[1]}" for stamp, line in zip(cells, lines[1:], strict=True))]

    recording = read_recording(write(columns, edit=dated))
    np.testing.assert_allclose(recording.time, columns["time"], atol=1e-9)
    assert list_notes(recording) == (f"time is counted from 2026-02-28{between}23:59:58.000000{zone}",)


def changed(row: int, text: str) -> Callable:
    return lambda lines: [*lines[:row], text, *lines[row + 1 :]]


def without_torque(lines: list[str]) -> list[str]:
    return [lines[0], *(f"{line.rpartition(',')[0]},nan" for line in lines[1:])]


@pytest.mark.parametrize(
    ("edit", "match"),
    [
        (lambda lines: lines[1:], "file has no header: put a line above that names the 3 columns"),
        (lambda lines: lines[:1], "header but no data"),
        (lambda lines: ["# nothing"], "comments but no header"),
        (changed(12, "0.022,abc,1"), r"data row 12 \(header not counted\) has 'abc' as pos"),
        (changed(12, f"0.022,{'1' * 100_000}x,1"), "data row 12 .* has '1{27}...1{27}x' as position"),
        (changed(0, "1" * 60_000 + "x"), "the file has no header"),
        (lambda lines: [*lines[:-2], "3.99", lines[-1]], "data row 1999 .* has 1 cells where the header has 3"),
        (changed(0, "time;position;torque"), "data row 1 .* has 1 cells where the header has 3"),
        (without_torque, "row 1 .* has torque that is empty or NaN, as have 2000 of 2000 rows"),
        (lambda lines: [lines[0], *["0,1,", "0.1,,1"] * 100], "fewer than 100 rows have all of time, position and"),
        (lambda lines: lines[:12] + lines[2:], "time falls from 0.02 to 0.002 s at data row 12 .* sort the rows"),
        (lambda lines: [lines[0], *("7," + line for line in lines[1:])], "has 4 cells where the header has 3"),
        (lambda lines: lines[:11], "holds 10 samples, of which at least 100"),
        (lambda lines: lines[:201], "lasts 0.398 s, of which at least 1 s"),
    ],
)
def test_text_refused(write: Write, columns: Columns, edit: Callable, match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        read_recording(write(columns, edit=edit))


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"time,'po\x01s\x1b',torque\n" + b"0,1,2\n" * 200, "no column for position"),
        (b"time,'po\x00s\x1b',torque\n" + b"0,1,2\n" * 200, "binary data"),
    ],
)
def test_refusal_of_foreign_text_is_one_line_with_the_file(tmp_path: Path, content: bytes, match: str) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=match) as refusal:
        read_recording(path)
    assert str(refusal.value).startswith(f"{path}: ") and str(refusal.value).isprintable()


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])  # with a byte-order mark
def test_a_text_is_read_in_the_encodings_of_spreadsheets(write: Write, columns: Columns, encoding: str) -> None:
    path, expected = write(columns), read_recording(columns)
    path.write_bytes(path.read_text().replace("position", "Winkel [°]").encode(encoding))
    np.testing.assert_allclose(read_recording(path).position, np.radians(expected.position), atol=1e-9)


def test_a_unit_against_the_name_is_read_with_a_warning_and_a_count_by_its_first_gain(columns: Columns) -> None:
    amperes = columns["torque"] / 0.96
    log = {"time": columns["time"], "position": columns["position"], "iq_mA": 1e3 * amperes, "raw": amperes / 0.002}
    for gain, size, kinds in (("mA*0.96", 1.0, {"transformed"}), ("A*0.96", 1e3, {"transformed", "unit_contradicted"})):
        read = read_recording(log, columns={"torque": f"iq_mA:{gain}", "position": "position:rad"})
        np.testing.assert_allclose(read.torque, size * columns["torque"], rtol=1e-9)
        assert {note.kind.value for note in read.notes} == kinds
    counted = {"time": log["time"], "position": log["position"], "rated [0.1%]": np.round(log["raw"])}
    assert np.abs(counted["rated [0.1%]"]).max() > 1000
    read = read_recording(counted, columns={"torque": "rated [0.1%]:A*0.002*0.96"})
    np.testing.assert_allclose(read.torque, columns["torque"], atol=1e-3)
    with pytest.raises(ColumnError, match="too much in A"):
        read_recording(counted, columns={"torque": "rated [0.1%]:A*0.96"})


@pytest.mark.parametrize("name", ["enabled", "torque_enable", "servo_on", "motor_on", "drive_enabled", "Motor Enabled"])
def test_a_motor_that_is_off_gives_no_torque_and_a_note(columns: Columns, name: str) -> None:
    on = columns["time"] % 1.0 < 0.7
    read = read_recording(columns | {name: on.astype(float)})
    np.testing.assert_allclose(read.torque, columns["torque"] * on, atol=1e-12)
    (note,) = (note for note in read.notes if note.kind == "motor_off")
    assert note.headers == (name,) and note.numbers["count"].value == np.count_nonzero(~on)


def test_a_motor_that_is_off_in_every_row_is_refused_where_torque_changes(columns: Columns) -> None:
    off = {"servo_on": np.zeros_like(columns["time"])}
    with pytest.raises(ColumnError, match=r"'servo_on' .*enabled=none .*torque=none"):
        read_recording(columns | off)
    read = read_recording(columns | off, columns={"enabled": "none"})
    np.testing.assert_array_equal(read.torque, columns["torque"])
    for free in ({"torque": 0.0 * columns["torque"]}, {}):
        read = read_recording(columns | free | off, columns=None if free else {"torque": "none"})
        assert not read.torque.any()


@pytest.mark.parametrize("name", ["run.docx", ".csv", "run.gz"])
def test_unknown_ending(tmp_path: Path, name: str) -> None:
    with pytest.raises(RecordingError, match=r"does not end in \.csv, \.csv\.gz, \.tsv, \.txt, \.parquet, \.npz"):
        read_recording(tmp_path / name)


# What a recording says


def spinning(time: np.ndarray) -> np.ndarray:
    return 30.0 * time + 0.3 * np.sin(30.0 * time)  # [rad], as gravity would have it


def test_wrapped_angle_is_refused_and_unwrapped_on_request(write: Write, columns: Columns) -> None:
    turns = spinning(columns["time"])
    wrapped = np.angle(np.exp(1j * turns))
    path, first = write(columns | {"position": wrapped}), int(np.argmax(turns > np.pi)) + 1
    with pytest.raises(RecordingError, match=rf"data row {first} .* wrapped at 2 pi does: read it with --unwrap"):
        read_recording(path)
    recording = read_recording(path, unwrap=True)
    np.testing.assert_allclose(recording.position, turns, atol=1e-8)
    assert list_notes(recording) == ("position unwrapped at 19 jumps of 2 pi",)
    for unwrap in (False, True):
        with pytest.raises(RecordingError, match=r"wrapped at 360 degrees does: .* --columns position=position:deg"):
            read_recording(write(columns | {"position": np.degrees(wrapped)}), unwrap=unwrap)
    del columns["position"]  # it is told to be in degrees, and swings freely
    free = read_recording(write(columns | {"position_deg": np.degrees(wrapped), "torque": 0.0 * turns}), unwrap=True)
    np.testing.assert_allclose(free.position, turns, atol=1e-6)
    assert not free.torque.any()


def test_an_encoder_before_a_gear_is_unwrapped_at_its_own_turn(write: Write, columns: Columns) -> None:
    angle = 1.2 * np.sin(3 * columns["time"]) + 0.02
    motor = {"degrees": np.degrees(8 * angle) % 360, "enc": np.round(8 * angle * 4096 / (2 * np.pi)) % 4096}
    for (header, wrapped), named in zip(motor.items(), ("degrees:deg/8", "enc:counts/4096/8"), strict=True):
        path = write({"time": columns["time"], header: wrapped, "torque": columns["torque"]})
        with pytest.raises(RecordingError, match="wrapped at a turn of its encoder does: read it with --unwrap"):
            read_recording(path, columns={"position": named})
        recording = read_recording(path, columns={"position": named}, unwrap=True)
        np.testing.assert_allclose(recording.position, angle, atol=2e-4)
        assert any(note.kind == "unwrapped" for note in recording.notes)
        late = np.delete(np.arange(len(angle)), np.arange(200, 400))  # the motor turns on in a gap
        cut = {"time": columns["time"][late], header: wrapped[late], "torque": columns["torque"][late]}
        with pytest.raises(RecordingError, match="after which the turn is unknown"):
            read_recording(write(cut), columns={"position": named}, unwrap=True)
    counted = {"time": columns["time"][::10], "degrees": 8 * np.degrees(angle)[::10] * 20, "torque": angle[::10]}
    fast = read_recording(write(counted), columns={"position": "degrees:deg/160"}, unwrap=True)  # it counts its turns
    np.testing.assert_allclose(fast.position, angle[::10], atol=1e-6)


@pytest.mark.parametrize("is_wrapped", [False, True])
@pytest.mark.parametrize("way", ["steps", "lag"])
def test_a_goal_keeps_its_distance_from_a_joint_whose_encoder_turns_before_the_gear(
    columns: Columns, way: str, is_wrapped: bool
) -> None:
    time, turn = columns["time"], 2 * np.pi / 8
    if way == "steps":  # of 0.64 of a turn, and a slow joint
        goal, angle = 0.5 * (time % 4.0 >= 2.0), np.empty_like(time)
        angle[0] = 0.02
        for k in range(1, len(time)):
            angle[k] = angle[k - 1] + 4.0 * (time[k] - time[k - 1]) * (goal[k - 1] + 0.02 - angle[k - 1])
    else:  # an error of up to 0.8 of a turn
        size = 1.2 if is_wrapped else 0.35
        goal, angle = size * np.sin(3 * time) + 0.38, size * np.sin(3 * time - 0.5) + 0.38
    if is_wrapped:
        angle = angle - 0.03  # below zero at times
    motor = {"q": np.degrees(8 * angle), "goal": np.degrees(8 * goal)}
    if is_wrapped:
        motor = {name: degrees % 360 for name, degrees in motor.items()}
    named = {"position": "q:deg/8", "reference": "goal:deg/8"}
    read = read_recording({"time": time, "torque": columns["torque"], **motor}, columns=named, unwrap=True)
    assert any(note.kind == "unwrapped" for note in read.notes) == is_wrapped
    shift = read.position - angle
    assert np.ptp(shift) < 1e-6 and abs(np.round(shift[0] / turn) * turn - shift[0]) < 1e-6
    assert read.reference is not None
    np.testing.assert_allclose(read.reference - read.position, goal - angle, atol=1e-6)


def moved(torque: np.ndarray, load: Callable[[float, float, float], float], start: float = 0.0) -> np.ndarray:
    """Angles of 1 kg m^2 by semi-implicit Euler at 200 Hz, under a load by time, angle and speed."""
    q, v, path = start, 0.0, []
    for k, held in enumerate(torque.tolist()):
        path.append(q)
        v += (held - load(k / 200, q, v)) / 200.0
        q += v / 200.0
    return np.array(path)


def driven(torque: np.ndarray, load: Callable[[float, float, float], float], start: float = 0.0) -> Columns:
    time = np.arange(4000) / 200.0
    return {"time": time, "position": moved(torque(time), load, start), "torque": torque(time)}


def test_degrees_by_gravity(write: Write) -> None:
    swing = driven(np.zeros_like, lambda t, q, v: 9.81 * np.sin(q) + 0.2 * v, start=1.0)  # freely, of 57 degrees
    q = swing["position"]
    assert read_recording(write(swing)).notes == ()
    with pytest.raises(RecordingError, match="gravity acts on it as on degrees"):
        read_recording(write(swing | {"position": np.degrees(q)}))
    del swing["position"]
    assert read_recording(write(swing | {"position_rad": np.degrees(q)})).position.max() > 50  # its name says radians


@pytest.mark.parametrize(("header", "unit"), [("position_deg", np.pi / 180), ("position [rev]", 2 * np.pi)])
@pytest.mark.parametrize("amplitude", [5.0, 12.0])
def test_radians_below_the_name_of_another_unit_are_noted(
    write: Write, header: str, unit: float, amplitude: float
) -> None:
    motion = driven(
        lambda time: amplitude * (np.sin(1.1 * time) + 0.6 * np.sin(2.9 * time)),
        lambda t, q, v: 5.0 * np.sin(q) + 0.3 * v + 0.2 * np.tanh(v / 0.02),
    )
    angle = motion.pop("position")
    wrong, right = (read_recording(write(motion | {header: angle / factor})) for factor in (1.0, unit))
    assert [note.kind for note in wrong.notes if note.kind is NoteKind.IMPLAUSIBLE] == [NoteKind.IMPLAUSIBLE]
    assert NoteKind.IMPLAUSIBLE not in [note.kind for note in right.notes]


@pytest.mark.parametrize("tones", [(2.5,), (2.5, 8.0)], ids=["one", "two"])
def test_a_motor_at_one_frequency_turns_in_radians(write: Write, tones: tuple[float, ...]) -> None:
    """Its position is proportional to its acceleration, so gravity on degrees imitates what a noisy torque lacks."""
    time = np.arange(2400) / 200.0
    position, speed, acceleration = (
        np.sum([30.0 * w**order * np.sin(w * time + order * np.pi / 2) for w in tones], axis=0) for order in range(3)
    )
    torque = acceleration + 2.0 * speed + 30.0 * np.tanh(speed)
    noise = np.random.default_rng(0).normal(0.0, 0.5 * np.std(torque), len(time))
    recording = read_recording(write({"time": time, "position": position, "torque": torque + noise}))
    assert np.ptp(recording.position) > 10 * np.pi  # no spring is wound up so far


def test_cogging_of_order_six_over_radians_is_no_gravity_over_turns(write: Write) -> None:
    swing = driven(
        lambda time: 1.5 * np.sin(2 * time) + 1.0 * np.sin(4.7 * time),
        lambda t, q, v: 0.5 * np.sin(6 * q + 1.0) + 0.2 * v + 0.4 * np.tanh(v / 0.02),
    )
    noise = np.random.default_rng(1).normal(0.0, 0.02, len(swing["time"]))
    recording = read_recording(write(swing | {"torque": swing["torque"] + noise}))
    assert np.ptp(recording.position) > 2.0 and recording.notes == ()


def test_turns_about_an_unknown_zero_by_gravity(write: Write) -> None:
    def two_sines(time: np.ndarray) -> np.ndarray:
        return 4.5 * np.sin(2 * time) + 2.5 * np.sin(4.7 * time)

    swing = driven(two_sines, lambda t, q, v: 9.81 * np.sin(q) + 0.2 * v + 0.4 * np.tanh(v / 0.02))
    q = np.round(swing["position"] / (2 * np.pi) * 16384) / 16384  # [turns] that an encoder reads
    assert np.ptp(q) < 0.4
    swing["torque"] = swing["torque"] + np.random.default_rng(1).normal(0.0, 0.1, len(q))
    assert read_recording(write(swing | {"position": 2 * np.pi * q + 0.9})).notes == ()  # radians about another zero
    for zero in (0.0, 0.1387, -0.4):
        path = write(swing | {"position": q + zero})
        with pytest.raises(RecordingError, match="position:rev"):
            read_recording(path)
        assert np.ptp(read_recording(path, columns={"position": "position:rev"}).position) > 1.0
    spring = driven(two_sines, lambda t, q, v: 3 * q + 9.81 * np.sin(q) + 0.2 * v, start=0.1)
    assert read_recording(write(spring)).notes == ()


TIME, HOURS = np.arange(2000) / 500.0, np.arange(20_000) / 10.0
STEADY = {  # what accelerates so little tells nothing of gravity, and a wheel knows none
    "a steady turn": lambda: {"time": TIME, "position": 5 * TIME, "torque": np.cos(TIME)},
    "a slow swing": lambda: {"time": HOURS, "position": 57.0 * np.cos(HOURS / 300.0), "torque": 0 * HOURS},
    "a wheel under a drift": lambda: driven(drifting, lambda t, q, v: 0.12 * t + 0.6 * v),
    "a lopsided wheel": lambda: driven(drifting, lambda t, q, v: 0.06 * t + (0.6 + 0.8 * (v > 0)) * v),
}


def drifting(time: np.ndarray) -> np.ndarray:
    return 2 * np.sin(2 * time) + 1.4 * np.sin(0.7 * time) - 1.2


@pytest.mark.parametrize("make", STEADY.values(), ids=STEADY)
def test_what_knows_no_gravity_is_not_taken_for_degrees(write: Write, make: Callable[[], Columns]) -> None:
    columns = make()
    assert np.ptp(columns["position"]) > 2 * np.pi  # less is no question
    recording = read_recording(write(columns, digits="%.17g"))
    assert np.ptp(recording.position) == pytest.approx(np.ptp(columns["position"]))
    assert not any("degrees" in note for note in list_notes(recording))


@pytest.mark.parametrize("bent", [0.0, 30.0])
def test_a_spring_is_not_taken_for_degrees(write: Write, bent: float) -> None:
    run = driven(
        lambda time: 40 * np.sin(0.4 * time) * np.sin(2 * time),
        lambda t, q, v: 9.81 * (q + bent * (1 - np.cos(0.05 * q))) + 0.2 * v, start=1.0,
    )  # fmt: skip
    assert np.ptp(run["position"]) > 2 * np.pi
    (note,) = list_notes(read_recording(write(run)))
    assert "on which a spring acts; if it is degrees, read it with --columns position=position:deg" in note


@pytest.mark.parametrize(
    ("read", "match"),
    [
        ({"position": 115}, "faster than any joint: read it with --columns position=position:deg if it is"),
        ({"position": 0}, "position is 0 rad in every row"),
        ({"time": 1e3}, "2 s pass between samples.* read it with --columns time=time:ms"),
        ({"velocity": 57.3}, "as if velocity were in deg/s: read it with --columns velocity=velocity:deg/s"),
        ({"velocity": -1}, "opposite sign of the slope of position: read it with --columns velocity=-velocity"),
        ({"velocity": 6}, "is 6 times the slope of position: mend it, or do without .*: --columns velocity=none"),
        ({"velocity": 0}, r"does not follow the slope of position \(0.00 correlated\)"),
        ({"velocity": 0.47 / np.pi}, "as if velocity were in rev/s: read it with --columns velocity=velocity:rev/s"),
        (
            {"position": 10, "velocity": 10 / 57.3},
            "as if position were in deg: read it with --columns position=",
        ),
    ],
)
def test_a_column_in_another_unit_is_refused_with_what_mends_it(
    write: Write, columns: Columns, swing: Recording, read: dict[str, float], match: str
) -> None:
    columns |= {"velocity": swing.velocity} if "velocity" in read else {}
    with pytest.raises(RecordingError, match=match):
        read_recording(write({name: read.get(name, 1) * values for name, values in columns.items()}))


# Uneven time


@pytest.mark.parametrize(
    ("rate", "stamps"),
    [(300, lambda time: np.round(time, 3)), (700, lambda time: np.round(time, 4)), (500, np.float32)],
)
def test_time_of_few_digits_shifts_nothing(rate: float, stamps: Callable) -> None:
    time = np.arange(2000) / rate
    position, torque = np.sin(5 * time), np.sign(np.sin(40 * time))
    recording = read_recording({"t": stamps(time), "q": position, "u": torque})
    np.testing.assert_array_equal(recording.position, position)
    np.testing.assert_array_equal(recording.torque, torque)
    assert recording.rate == pytest.approx(rate, rel=1e-4)
    assert any("by rounding only" in note for note in list_notes(recording))


def test_a_motor_is_off_from_the_sample_that_says_so_on_where_jitter_is_resampled() -> None:
    rng = np.random.default_rng(0)
    time = (np.arange(2000) + rng.uniform(-0.2, 0.2, 2000)) / 500
    on = (np.sin(5 * time) > -0.5).astype(float)
    read = read_recording({"time": time, "position": np.sin(3 * time), "torque": np.cos(3 * time), "enabled": on})
    last = np.array([on[time <= time[0] + now + 1e-9][-1] for now in read.time])
    assert any("resampled" in note for note in list_notes(read))
    np.testing.assert_array_equal(read.enabled, last)


def test_jitter_is_resampled_and_reported() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(2000) / 500.0
    time[1:-1] += rng.uniform(-0.3e-3, 0.3e-3, 1998)
    recording = read_recording({"t": time, "q": np.sin(12 * time), "u": np.cos(time)})
    assert recording.rate == pytest.approx(500.0)
    np.testing.assert_allclose(recording.position, np.sin(12 * recording.time), atol=1e-5)
    assert np.abs(np.sin(12 * time) - np.sin(12 * recording.time)).max() > 1e-3  # had it been left alone
    assert list_notes(recording)[0].startswith("resampled to 500 Hz: steps were 1.4")


def test_resampling_keeps_the_impulse_of_the_torque() -> None:
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.uniform(1.7e-3, 2.3e-3, 2000))
    torque = rng.normal(size=2000)
    recording = read_recording({"t": time, "q": np.sin(time), "u": torque})
    impulse = recording.torque[:-1].sum() / recording.rate
    assert impulse == pytest.approx(torque[:-1] @ np.diff(time), abs=1e-9)


@pytest.mark.parametrize(
    ("gone", "note"),
    [
        ([499], "1 sample is missing after 0.996 s: filled in by interpolation"),
        ([40, 777, 778], "3 samples are missing after 0.078, 1.552 s: filled in by interpolation"),
    ],
)
def test_lost_samples_are_filled_in_without_touching_the_others(swing: Recording, gone, note) -> None:
    whole = {"time": swing.time, "position": swing.position, "velocity": swing.velocity, "torque": swing.torque}
    recording = read_recording({name: np.delete(column, gone) for name, column in whole.items()})
    assert list_notes(recording) == (note,)
    assert len(recording) == len(swing)
    for name, column in whole.items():
        np.testing.assert_allclose(np.delete(getattr(recording, name), gone), np.delete(column, gone), atol=1e-12)
    np.testing.assert_allclose(recording.position, swing.position, atol=1e-5)
    np.testing.assert_allclose(recording.torque, swing.torque, atol=0.01)


def test_a_sample_lost_at_1_khz_is_told_from_a_clock_printed_in_milliseconds() -> None:
    time = np.arange(5000) / 1000
    one = read_recording({"t": np.delete(time, 2000), "q": np.delete(np.sin(time), 2000), "u": time[1:]})
    assert len(one) == 5000 and one.rate == pytest.approx(1000)
    assert "missing after" in list_notes(one)[0] and not any("rounding" in note for note in list_notes(one))
    slow = np.arange(5000) / 999  # every 1000th step is of 2 ms
    other = read_recording({"t": np.round(slow, 3), "q": np.sin(slow), "u": time})
    assert len(other) == 5000
    assert "by rounding only" in list_notes(other)[0]


@pytest.mark.parametrize("every", [50, 200, 1000])
def test_samples_lost_at_regular_intervals_are_told_by_the_motion(every: int) -> None:
    time = np.arange(10_000) / 1000
    kept = np.arange(len(time)) % every != 37
    signals = {"time": time, "position": np.sin(3 * time) + 0.4 * np.sin(12 * time), "torque": np.cos(time)}
    recording = read_recording({name: values[kept] for name, values in signals.items()})
    assert len(recording) == len(time)
    assert recording.position == pytest.approx(signals["position"], abs=1e-5)
    assert "missing" in list_notes(recording)[0] or "resampled" in list_notes(recording)[0]
