"""Files of other programs: HDF5, Excel, Parquet of robot learning, bags of ROS and MCAP."""

import json
import os
import sqlite3
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pendulum_env.recording import Recording, RecordingError, read_recording
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.formats import read_table
from pendulum_env.recording.preview import read_preview
from tests.notes import list_notes

TIME = np.arange(1000) / 250


def signals() -> dict[str, np.ndarray]:
    return {"time": TIME, "position": np.sin(3 * TIME), "velocity": 3 * np.cos(3 * TIME), "torque": np.cos(2 * TIME)}


def assert_read(recording: Recording, atol: float = 1e-9) -> None:
    for quantity, values in signals().items():
        found = getattr(recording, quantity)
        if found is not None or quantity != "velocity":
            np.testing.assert_allclose(found - (found[0] if quantity == "time" else 0), values, atol=atol)


# HDF5 and NPZ


def test_hdf5_whose_datasets_have_two_names(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name, values in signals().items():
            file[f"bench/a_{name}"] = values
            file[f"bench/joint/{name}"] = file[f"bench/a_{name}"]
    assert_read(read_recording(tmp_path / "run.h5"))


def test_hdf5_reads_no_other_file_and_ends(tmp_path):
    h5py = pytest.importorskip("h5py")
    os.mkfifo(tmp_path / "pipe")  # reading it would wait
    layout = h5py.VirtualLayout((1000,), "f8")
    layout[:] = h5py.VirtualSource("/dev/zero", "torque", shape=(1000,))
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["group/time"] = TIME
        file.create_dataset("position", (1000,), "f8", external=[(str(tmp_path / "pipe"), 0, 8000)])
        file.create_virtual_dataset("torque", layout)
    with pytest.raises(RecordingError, match=r"run\.h5: no column for position, torque among 'group/time'"):
        read_recording(tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "a") as file:
        file["group/below"] = file["group"]
    with pytest.raises(RecordingError, match=r"run\.h5: not a readable .h5 file \(maximum recursion depth"):
        read_recording(tmp_path / "run.h5")


def test_npz_with_objects_and_a_note_beside_its_arrays(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", **signals(), settings=np.array({"kp": 3.0}, dtype=object))
    with zipfile.ZipFile(tmp_path / "run.npz", "a") as archive:
        archive.writestr("notes.txt", "by hand")
    assert_read(read_recording(tmp_path / "run.npz"))


def lone(path: Path, array: np.ndarray) -> None:
    with path.open("wb") as file:
        np.save(file, array)


def put(**changes: np.ndarray | list):
    return lambda path: np.savez(path, **(signals() | changes))


@pytest.mark.parametrize(
    ("name", "make", "match"),
    [
        ("run.npz", lambda path: lone(path, TIME), "no NPZ archive"),
        ("run.npz", lambda path: path.write_text("time,position\n"), "no NPZ archive"),
        (
            "run.npz",
            lambda path: np.savez(path, time=TIME, torque=np.cos(TIME), position=np.array([None] * 1000)),
            "no column for position",
        ),
        ("run.npz", put(position=np.zeros((1000, 3, 2))), r"shape \(1000, 3, 2\)"),
        ("run.npz", put(position=np.zeros((1000, 1, 2))), "could both be position"),
        ("run.npz", put(position=np.zeros(999)), "arrays differ in length"),
        ("run.npz", put(position=np.zeros(1000, dtype=complex)), "has type complex128"),
        (
            "run.parquet",
            lambda path: pq.write_table(pa.table(signals() | {"torque": ["a"] * 1000}), path),
            "data row 1 .* has 'a' as torque",
        ),
    ],
)
def test_arrays_that_are_no_recording_are_refused(tmp_path: Path, name: str, make, match: str) -> None:
    make(tmp_path / name)
    with pytest.raises(RecordingError, match=f"{name}: .*{match}"):
        read_recording(tmp_path / name)


# Parquet


def test_vectors_of_a_robot_learning_dataset(tmp_path: Path) -> None:
    s = signals()
    table = {
        "observation.state": np.column_stack([s["position"], 0 * TIME]).tolist(),
        "action": np.column_stack([s["position"] + 0.1, 0 * TIME]).tolist(),
        "observation.effort": np.column_stack([s["torque"], 0 * TIME]).tolist(),
        "timestamp": np.tile(TIME[:500], 2),
        "episode_index": np.repeat([7, 8], 500),
    }
    pq.write_table(pa.table(table), tmp_path / "file-000.parquet")
    with pytest.raises(RecordingError, match=r"'observation.state\[0\]' and .*state\[1\]' could both be position"):
        read_recording(tmp_path / "file-000.parquet")
    named = {"position": "observation.state[0]", "torque": "observation.effort[0]", "reference": "action[0]"}
    recording = read_recording(tmp_path / "file-000.parquet", columns=named)
    assert recording.starts == (0, 500) and recording.rate == pytest.approx(250)
    np.testing.assert_allclose(recording.position, s["position"])
    np.testing.assert_allclose(recording.reference, s["position"] + 0.1)


# JSON


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("run.json", lambda rows: json.dumps(rows)),
        ("run.json", lambda rows: json.dumps({"motor": "mx64", "mass": 1.0, "entries": rows})),
        ("run.json", lambda rows: json.dumps({key: [row[key] for row in rows] for key in rows[0]})),
        ("run.json", lambda rows: json.dumps({key: {k: row[key] for k, row in enumerate(rows)} for key in rows[0]})),
        ("run.jsonl", lambda rows: "\n".join(map(json.dumps, rows))),
    ],
)
def test_rows_and_columns_of_json(tmp_path: Path, name: str, make: Callable[[list[dict[str, float]]], str]) -> None:
    s = signals()
    columns = {"timestamp": TIME, "position": s["position"], "torque": s["torque"]}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*(x.tolist() for x in columns.values()), strict=True)]
    (tmp_path / name).write_text(make(rows))
    recording = read_recording(tmp_path / name)
    np.testing.assert_allclose(recording.position, s["position"])
    np.testing.assert_allclose(recording.torque, s["torque"])


def test_rows_of_json_may_lack_a_value(tmp_path: Path) -> None:
    names = ("time", "position", "torque")
    rows = [dict(zip(names, row, strict=True)) for row in zip(*(signals()[n].tolist() for n in names), strict=True)]
    del rows[0]["torque"]
    (tmp_path / "run.json").write_text(json.dumps(rows))
    recording = read_recording(tmp_path / "run.json")
    np.testing.assert_allclose(recording.torque, signals()["torque"][1:])
    assert "torque is empty or NaN in data row 1: left out" in list_notes(recording)


# Excel


def write_xlsx(path: Path, rows: list[list[object]]) -> None:
    """The least that is a workbook."""

    def cell(value: object) -> str:
        if isinstance(value, str):
            return f'<c t="inlineStr"><is><t>{escape(value)}</t></is></c>'
        return f"<c><v>{float(value)!r}</v></c>"  # type: ignore[arg-type]

    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006"
    sheet = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in rows)
    kind = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{package}/content-types">'
        '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        f'<Override PartName="/xl/workbook.xml" ContentType="{kind}.sheet.main+xml"/>'
        f'<Override PartName="/xl/worksheets/sheet1.xml" ContentType="{kind}.worksheet+xml"/></Types>',
        "_rels/.rels": f'<Relationships xmlns="{package}/relationships">'
        f'<Relationship Id="r1" Type="{office}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{office}">'
        '<sheets><sheet name="Run" sheetId="1" r:id="r1"/></sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{package}/relationships">'
        f'<Relationship Id="r1" Type="{office}/worksheet" Target="worksheets/sheet1.xml"/></Relationships>',
        "xl/worksheets/sheet1.xml": f'<worksheet xmlns="{main}"><sheetData>{sheet}</sheetData></worksheet>',
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, f'<?xml version="1.0" encoding="UTF-8"?>{content}')


def test_excel_with_a_title_and_units(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    s = signals()
    rows = np.column_stack([1e3 * s["time"], np.degrees(s["position"]), s["torque"]]).tolist()
    head = [["Bench 3", "", ""], ["Time", "Angle", "Torque"], ["ms", "deg", "Nm"]]
    write_xlsx(tmp_path / "run.xlsx", [*head, *rows])
    assert_read(read_recording(tmp_path / "run.xlsx"))


# ROS


def write_bag(path: Path, kind: str) -> None:
    """Joint states of two joints, whose order changes, and the torque of the first under a topic of its own."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    JointState, Float64 = store.types["sensor_msgs/msg/JointState"], store.types["std_msgs/msg/Float64"]
    Header, Time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    s = signals()
    if kind == "ros1":
        writer, serialize = Writer1(path), store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer, serialize = Writer2(path, version=9, storage_plugin=plugin), store.serialize_cdr
    with writer:
        joints = writer.add_connection("/joint_states", JointState.__msgtype__, typestore=store)
        motor = writer.add_connection("/motor/torque", Float64.__msgtype__, typestore=store)
        for k, seconds in enumerate(TIME):
            stamp = 1_700_000_000_000_000_000 + round(1e9 * seconds)
            seq = {"seq": k} if kind == "ros1" else {}
            header = Header(**seq, stamp=Time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
            first = -1 if k % 2 else 1
            message = JointState(
                header=header,
                name=["elbow", "wrist"][::first],
                position=np.array([s["position"][k], 9.0])[::first].copy(),
                velocity=np.array([s["velocity"][k], 9.0])[::first].copy(),
                effort=np.array([s["torque"][k], 9.0])[::first].copy(),
            )
            late = stamp + 700_000  # when it was received
            writer.write(motor, late - 900_000, serialize(Float64(data=s["torque"][k]), Float64.__msgtype__))
            writer.write(joints, late, serialize(message, JointState.__msgtype__))


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap", "undefined"])
def test_bags_of_ros(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ("run.bag" if kind == "ros1" else "run")
    write_bag(path, "sqlite3" if kind == "undefined" else kind)
    if kind == "undefined":  # as before ROS 2 Iron: what a message holds stands nowhere
        with closing(sqlite3.connect(path / "run.db3")) as database:
            database.execute("DELETE FROM message_definitions")
            database.commit()
    elbow = {what: f"/joint_states/elbow/{what}" for what in ("position", "velocity")}
    recording = read_recording(path, columns=elbow | {"torque": "-/joint_states/elbow/effort*-1"})
    assert recording.name == "run"
    assert_read(recording, atol=1e-6)
    other = read_recording(path, columns=elbow | {"torque": "/motor/torque/data"})
    assert_read(other, atol=1e-6)
    assert "torque is taken from /motor/torque at the times of /joint_states" in list_notes(other)
    seen = read_preview(path)
    assert {"/motor/torque/data", *elbow.values()} < set(seen.headers) and all(x is not None for x in seen.values)
    np.testing.assert_allclose(seen.values[seen.headers.index(elbow["position"])], signals()["position"], atol=1e-6)
    with pytest.raises(RecordingError, match="'/joint_states/elbow/position' and '/joint_states/wrist/position' could"):
        read_recording(path)
    if kind != "ros1":
        (inner,) = (file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))
        assert_read(read_recording(inner, columns=elbow | {"torque": "/motor/torque/data"}), atol=1e-6)


# What is refused


@pytest.mark.parametrize("suffix", [".h5", ".xlsx", ".mcap"])
def test_a_missing_extra_is_named(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pendulum_env.recording.table.find_spec", lambda name: None)
    path = tmp_path / f"run{suffix}"
    path.touch()
    with pytest.raises(RecordingError, match=r"pip install 'pendulum-ident\[formats\]'"):
        read_table(path, find_columns)
