"""Logs as programs of laboratories, workshops and classrooms export them: the right values, or the line to type."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from pendulum_env.recording import Recording, RecordingError, read_recording

RATE = 200.0
TIME = np.arange(800) / RATE
ANGLE = 0.9 * np.sin(3 * TIME) + 0.3 * np.sin(7 * TIME)
SPEED = 2.7 * np.cos(3 * TIME) + 2.1 * np.cos(7 * TIME)
TORQUE = np.round(np.sin(3 * TIME + 0.4) + 0.5 * np.sin(11 * TIME), 2)
DEGREES = np.degrees(ANGLE)
TIMES_OF_DAY = [f"12:{int(t // 60):02d}:{t % 60:06.3f}" for t in TIME]
MILLIS = np.round(1000 * TIME).astype(int)

Cells = Iterable[Any]


def text(header: str, *columns: Cells, sep: str = ",", comma: bool = False, quote: str = "") -> str:
    """Rows of cells, numbers with six decimals."""

    def cell(value: Any) -> str:
        written = f"{value:.6f}" if isinstance(value, float) else str(value)
        return quote + (written.replace(".", ",") if comma else written) + quote

    return "\n".join([header, *(sep.join(map(cell, row)) for row in zip(*columns, strict=True))]) + "\n"


def with_cells(value: str, *rows: int) -> list[Any]:
    return [value if k in rows else own for k, own in enumerate(ANGLE.tolist())]


LVM = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDate\t2026/03/01\n***End_of_Header***\t\n\t\n"
    "Channels\t2\t\t\nSamples\t800\t800\t\nDate\t2026/03/01\t2026/03/01\t\nX0\t0.0\t0.0\t\n***End_of_Header***\t\t\t\n"
)
ROSTOPIC = "%time,field.header.seq,field.name0,field.position0,field.velocity0,field.effort0"
START = 1.6e9  # [s] since 1970
NANOSECONDS = 1_700_000_000_000_000_000 + np.round(1e9 * TIME).astype(np.int64)
ALIGNED = [f"{t:9.3f}{q:10.5f}{u:9.3f}" for t, q, u in zip(TIME, ANGLE, TORQUE, strict=True)]
ARRIVED = [f"{at} -> {t},{q:.6f},{u}" for at, t, q, u in zip(TIMES_OF_DAY, MILLIS, ANGLE, TORQUE, strict=True)]
HALVES = [
    text("time,angle,torque", *(x[part] for x in (TIME, ANGLE, TORQUE))) for part in (slice(400), slice(400, 800))
]

SECONDS, FRACTIONS = np.divmod(NANOSECONDS, 10**9)
JOINTS = TORQUE, ANGLE, -TORQUE, 2 * ANGLE  # torque and angle of the first and of another

DRIVEN: dict[str, str] = {
    # clocks
    **{
        f"{seconds} and {fraction}": text(f"{seconds},{fraction},position,effort", SECONDS, parts, ANGLE, TORQUE)
        for seconds, fraction, parts in (
            ("header.stamp.secs", "header.stamp.nsecs", FRACTIONS),
            ("stamp_sec", "stamp_nanosec", FRACTIONS),
            ("ZeitInSec", "ZeitInNanoSec", FRACTIONS),
            ("sec", "usec", FRACTIONS // 1000),
        )
    },
    **{
        f"dates in column {name!r}": text(
            f"{name};theta;tau", [f"{date} {t}{end}" for t in TIMES_OF_DAY], ANGLE, TORQUE, sep=";"
        ).replace(";", delimiter)
        for name, date, end, delimiter in (
            ("date", "2026-03-01", "", ","),
            ("created_at", "2026/03/01", "", ","),
            ("Datum", "01.03.2026", "", ";"),
            ("time", "03/01/2026", " PM", ","),
            ("", "2026-03-01", "+02:00", ","),
        )
    },
    **{
        f"clock {name!r}": text(f"{name},theta,tau", column, ANGLE, TORQUE)
        for name, column in (("clock", TIME), ("sim_time", TIME), ("system_time_ms", MILLIS), ("utime", 1000 * MILLIS))
    },
    # joints
    **{
        names: text(f"time,{names}", TIME, ANGLE, TORQUE)
        for names in (
            "q1,tau1",
            "position_0,effort_0",
            "LF_HAA_q,LF_HAA_tau",
            "FL0_pos,FL0_torque",
            "joint_position,joint_effort",
            "actual_q_0,target_moment_0",
            "PLC_PRG.fActPos,PLC_PRG.fActTorque",
            "axisQMsr_LBR[3],axisTauMsr_LBR[3]",
            "Pos_Fbk (rad),Trq_Fbk (Nm)",
            "Joint 1 Position (rad),Joint 1 Torque (N-m)",
        )
    },
    "times of day": text("Time,theta,tau", TIMES_OF_DAY, ANGLE, TORQUE),
    "date and time of day": text("Date,Time,theta,tau", ["2026-03-01"] * 800, TIMES_OF_DAY, ANGLE, TORQUE),
    "minutes and seconds": text(
        "time;theta;tau", [f"{int(t // 60):02d}:{t % 60:06.3f}" for t in TIME], ANGLE, TORQUE, sep=";", comma=True
    ),
    "dates with a comma": text(
        "timestamp;theta;tau", [f"2026-03-01 {t}" for t in TIMES_OF_DAY], ANGLE, TORQUE, sep=";", comma=True
    ),
    "milliseconds of an Arduino": text("millis,angle,torque", MILLIS, ANGLE, TORQUE),
    "two clocks": text("time,ms,angle,torque", TIME, MILLIS, ANGLE, TORQUE),
    "a counter of 32 bits": text("micros,angle,torque", (4_293_000_000 + 1000 * MILLIS) % 2**32, ANGLE, TORQUE),
    "rostopic echo -p": text(ROSTOPIC, NANOSECONDS, MILLIS, ["hip"] * 800, ANGLE, SPEED, TORQUE),
    "a serial monitor": "12:00:00.000 -> millis,angle,torque\n" + "\n".join(ARRIVED) + "\n",
    "LabVIEW": LVM + text("X_Value\tangle\ttorque\tComment", TIME, ANGLE, TORQUE, sep="\t"),
    # turns and degrees
    "quantity / unit": text("t / s;phi / °;tau / Nm", TIME, DEGREES, TORQUE, sep=";", comma=True),
    "quantity in unit": text("Time in s,Angle in degrees,Torque in Nm", TIME, DEGREES, TORQUE),
    "turns of a shaft": text("Time (sec),Shaft position (revs),Shaft torque (N-m)", TIME, ANGLE / (2 * np.pi), TORQUE),
    "a row of units": text("time,angle,torque\ns,deg,mNm", TIME, DEGREES, 1000 * TORQUE),
    "thousandths of a degree": text("time_ms,angle_mdeg,torque", MILLIS, 1000 * DEGREES, TORQUE),
    # cells
    "N/A": text("time,angle,torque", TIME, with_cells("N/A", 90, 91), TORQUE),
    "division by zero": text("time,angle,torque", TIME, with_cells("#DIV/0!", 90), TORQUE),
    "quoted decimal commas": text('"Time (s)","Angle (rad)","Torque (Nm)"', TIME, ANGLE, TORQUE, comma=True, quote='"'),
    "a delimiter at the end": text("time,angle,torque", TIME, ANGLE, TORQUE, [""] * 800),
    "a comment between rows": HALVES[0] + "# pushed by hand\n" + HALVES[1].partition("\n")[2],
    "aligned columns": "  Time (s)  Angle (rad)  Torque (Nm)\n" + "\n".join(ALIGNED) + "\n",
}
FREE: dict[str, str] = {  # without torque
    "phyphox": text('"Time (s)","Angle (deg)","Angular velocity (rad/s)"', TIME, DEGREES, SPEED),
    "Tracker": "mass_A\n" + text("t\tx\ty\tθ", TIME, np.sin(ANGLE), -np.cos(ANGLE), ANGLE, sep="\t"),
    "Vernier": text(
        "Latest: Time (s)\tLatest: Angle (rad)\tLatest: Acceleration (rad/s²)", TIME, ANGLE, -ANGLE, sep="\t"
    ),
    "PASCO": text("Time (s) Run #1,Angle (rad) Run #1,Angular Velocity (rad/s) Run #1", TIME, ANGLE, SPEED),
    "Arduino": text("millis,angle", MILLIS, ANGLE),
    "a clock named by its unit": text("ms,angle", MILLIS, ANGLE),
    "a spreadsheet": text("t;phi", TIME, ANGLE, sep=";", comma=True),
    "comments above": "# Group 3\n# L = 0.32 m\n" + text("# t [s], theta [rad]", TIME, ANGLE),
    "frames of a video": text("frame,time,angle", range(800), TIME, ANGLE),
    "pandas": text(",time,angle", range(800), TIME, ANGLE),
    "aligned columns": "     time     angle\n" + "\n".join(row[:19] for row in ALIGNED) + "\n",
}
ASKED: dict[str, tuple[str, str, dict[str, str]]] = {  # text, what is said, and the line that reads it
    "samples": (text("sample,angle,torque", range(800), ANGLE, TORQUE), "time=sample/RATE", {"time": "sample/200"}),
    "another language": (
        text("Zeit [s];Winkel [Grad];Moment [Nm]", TIME, DEGREES, TORQUE, sep=";"),
        "--columns position=NAME",
        {"position": "Winkel [Grad]:deg"},
    ),
    "degrees without a unit": (
        text("Time (s),Angle,Torque", TIME, 20 * DEGREES, TORQUE), "position=Angle:deg", {"position": "Angle:deg/20"},
    ),
    "a symbol with a unit": (
        text("t / s;phi / °;M / Nm", TIME, DEGREES, TORQUE, sep=";"), "'torque=M / Nm'", {"torque": "M / Nm"},
    ),
    "Dynamixel Wizard": (
        text("Time(ms),[ID:001] Present Position,[ID:001] Present Current", MILLIS, 1e6 * (1 + ANGLE / np.pi), TORQUE),
        "'position=[ID:001] Present Position:counts/4096,torque=[ID:001] Present Current:A*0.1'",
        {"position": "[ID:001] Present Position:counts/2000000-180:deg", "torque": "[ID:001] Present Current:A*1"},
    ),
    "EPOS Studio": (
        "EPOS Studio Data Recorder\n" + text(
            "Time [ms];Position actual value [inc];Torque actual value [mNm]", MILLIS, 1e6 * ANGLE, 1000 * TORQUE,
            sep=";", comma=True,
        ),
        "'position=Position actual value [inc]:counts/4096'",
        {"position": "Position actual value [inc]*1e-6"},
    ),
    "an oscilloscope": (
        text("x-axis,1,2\nsecond,Volt,Volt", TIME, ANGLE / 2, TORQUE / 3),
        "'Volt (1)', 'Volt (2)'",
        {"position": "Volt (1)*2", "torque": "Volt (2)*3"},
    ),
    "two joints by path": (
        text("__time,/js/elbow/effort,/js/elbow/position,/js/wrist/effort,/js/wrist/position", TIME, *JOINTS),
        "say which with --columns position=NAME",
        {"position": "/js/elbow/position"},
    ),
    "two joints by number": (
        text("t,tau1,q1,tau2,q2", TIME, *JOINTS), "say which with --columns position=NAME", {"position": "q1"},
    ),
    "two joints by index": (
        text("time,tau_J[0],q[0],tau_J[1],q[1],tau_J_d[0]", TIME, *JOINTS, -TORQUE),
        "say which with --columns position=NAME",
        {"position": "q[0]"},
    ),
    "two joints, by the torque of one": (
        text("timestamp,joint_1_effort,joint_1_pos,joint_2_effort,joint_2_pos", TIME, *JOINTS),
        "say which with --columns position=NAME",
        {"torque": "joint_1_effort"},
    ),
    "the current of a named joint": (
        text("time,ODrive0Position,ODrive0Current", TIME, ANGLE, 10 * TORQUE),
        "'torque=ODrive0Current:A*0.1'",
        {"torque": "ODrive0Current:A*0.1"},
    ),
    "whole numbers of a drive": (
        text("time,position,torque", TIME, ANGLE, np.round(100 * TORQUE).astype(int)),
        "'torque=torque*0.001' with the torque of a count",
        {"torque": "torque*0.01"},
    ),
    "an error of torque": (
        text("time,torque_error,position_error", TIME, TORQUE, ANGLE),
        "position=NAME,torque=NAME",
        {"position": "position_error", "torque": "torque_error"},
    ),
    "rows without names": (
        text("1712000000.5,joint1,0.2,0.1", TIME, ["joint1"] * 800, ANGLE, TORQUE), "has no header", {},
    ),
    "rows of two joints": (
        text(
            "time,joint,position,torque", np.repeat(TIME, 2), ["a", "b"] * 800,
            np.stack([ANGLE, ANGLE + 2], 1).ravel(), np.repeat(TORQUE, 2),
        ),
        "rows are of several joints", {},
    ),
}  # fmt: skip


def check(recording: Recording, torque: np.ndarray) -> None:
    assert len(recording) == len(TIME) and recording.starts == (0,)
    np.testing.assert_allclose(recording.time - recording.time[0], TIME, rtol=0, atol=2e-6)
    np.testing.assert_allclose(recording.position, ANGLE, atol=2e-5)
    np.testing.assert_allclose(recording.torque, torque, atol=6e-3)  # also where one was interpolated


def written(folder: Path, content: str, name: str) -> Path:
    path = folder / ("run.lvm" if name == "LabVIEW" else "run.csv")
    path.write_text(content, encoding="utf-8")
    return path


@pytest.mark.parametrize(("logs", "name"), [(logs, name) for logs in (DRIVEN, FREE) for name in logs])
def test_an_export_is_read(tmp_path: Path, logs: dict[str, str], name: str) -> None:
    check(read_recording(written(tmp_path, logs[name], name)), TORQUE * (logs is DRIVEN))


@pytest.mark.parametrize("name", ASKED)
def test_an_export_that_is_not_clear_is_asked_for_in_a_line(tmp_path: Path, name: str) -> None:
    content, said, columns = ASKED[name]
    path = written(tmp_path, content, name)
    with pytest.raises(RecordingError) as refusal:
        read_recording(path)
    assert said in str(refusal.value)
    if columns:
        check(read_recording(path, columns=columns), TORQUE)


def test_times_of_day_go_on_after_midnight(tmp_path: Path) -> None:
    late = [(23 * 3600 + 3598 + t) % 86400 for t in TIME]
    times = [f"{int(t // 3600):02d}:{int(t % 3600 // 60):02d}:{t % 60:06.3f}" for t in late]
    check(read_recording(written(tmp_path, text("time,theta,tau", times, ANGLE, TORQUE), "")), TORQUE)


LVM = "\t\r\n".join(
    [
        "LabVIEW Measurement", "Separator\tTab", "Decimal_Separator\t,", "X_Columns\tNo", "***End_of_Header***", "",
        "Channels\t4\t\t\t", "Y_Unit_Label\tms\t°\tmNm\tV", "X0" + "\t0,0E+0" * 4, "***End_of_Header***\t\t\t",
    ]
)  # fmt: skip


def test_empty_columns_give_way_and_units_in_brackets_need_not_be_told(tmp_path: Path) -> None:
    def table(*names: str) -> Path:
        cells = (MILLIS, DEGREES, 1e3 * TORQUE, TORQUE / 0.04)
        rows = ["".join(f"\t{x:.9f}".replace(".", ",") for x in row) for row in zip(*cells, strict=True)]
        header = "\t".join(["X_Value", *names, "Stellgröße [V]", "Comment"])
        (tmp_path / "run.lvm").write_bytes("\r\n".join([LVM, header, *rows, ""]).encode("cp1252"))
        return tmp_path / "run.lvm"

    path = table("Zeit [ms]", "Winkel [°]", "Drehmoment [mNm]")
    check(read_recording(path), TORQUE)
    check(read_recording(path, columns={"time": "Zeit", "torque": "Drehmoment", "position": "Winkel"}), TORQUE)
    check(read_recording(path, columns={"torque": "-Drehmoment*2"}), -2 * TORQUE)
    path = table("Zeit [ms]", "phi2 [°]", "M [mNm]")
    with pytest.raises(RecordingError, match=r"'torque=M \[mNm\]'") as refusal:
        read_recording(path)
    assert "Stellgröße [V]:" not in str(refusal.value)


@pytest.mark.parametrize("told", ["current*0.1", "current:A*?"])
def test_a_current_that_no_joint_draws_is_asked_for_its_unit(told: str) -> None:
    log = {"time": TIME, "angle": ANGLE, "current": 1600 * np.cos(TIME)}
    with pytest.raises(RecordingError, match="'torque=current:mA"):
        read_recording(log, columns={"torque": told})
    assert read_recording(log, columns={"torque": "current:mA*0.1"}).torque.max() == pytest.approx(0.16, rel=1e-3)
    log["current [A]"] = log.pop("current")
    assert read_recording(log, columns={"torque": "current*0.1"}).torque.max() == pytest.approx(160, rel=1e-3)


def test_a_torque_of_whole_newton_metres_is_read_by_its_unit() -> None:
    log = {"time": TIME, "angle": ANGLE, "torque": np.round(150 * np.cos(TIME))}
    with pytest.raises(RecordingError, match="torque:Nm"):
        read_recording(log)
    np.testing.assert_array_equal(read_recording(log, columns={"torque": "torque:Nm"}).torque, log["torque"])


def test_whole_numbers_that_jump_are_counts() -> None:
    counts = np.round(16384 * (TIME / 3 % 1.0))
    with pytest.raises(RecordingError, match="position=angle:counts/4096") as refusal:
        read_recording({"time": TIME, "angle": counts, "torque": TORQUE})
    assert "deg" not in str(refusal.value)


def signals(key: str, values: str, *columns: tuple[str, np.ndarray]) -> np.ndarray:
    return np.array([{key: label, values: column[:, None]} for label, column in columns], dtype=object)


LABELLED = (("theta", ANGLE), ("tau", TORQUE))
ROWS = np.array(list(zip(TIME, ANGLE, TORQUE, strict=True)), dtype=[("t", "f8"), ("theta", "f8"), ("tau", "f8")])
MATLAB: dict[str, tuple[dict[str, Any], dict[str, str]]] = {
    "vectors and constants": ({"t": TIME[None], "theta": ANGLE[None], "tau": TORQUE[None], "J": 0.05, "who": "me"}, {}),
    "structure with time": ({"out": {"time": TIME[:, None], "signals": signals("label", "values", *LABELLED)}}, {}),
    "matrices with sides of one": (
        {
            name: {"data": gain * np.stack([0 * TIME, column])[:, None], "timestamps": START + TIME[None], "name": name}
            for name, column, gain in (("enc", ANGLE, np.degrees(1)), ("tau", TORQUE, 1.0))
        },
        {"position": "enc.data[1]:deg", "torque": "tau.data[1]"},
    ),
    "one matrix of signals": (
        {"yout": {"time": TIME, "signals": {"values": np.column_stack([ANGLE, TORQUE]), "label": ""}}},
        {"position": "yout.signals.values[0]", "torque": "yout.signals.values[1]"},
    ),
    "tout and yout": (
        {"tout": TIME[:, None], "yout": np.column_stack([ANGLE, TORQUE])},
        {"position": "yout[0]", "torque": "yout[1]"},
    ),
    "dSPACE": ({"run": {"X": {"Name": "Time", "Data": TIME}, "Y": signals("Name", "Data", *LABELLED)}}, {}),
    "a structure for each quantity": ({name: {"Time": TIME, "Data": column} for name, column in LABELLED}, {}),
    "a structure for each row": ({"log": ROWS}, {}),
    "two runs": (
        {name: {"t": TIME, "theta": ANGLE * gain, "tau": TORQUE} for name, gain in (("run1", 1), ("run2", 2))},
        {"position": "run1.theta", "torque": "run1.tau"},
    ),
}


def write_matlab_73(path: Path, content: dict[str, Any]) -> None:
    """Write structures as MATLAB 7.3 does: arrays of structures and cells hold references, matrices are transposed."""
    h5py = pytest.importorskip("h5py")

    def put(group: Any, name: str, value: Any) -> Any:
        if isinstance(value, dict):
            own = group.create_group(name)
            own.attrs["MATLAB_class"] = np.bytes_("struct")
            for key, inner in value.items():
                put(own, key, inner)
            return own
        if isinstance(value, np.ndarray) and value.dtype.names:
            value = np.array([dict(zip(value.dtype.names, row, strict=True)) for row in value.tolist()], dtype=object)
        if isinstance(value, np.ndarray) and value.dtype == object:
            own = group.create_group(name)
            own.attrs["MATLAB_class"] = np.bytes_("struct")
            for key in value[0]:
                links = own.create_dataset(key, (len(value), 1), dtype=h5py.ref_dtype)
                for k, row in enumerate(value):
                    links[k, 0] = put(file["#refs#"], str(len(file["#refs#"])), row[key]).ref
            return own
        is_text = isinstance(value, str)
        array = np.array([[ord(sign)] for sign in value], np.uint16) if is_text else np.atleast_2d(value).T
        own = group.create_dataset(name, data=array if array.size else np.zeros(2, np.uint64))
        own.attrs["MATLAB_class"] = np.bytes_("char" if is_text else "double")
        if not array.size:
            own.attrs["MATLAB_empty"] = np.uint8(1)
        return own

    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_group("#refs#")
        for name, value in content.items():
            put(file, name, value)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(128))


SCOPES = np.array(
    [
        {"values": np.column_stack([0 * ANGLE, ANGLE]), "dimensions": 2.0, "label": "", "title": "theta_ref, theta"},
        {"values": TORQUE[:, None], "dimensions": 1.0, "label": "tau_m", "title": ""},
    ],
    dtype=object,
)
MATLAB["scopes of several signals"] = (
    {"out": {"time": TIME[:, None], "signals": SCOPES, "blockName": "rig/Scope"}, "Ts": 0.01},
    {"position": "out.signals[0].values[1]"},
)


@pytest.mark.parametrize("name", MATLAB)
def test_structures_of_matlab_of_any_version(tmp_path: Path, name: str) -> None:
    content, columns = MATLAB[name]
    write_matlab_73(tmp_path / "new.mat", content)
    scipy.io.savemat(tmp_path / "old.mat", content)
    series = []
    for file in (tmp_path / "new.mat", tmp_path / "old.mat"):
        check(recording := read_recording(file, columns=columns), TORQUE)
        series.append(recording.series.keys())
        if columns:
            with pytest.raises(RecordingError, match=r"say which with --columns|no column for"):
                read_recording(file)
    assert series[0] == series[1]
