import gzip
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pendulum_env.recording import Recording, RecordingError, read_recording, storage, write_recording
from pendulum_env.recording.cleaning import Log
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.sampling import uniform
from pendulum_env.recording.vocabulary import TOLD, UNITS, _names

FORMATS = (".csv", ".csv.gz", ".parquet", ".npz")
SHARED = Path(__file__).parents[4] / "shared"  # real and simulated recordings, absent on most machines

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write columns by header to a CSV file and give its path; `edit` changes its lines, of which 0 is the header."""

    def _write(columns: dict[str, np.ndarray], *, delimiter: str = ",", digits: str = "%.10g", edit=None) -> Path:
        rows = np.column_stack(list(columns.values()))
        lines = [delimiter.join(columns), *(delimiter.join(digits % cell for cell in row) for row in rows)]
        path = tmp_path / "run.csv"
        path.write_text("\n".join(edit(lines) if edit else lines) + "\n", encoding="utf-8")
        return path

    return _write


@pytest.fixture
def columns(swing: Recording) -> dict[str, np.ndarray]:
    return {"time": swing.time, "position": swing.position, "torque": swing.torque}


def assert_same(one: Recording, other: Recording, atol: float = 0.0) -> None:
    for quantity in ("time", "position", "torque", "velocity"):
        a, b = getattr(one, quantity), getattr(other, quantity)
        assert (a is None) == (b is None), quantity
        if a is not None:
            np.testing.assert_allclose(a, b, rtol=0, atol=atol, err_msg=quantity)


# The record


def test_split_gives_every_sample_to_one_part(swing: Recording) -> None:
    first, rest = swing.split(0.7)
    assert_same(first, swing.slice(0, 1400))
    assert_same(rest, swing.slice(-600, None))
    with pytest.raises(ValueError, match="read-only"):
        first.position[0] = 1.0


@pytest.mark.parametrize("fraction", [0.0, 1.5])
def test_split_needs_samples_in_both_parts(swing: Recording, fraction: float) -> None:
    with pytest.raises(RecordingError, match="both parts need at least 2"):
        swing.split(fraction)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"torque": np.zeros(4)}, r"torque of shape \(4,\) with time of shape \(5,\)"),
        ({"velocity": np.array([0, 1, np.nan, 3, 4])}, "velocity that is not finite"),
        ({"position": np.array(["a"] * 5)}, "position that is not numbers"),
        ({"time": np.array([0, 1, 2, 3, 5.0])}, "not uniform and increasing"),
        ({"time": np.arange(5.0)[::-1]}, "not uniform and increasing"),
        (dict.fromkeys(("time", "position", "torque"), np.zeros(1)), "holds 1 samples and needs at least 2"),
    ],
)
def test_record_refuses(change: dict[str, np.ndarray], match: str) -> None:
    good = dict.fromkeys(("time", "position", "torque"), np.arange(5.0))
    with pytest.raises(RecordingError, match=match):
        Recording("r", **(good | change))


# Writing and reading back


@pytest.mark.parametrize("suffix", FORMATS)
def test_round_trip_is_exact(swing: Recording, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.run{suffix}"
    for recording in (swing, Recording("bare", swing.time, swing.position, swing.torque)):
        write_recording(recording, path)
        back = read_recording(path)
        assert_same(back, recording)
        assert (back.name, back.notes) == ("a.run", ())
    assert [p.name for p in tmp_path.iterdir()] == [path.name]  # nothing temporary is left


@pytest.mark.parametrize(("name", "match"), [("run.xlsx", "does not end in .csv"), ("absent/run.csv", "cannot be")])
def test_write_refuses(swing: Recording, tmp_path: Path, name: str, match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        write_recording(swing, tmp_path / name)


# Columns


@pytest.mark.parametrize(
    ("headers", "quantities"),
    [
        ("t,q,u", ["time", "position", "torque"]),
        ("Time [s],q [rad],tau [N m]", ["time", "position", "torque"]),
        ("time_s,pos_rad,vel_rad/s,tau_Nm", ["time", "position", "velocity", "torque"]),
        ("timestamp,theta,omega,effort", ["time", "position", "velocity", "torque"]),
        ("time,meas_pos,meas_vel,meas_tau,des_pos,des_tau", ["time", "position", "velocity", "torque", "reference"]),
        ("mode,t,angle (rad),dq,torque (N·m)", [None, "time", "position", "velocity", "torque"]),
        ("Timestamp,θ,qd,τ,temperature", ["time", "position", "velocity", "torque", "temperature"]),
    ],
)
def test_aliases(headers: str, quantities: list[str | None]) -> None:
    found = {column.index: quantity for quantity, column in find_columns(headers.split(",")).items()}
    assert [found.get(index) for index in range(len(quantities))] == quantities
    assert len(found) == len([q for q in quantities if q])


def test_no_name_has_two_meanings() -> None:
    meanings: dict[str, set[tuple[str, float, bool]]] = {}
    for name, (quantity, unit, commanded) in _names():
        factor = 1.0 if unit is None else UNITS[quantity][unit]
        meanings.setdefault(name, set()).add((quantity, factor, commanded))
    assert {name: meaning for name, meaning in meanings.items() if len(meaning) > 1} == {}


@pytest.mark.parametrize(
    ("headers", "match"),
    [
        ("time,q,position,torque", "'q' and 'position' could both be position"),
        ("time,x,torque", "no column for position among 'time', 'x', 'torque': name the columns time,position,torque"),
        (
            "time,position_a,position_b,torque_a,torque_b",
            "there are some for 'a', 'b': identify and diagnose take an arm's links with --robot",
        ),
        ("time,position [counts],torque", "no column for position"),
        ("time,position,current [A]", "no column for torque"),
        ("time,q,tau_cmd,u", "'tau_cmd' and 'u' could both be torque: say which with --columns QUANTITY=NAME"),
    ],
)
def test_columns_refused(headers: str, match: str) -> None:
    with pytest.raises(RecordingError, match=match.replace("[", r"\[")):
        find_columns(headers.split(","))


def test_units_in_names_are_converted_and_noted(write: Write, swing: Recording) -> None:
    path = write(
        {
            "time_ms": 1e3 * swing.time,
            "position [°]": np.degrees(swing.position),
            "tau_mNm": 1e3 * swing.torque,
            "speed (rpm)": swing.velocity * 60 / (2 * np.pi),
        }
    )
    recording = read_recording(path)
    assert_same(recording, swing, atol=1e-7)
    assert "position converted to rad from column 'position [°]'" in recording.notes
    assert len(recording.notes) == 4


def test_commanded_torque_is_the_second_choice(write: Write, columns: dict[str, np.ndarray]) -> None:
    torque = columns.pop("torque")
    both = read_recording(write(columns | {"tau_cmd": 2 * torque, "tau": torque}))
    np.testing.assert_allclose(both.torque, torque, atol=1e-8)
    assert both.notes == ("torque is taken from column 'tau'; 'tau_cmd' is there too",)
    alone = read_recording(write(columns | {"tau_cmd": torque}))
    assert alone.notes == ("torque is the commanded one, from column 'tau_cmd'",)


def test_a_column_that_is_named_leaves_the_others_to_their_names(write: Write, columns: dict[str, np.ndarray]) -> None:
    path = write(columns | {"q": 2 * columns["position"], "a:b": columns["time"]})
    assert find_columns(["q", "t", "tau"], {"torque": "tau"})["position"].header == "q"
    recording = read_recording(path, columns={"position": "q", "time": "a:b"})  # a colon may be part of a name
    np.testing.assert_allclose(recording.position, 2 * columns["position"], atol=1e-8)


@pytest.mark.parametrize(
    ("named", "match"),
    [
        ({"angle": "q"}, "columns are named for time, position, velocity, torque, reference, supply, enabled"),
        ({"position": "Q"}, "no column is named 'Q', which is to be position, among 't', 'q', 'tau', 'x', 'x'"),
        ({"position": "x"}, "2 columns are named 'x'"),
        ({"velocity": "q"}, "no column for position"),
    ],
)
def test_named_columns_refused(named: dict[str, str], match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        find_columns(["t", "q", "tau", "x", "x"], named)


def test_units_that_people_are_told_of_are_understood() -> None:
    for quantity, told in TOLD.items():
        for unit in told.split(", "):
            named = {"time": "t", "position": "q", "torque": "tau"} | {quantity: f"x:{unit}*2"}
            assert find_columns(["t", "q", "tau", "x"], named)[quantity].unit is not None


# Text


@pytest.mark.parametrize(
    ("delimiter", "edit"),
    [
        (";", None),
        ("\t", None),
        (" ", None),
        (", ", None),
        (";", lambda lines: [line.replace(".", ",") for line in lines]),
        (",", lambda lines: ["# rig 3", "", "#", *lines]),
        (",", lambda lines: ["# rig 3", "# " + lines[0], *lines[1:]]),
        (",", lambda lines: ["\ufeff" + lines[0], *lines[1:]]),
        (",", lambda lines: ['"time","position","torque"', *lines[1:]]),
        (",", lambda lines: ["mode,time,position,torque", *(f'"on, running",{line}' for line in lines[1:])]),
        (",", lambda lines: [line + "\r" for line in lines]),
        (",", lambda lines: [lines[0], "", *lines[1:], "", ""]),
    ],
    ids="semicolon tab space padded decimal-comma comments savetxt bom quoted text-column crlf blank-lines".split(),
)
def test_text_dialects(write: Write, columns: dict, swing: Recording, delimiter: str, edit: Callable | None) -> None:
    recording = read_recording(write(columns, delimiter=delimiter, edit=edit))
    bare = Recording("run", swing.time, swing.position, swing.torque)
    assert_same(recording, bare, atol=1e-7)
    assert recording.notes == ()


LABVIEW = ["LabVIEW Measurement", "Writer_Version\t2", "Separator\tTab", "***End_of_Header***", ""]


@pytest.mark.parametrize(
    ("delimiter", "edit", "converted"),
    [
        ("\t", lambda lines: [*LABVIEW, *lines], 0),
        (",", lambda lines: ["Rig 3", "Recorded by,me", "", *lines], 0),
        (",", lambda lines: [lines[0], "s,rad,Nm", *lines[1:]], 0),
        (";", lambda lines: [*LABVIEW, lines[0], "[s];[rad];", *lines[1:]], 0),
        (",", lambda lines: ["t,q,tau,temperature", "s,deg,N m,degC", *(line + ",20" for line in lines[1:])], 1),
    ],
    ids="labview title units both foreign-unit".split(),
)
def test_what_stands_around_the_header(
    write: Write, columns: dict, swing: Recording, delimiter: str, edit: Callable, converted: int
) -> None:
    recording = read_recording(write(columns, delimiter=delimiter, edit=edit))
    factor = np.pi / 180 if converted else 1.0
    np.testing.assert_allclose(recording.position, factor * swing.position, atol=1e-8)
    assert len(recording.notes) == converted


@pytest.mark.parametrize("zone", ["", "Z", "+02:00"])
@pytest.mark.parametrize("between", ["T", " "])
def test_iso_time_is_counted_from_the_first_row(write: Write, columns: dict, zone: str, between: str) -> None:
    stamps = np.datetime64("2026-02-28T23:59:58", "us") + np.round(1e6 * columns["time"]).astype("timedelta64[us]")

    def dated(lines: list[str]) -> list[str]:
        cells = [str(stamp).replace("T", between) + zone for stamp in stamps]
        return [lines[0], *(f"{stamp},{line.split(',', 1)[1]}" for stamp, line in zip(cells, lines[1:], strict=True))]

    recording = read_recording(write(columns, edit=dated))
    np.testing.assert_allclose(recording.time, columns["time"], atol=1e-9)
    assert recording.notes == (f"time is counted from 2026-02-28{between}23:59:58.000000{zone}",)


@pytest.mark.parametrize(
    ("edit", "match"),
    [
        (lambda lines: lines[1:], "first row holds numbers .* put the header time,position,torque above"),
        (lambda lines: lines[:1], "header but no data"),
        (lambda lines: ["# nothing"], "comments but no header"),
        (
            lambda lines: [*lines[:12], "0.022,abc,1", *lines[13:]],
            r"data row 12 \(header not counted\) has 'abc' as pos",
        ),
        (
            lambda lines: [*lines[:12], f"0.022,{'1' * 100_000}x,1", *lines[13:]],
            "data row 12 .* has '1{27}...1{27}x' as position",
        ),
        (lambda lines: ["1" * 60_000 + "x", *lines[1:]], "no column for time, position, torque among '1{17}...1{17}x'"),
        (lambda lines: [*lines[:-2], "3.99", lines[-1]], "data row 1999 .* has 1 cells where the header has 3"),
        (lambda lines: ["time;position;torque", *lines[1:]], "data row 1 .* has 1 cells where the header has 3"),
        (
            lambda lines: [lines[0], *(line.rsplit(",", 1)[0] + ",nan" for line in lines[1:])],
            r"data row 1 \(header not counted\) has torque that is empty or NaN, as have 2000 of 2000 rows",
        ),
        (
            lambda lines: [lines[0], *(",nan,".join(line.split(",")[::2]) for line in lines[1:])],
            r"data row 1 \(header not counted\) has position that is empty or NaN, as have 2000 of 2000 rows",
        ),
        (
            lambda lines: [lines[0], *["0,1,", "0.1,,1"] * 100],
            "fewer than 100 rows have all of time, position and torque",
        ),
        (lambda lines: lines[:12] + lines[2:], "time falls from 0.02 to 0.002 s at data row 12 .* sort the rows"),
        (lambda lines: [lines[0], *("7," + line for line in lines[1:])], "has 4 cells where the header has 3"),
        (lambda lines: lines[:11], "holds 10 samples, of which at least 100"),
        (lambda lines: lines[:201], "lasts 0.398 s, of which at least 1 s"),
    ],
)
def test_text_refused(write: Write, columns: dict[str, np.ndarray], edit: Callable, match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        read_recording(write(columns, edit=edit))


def test_refusal_is_one_line_with_the_file(write: Write, columns: dict[str, np.ndarray]) -> None:
    path = write(columns, edit=lambda lines: ["time,'po\x00s\x1b',torque", *lines[1:]])
    with pytest.raises(RecordingError) as refusal:
        read_recording(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert str(refusal.value).isprintable()


@pytest.mark.parametrize("suffix", FORMATS)
def test_no_file_directory_empty_and_damaged(tmp_path: Path, swing: Recording, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(path)
    path.mkdir()
    with pytest.raises(RecordingError, match="it is a directory"):
        read_recording(path)
    path.rmdir()
    for content in (b"", b"\x1f\x8bgarbage", b"PK\x03\x04garbage", b"PAR1garbagePAR1", bytes(range(256))):
        path.write_bytes(content)
        with pytest.raises(RecordingError, match=r"run\."):
            read_recording(path)
    write_recording(swing, path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    if suffix == ".csv":  # was cut off while it was written
        assert len(read_recording(path)) >= len(swing) // 3
        return
    with pytest.raises(RecordingError):
        read_recording(path)


@pytest.mark.parametrize("name", ["run.docx", "run", ".csv", "run.gz"])
def test_unknown_ending(tmp_path: Path, name: str) -> None:
    with pytest.raises(RecordingError, match=r"does not end in \.csv, \.csv\.gz, \.tsv, \.txt, \.parquet, \.npz"):
        read_recording(tmp_path / name)


def test_misnamed_and_foreign_text(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(gzip.compress(b"time,position,torque\n"))
    with pytest.raises(RecordingError, match=r"gzipped: let its name end in \.csv\.gz"):
        read_recording(path)
    path.write_bytes("time,position,torque\n".encode("utf-16"))
    with pytest.raises(RecordingError, match="UTF-16: save it as UTF-8"):
        read_recording(path)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are text")
@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_name_that_is_no_utf_8_is_told(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"\udcff{ending}"
    path.write_bytes(b"time,position,torque\n")
    with pytest.raises(RecordingError, match="its name is no UTF-8, which libraries need: rename it"):
        read_recording(path)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"position": np.array([None] * 2000)}, "has type object"),
        ({"position": np.zeros((2000, 1, 2))}, r"shape \(2000, 1, 2\)"),
        ({"position": np.zeros(1999)}, "arrays differ in length"),
        ({"position": np.zeros(2000, dtype=complex)}, "has type complex128"),
    ],
)
def test_npz_refused(tmp_path: Path, columns: dict[str, np.ndarray], change: dict, match: str) -> None:
    np.savez(tmp_path / "run.npz", **(columns | change))
    with pytest.raises(RecordingError, match=match):
        read_recording(tmp_path / "run.npz")


# What a recording says


def spinning(time: np.ndarray) -> np.ndarray:
    return 30.0 * time + 0.3 * np.sin(30.0 * time)  # [rad], as gravity would have it


def test_a_steady_turn_says_nothing_of_degrees(write: Write, columns: dict[str, np.ndarray]) -> None:
    assert read_recording(write(columns | {"position": 5 * columns["time"]}, digits="%.17g")).notes == ()


def test_wrapped_angle_is_refused_and_unwrapped_on_request(write: Write, columns: dict[str, np.ndarray]) -> None:
    turns = spinning(columns["time"])
    path = write(columns | {"position": np.angle(np.exp(1j * turns))})
    first = int(np.argmax(turns > np.pi)) + 1
    with pytest.raises(RecordingError, match=rf"data row {first} .* wrapped at 2 pi does: read it with --unwrap"):
        read_recording(path)
    recording = read_recording(path, unwrap=True)
    np.testing.assert_allclose(recording.position, turns, atol=1e-8)
    assert recording.notes == ("position unwrapped at 19 jumps of 2 pi",)


@pytest.mark.parametrize("unwrap", [False, True])
def test_wrapped_degrees_are_refused(write: Write, columns: dict[str, np.ndarray], unwrap: bool) -> None:
    degrees = np.degrees(np.angle(np.exp(1j * spinning(columns["time"]))))
    with pytest.raises(
        RecordingError, match=r"wrapped at 360 degrees does: .* and with --columns position=position:deg"
    ):
        read_recording(write(columns | {"position": degrees}), unwrap=unwrap)


def test_wrapped_degrees_by_name_are_unwrapped_and_a_free_swing_needs_no_torque(
    write: Write, columns: dict[str, np.ndarray]
) -> None:
    turns = spinning(columns["time"])
    degrees = np.degrees(np.angle(np.exp(1j * turns)))
    path = write({"time": columns["time"], "position_deg": degrees, "torque": 0.0 * turns})
    recording = read_recording(path, unwrap=True)
    np.testing.assert_allclose(recording.position, turns, atol=1e-6)
    assert not recording.torque.any()


def test_degrees_by_speed(write: Write, columns: dict[str, np.ndarray]) -> None:
    with pytest.raises(
        RecordingError, match="faster than any arm: read it with --columns position=position:deg if it is"
    ):
        read_recording(write(columns | {"position": 2 * np.degrees(columns["position"])}))


def test_degrees_by_gravity(write: Write) -> None:
    time = np.arange(4000) / 200.0
    q, v = np.empty(4000), 0.0
    q[0] = 1.0
    for k in range(3999):  # semi-implicit Euler of a free swing of 57 degrees
        v += (-9.81 * np.sin(q[k]) - 0.2 * v) / 200.0
        q[k + 1] = q[k] + v / 200.0
    swing = {"time": time, "position": q, "torque": 0 * q}
    assert read_recording(write(swing)).notes == ()
    with pytest.raises(RecordingError, match="gravity acts on it as on degrees"):
        read_recording(write(swing | {"position": np.degrees(q)}))
    hours = np.arange(20_000) / 10.0
    slow = {"time": hours, "position": 57.0 * np.cos(hours / 300.0), "torque": 0 * hours}
    assert len(read_recording(write(slow))) == 20_000  # what accelerates so little tells nothing of gravity
    trusted = {"time": time, "position_rad": np.degrees(q), "torque": 0 * q}
    assert read_recording(write(trusted)).position.max() > 50  # its name says radians


@pytest.mark.parametrize(
    ("position", "velocity", "match"),
    [
        (1, 57.3, "as if in degrees per second: read it with --columns velocity=velocity:deg/s"),
        (1, -1, "opposite sign of the slope of position: read it with --columns velocity=-velocity"),
        (1, 6, "velocity is 6 times the slope of position: mend it, or do without .*: --columns velocity=unused"),
        (1, 0, r"does not follow the slope of position \(0.00 correlated\)"),
        (10, 10 / 57.3, "as fast as velocity says, as if in degrees: read it with --columns position=position:deg"),
    ],
)
def test_foreign_velocity_is_refused(
    write: Write, columns: dict, swing: Recording, position: float, velocity: float, match: str
) -> None:
    scaled = columns | {"position": position * swing.position, "velocity": velocity * swing.velocity}
    with pytest.raises(RecordingError, match=match):
        read_recording(write(scaled))


def test_constant_position_is_refused(write: Write, columns: dict[str, np.ndarray]) -> None:
    still = columns | {"position": np.full(2000, 0.25)}
    with pytest.raises(RecordingError, match=r"position is 0\.25 rad in every row"):
        read_recording(write(still))


def test_time_in_milliseconds_is_refused(write: Write, columns: dict[str, np.ndarray]) -> None:
    with pytest.raises(RecordingError, match=r"2 s pass between samples.* read it with --columns time=time:ms"):
        read_recording(write(columns | {"time": 1e3 * columns["time"]}))


# Uneven time


@pytest.mark.parametrize(("rate", "digits"), [(300, 3), (700, 4)])
def test_rounded_time_shifts_nothing(write: Write, rate: float, digits: int) -> None:
    time = np.arange(2000) / rate
    position, torque = np.sin(5 * time), np.sign(np.sin(40 * time))
    recording = read_recording(write({"t": np.round(time, digits), "q": position, "u": torque}))
    np.testing.assert_allclose(recording.position, position, atol=1e-9)
    np.testing.assert_array_equal(recording.torque, torque)
    assert recording.rate == pytest.approx(rate, rel=1e-4)
    assert "by rounding only" in recording.notes[0]


def test_single_precision_time_shifts_nothing(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    np.savez(tmp_path / "run.npz", **{name: column.astype(np.float32) for name, column in columns.items()})
    recording = read_recording(tmp_path / "run.npz")
    assert "by rounding only" in recording.notes[0]
    np.testing.assert_array_equal(recording.torque, columns["torque"].astype(np.float32))


def test_a_motor_is_off_from_the_sample_that_says_so_on_where_jitter_is_resampled(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    time = (np.arange(2000) + rng.uniform(-0.2, 0.2, 2000)) / 500
    on = (np.sin(5 * time) > -0.5).astype(float)
    rows = np.column_stack([time, np.sin(3 * time), np.cos(3 * time), on])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time,position,torque,enabled", comments="")
    read = read_recording(tmp_path / "log.csv")
    last = np.array([on[time <= now + 1e-9][-1] for now in read.time])
    assert any("resampled" in note for note in read.notes)
    np.testing.assert_array_equal(read.enabled, last)


def test_jitter_is_resampled_and_reported(write: Write) -> None:
    rng = np.random.default_rng(1)
    time = np.arange(2000) / 500.0
    time[1:-1] += rng.uniform(-0.3e-3, 0.3e-3, 1998)
    recording = read_recording(write({"t": time, "q": np.sin(12 * time), "u": np.cos(time)}, digits="%.17g"))
    assert recording.rate == pytest.approx(500.0)
    np.testing.assert_allclose(recording.position, np.sin(12 * recording.time), atol=1e-5)
    assert np.abs(np.sin(12 * time) - np.sin(12 * recording.time)).max() > 1e-3  # had it been left alone
    assert recording.notes[0].startswith("resampled to 500 Hz: steps were 1.4")


def test_resampling_keeps_the_impulse_of_the_torque(write: Write) -> None:
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.uniform(1.7e-3, 2.3e-3, 2000))
    torque = rng.normal(size=2000)
    recording = read_recording(write({"t": time, "q": np.sin(time), "u": torque}, digits="%.17g"))
    impulse = recording.torque[:-1].sum() / recording.rate
    assert impulse == pytest.approx(torque[:-1] @ np.diff(time), abs=1e-9)


LOST = "missing after"


@pytest.mark.parametrize(
    ("gone", "note"),
    [
        ([499], "1 sample is missing after 0.996 s: filled in by interpolation"),
        ([499, 500, 501], "3 samples are missing after 0.996 s: filled in by interpolation"),
        ([40, 777, 778], "3 samples are missing after 0.078, 1.552 s: filled in by interpolation"),
    ],
)
def test_lost_samples_are_filled_in_without_touching_the_others(
    write: Write, swing: Recording, gone: list[int], note: str
) -> None:
    whole = {"time": swing.time, "position": swing.position, "velocity": swing.velocity, "torque": swing.torque}
    path = write({name: np.delete(column, gone) for name, column in whole.items()}, digits="%.17g")
    recording = read_recording(path)
    assert recording.notes == (note,)
    assert len(recording) == len(swing)
    for name, column in whole.items():
        np.testing.assert_allclose(np.delete(getattr(recording, name), gone), np.delete(column, gone), atol=1e-12)
    np.testing.assert_allclose(recording.position, swing.position, atol=1e-5)
    np.testing.assert_allclose(recording.torque, swing.torque, atol=0.01)


def test_a_sample_lost_at_1_khz_is_told_from_a_clock_printed_in_milliseconds(write: Write) -> None:
    time = np.arange(5000) / 1000
    one = read_recording(write({"t": np.delete(time, 2000), "q": np.delete(np.sin(time), 2000), "u": time[1:]}))
    assert len(one) == 5000 and one.rate == pytest.approx(1000)
    assert LOST in one.notes[0] and not any("rounding" in note for note in one.notes)
    slow = np.arange(5000) / 999  # every 1000th step is of 2 ms
    other = read_recording(write({"t": np.round(slow, 3), "q": np.sin(slow), "u": time}))
    assert len(other) == 5000
    assert "by rounding only" in other.notes[0]


@pytest.mark.parametrize("every", [50, 200, 1000])
def test_samples_lost_at_regular_intervals_are_told_by_the_motion(every: int) -> None:
    time = np.arange(10_000) / 1000
    kept = np.arange(len(time)) % every != 37
    signals = {"time": time, "position": np.sin(3 * time) + 0.4 * np.sin(12 * time), "torque": np.cos(time)}
    log = Log({name: values[kept] for name, values in signals.items()})
    uniform(log)
    assert len(log.values["time"]) == len(time)
    assert log.values["position"] == pytest.approx(signals["position"], abs=1e-5)
    assert "missing" in log.notes[0] or "resampled" in log.notes[0]


def test_seconds_since_1970_keep_their_uniformity(write: Write, columns: dict[str, np.ndarray]) -> None:
    recording = read_recording(write(columns | {"time": 1.7e9 + columns["time"]}, digits="%.6f"))
    assert recording.rate == pytest.approx(500.0)
    np.testing.assert_allclose(recording.torque, columns["torque"], atol=1e-6)


# Size


def test_plain_text_is_read_in_this_process_unless_it_is_large(
    write: Write, columns: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(columns)
    with monkeypatch.context() as patch:
        patch.setattr(storage, "isolated", None)
        here = read_recording(path)
    monkeypatch.setattr(storage, "HERE", 1000)
    monkeypatch.setattr(storage, "read_here", None)
    there = read_recording(path)
    np.testing.assert_array_equal(here.position, there.position)


# Recordings at hand


@pytest.mark.slow
def test_practice_recordings_are_left_alone_and_refused_in_degrees(tmp_path: Path) -> None:
    paths = sorted((SHARED / "practice").glob("*.csv.gz"))
    if not paths:
        pytest.skip("the practice recordings are not on this machine")
    for path in paths:
        recording = read_recording(path)
        assert recording.rate == pytest.approx(round(recording.rate), rel=1e-12)
        assert recording.notes == ()
        disguised = Recording("deg", recording.time, np.degrees(recording.position), recording.torque)
        write_recording(disguised, tmp_path / "deg.npz")
        with pytest.raises(RecordingError, match=r"--columns position=position:deg"):
            read_recording(tmp_path / "deg.npz")


@pytest.mark.parametrize("bent", [0.0, 30.0])
def test_a_spring_is_not_taken_for_degrees(write: Write, bent: float) -> None:
    time, q, v = np.arange(4000) / 200.0, np.empty(4000), 0.0
    torque, q[0] = 40 * np.sin(0.4 * time) * np.sin(2 * time), 1.0
    for k in range(3999):  # semi-implicit Euler of a motor of 1 kg m^2 on a spring, without gravity
        v += (torque[k] - 9.81 * (q[k] + bent * (1 - np.cos(0.05 * q[k]))) - 0.2 * v) / 200.0
        q[k + 1] = q[k] + v / 200.0
    assert np.ptp(q) > 2 * np.pi  # less is no question
    (note,) = read_recording(write({"time": time, "position": q, "torque": torque})).notes
    assert "on which a spring acts; if it is degrees, read it with --columns position=position:deg" in note


@pytest.mark.parametrize(("drift", "asymmetry"), [(0.06, 0.0), (0.03, 0.4)])
def test_a_wheel_that_runs_off_under_a_torque_that_drifts_is_not_taken_for_degrees(
    write: Write, drift: float, asymmetry: float
) -> None:
    time, q, v = np.arange(4000) / 200.0, np.zeros(4000), 0.0
    torque = np.sin(2 * time) + 0.7 * np.sin(0.7 * time) - 0.6
    for k in range(3999):  # semi-implicit Euler of a wheel of 0.5 kg m^2, which no gravity acts on
        v += (torque[k] - drift * time[k] - (0.3 + asymmetry * (v > 0)) * v) / 0.5 / 200.0
        q[k + 1] = q[k] + v / 200.0
    assert q.min() < -30.0
    recording = read_recording(write({"time": time, "position": q, "torque": torque}))
    assert np.ptp(recording.position) == pytest.approx(np.ptp(q))
