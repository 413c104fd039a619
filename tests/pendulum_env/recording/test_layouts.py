"""Layouts that programs write: cells that are words or empty, turns, structures of MATLAB 7.3."""

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.integrate

from estimators import identify
from pendulum_env.recording import Recording, RecordingError, read_recording
from pendulum_env.recording.errors import ColumnError

TRUTH = {"inertia": 0.05, "gravity": 1.5, "viscous": 0.12, "coulomb": 0.0}


def swing(seconds: float = 12.0, rate: float = 200.0) -> dict[str, np.ndarray]:
    """A driven pendulum of the truth, by SciPy."""
    time = np.arange(round(seconds * rate)) / rate
    torque = np.round(1.8 * np.sin(4.1 * time) + 1.2 * np.sin(9.7 * time + 1), 2)

    def slope(t: float, state: np.ndarray) -> list[float]:
        u = torque[min(int(t * rate + 1e-9), len(torque) - 1)]
        q, v = state
        return [v, (u - TRUTH["gravity"] * np.sin(q) - TRUTH["viscous"] * v) / TRUTH["inertia"]]

    position = [np.zeros(2)]
    for a, b in pairwise(time):
        position.append(scipy.integrate.solve_ivp(slope, (a, b - 1e-12), position[-1], rtol=1e-8, atol=1e-10).y[:, -1])
    q, v = np.array(position).T
    return {"time": time, "position": q, "velocity": v, "torque": torque}


@pytest.fixture(scope="module")
def run() -> dict[str, np.ndarray]:
    return swing()


def check(recording: Recording) -> None:
    found = identify(recording, schemes="filtered_dynamic").windows.estimates
    for name, value in TRUTH.items():
        assert found[name].value == pytest.approx(value, rel=0.02, abs=5e-3), name


def write(path: Path, header: str, rows: Iterable[Iterable[str]]) -> Path:
    path.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n")
    return path


def only_changes(values: np.ndarray, digits: int) -> list[str]:
    texts = [f"{value:.{digits}f}" for value in values]
    return [text if k == 0 or text != texts[k - 1] else "" for k, text in enumerate(texts)]


def test_cells_that_are_empty_unless_changed_hold_the_last_value(tmp_path: Path, run) -> None:
    turns = np.round(run["position"] / (2 * np.pi) * 4096) / 4096
    columns = [[f"{t:.6f}" for t in run["time"]], only_changes(turns, 6), only_changes(run["torque"], 2)]
    enabled = ["true", *[""] * (len(turns) - 1)]
    path = write(
        tmp_path / "run.csv",
        "Timestamp,/Arm/PositionRotations,/Arm/Torque,/DS/Enabled",
        zip(*columns, enabled, strict=True),
    )
    recording = read_recording(path)
    assert len(recording) == len(turns)
    np.testing.assert_allclose(recording.torque, run["torque"], atol=1e-9)
    np.testing.assert_allclose(recording.position, 2 * np.pi * turns, atol=1e-5)
    assert recording.enabled is not None and recording.enabled.all()
    check(recording)


def test_lost_cells_of_a_column_that_repeats_are_no_values_that_are_held(tmp_path: Path, run) -> None:
    lost = np.zeros(len(run["time"]), dtype=bool)
    lost[np.random.default_rng(0).choice(np.arange(50, len(lost) - 50), 30, replace=False)] = True
    torque = np.repeat(run["torque"][::4], 4)[: len(lost)]
    cells = ["" if gone else f"{u:.2f}" for u, gone in zip(torque, lost, strict=True)]
    rows = zip((f"{t:.3f}" for t in run["time"]), (f"{q:.9f}" for q in run["position"]), cells, strict=True)
    recording = read_recording(write(tmp_path / "run.csv", "time,position,torque", rows))
    assert any("left out" in note for note in recording.notes)


def test_lost_cells_of_a_column_that_never_repeats_are_not_held(tmp_path: Path, run) -> None:
    lost = np.zeros(len(run["time"]), dtype=bool)
    lost[np.random.default_rng(0).choice(np.arange(50, len(lost) - 50), 30, replace=False)] = True
    turning = [[f"{t:.3f}", "" if gone else f"{10 * t:.3f}", f"{u:.2f}"]
               for t, u, gone in zip(run["time"], run["torque"], lost, strict=True)]  # fmt: skip
    ramp = np.cumsum(np.where(np.arange(len(lost)) % 100 < 50, 0.01, -0.01))
    ramped = [[f"{t:.3f}", f"{q:.9f}", "" if gone else f"{u:.2f}"]
              for t, q, u, gone in zip(run["time"], run["position"], ramp, lost, strict=True)]  # fmt: skip
    for rows, quantity in ((turning, "position"), (ramped, "torque")):
        recording = read_recording(write(tmp_path / "run.csv", "time,position,torque", rows))
        assert any(note.startswith(f"{quantity} is empty") for note in recording.notes)
    np.testing.assert_allclose(recording.position, run["position"], atol=1e-3)


def test_truth_values_are_no_torque(tmp_path: Path, run) -> None:
    rows = [[f"{t:.3f}", f"{q:.9f}", "true"] for t, q in zip(run["time"], run["position"], strict=True)]
    with pytest.raises(RecordingError, match=r"data row 1 .* has 'true' as torque, not a number"):
        read_recording(write(tmp_path / "run.csv", "time,position,torque", rows))


@pytest.mark.parametrize("kind", [pa.string(), pa.large_string(), pa.dictionary(pa.int32(), pa.string())])
def test_labels_of_parquet_begin_a_segment_where_they_change(tmp_path: Path, run, kind: pa.DataType) -> None:
    half = len(run["time"]) // 2
    labels = pa.array(["up"] * half + ["down"] * (len(run["time"]) - half)).cast(kind)
    pq.write_table(pa.table({**{name: run[name] for name in ("time", "position", "torque")}, "segment": labels}),
                   tmp_path / "run.parquet")  # fmt: skip
    assert read_recording(tmp_path / "run.parquet").starts == (0, half)


@pytest.mark.parametrize(("yes", "no"), [("true", "false"), ("True", "False"), ("TRUE", "FALSE"), ("1", "0")])
def test_true_and_false_are_1_and_0(tmp_path: Path, run, yes: str, no: str) -> None:
    on = np.sin(3 * run["time"]) > -0.8
    rows = zip(
        (f"{t:.3f}" for t in run["time"]),
        (f"{q:.9f}" for q in run["position"]),
        (f"{u:.2f}" for u in run["torque"]),
        np.where(on, yes, no),
        strict=True,
    )
    recording = read_recording(write(tmp_path / "run.csv", "time,position,torque,enabled", rows))
    np.testing.assert_array_equal(recording.enabled, on.astype(float))
    np.testing.assert_array_equal(recording.torque, np.where(on, run["torque"], 0.0))


@pytest.mark.parametrize("name", ["segment", "state", "phase", "test"])
def test_labels_in_words_begin_a_segment_where_they_change(tmp_path: Path, run, name: str) -> None:
    third = len(run["time"]) // 3
    labels = ["homing"] * third + ["sweep up"] * third + ["homing"] * (len(run["time"]) - 2 * third)
    rows = [
        [f"{t:.3f}", f"{q:.9f}", f"{u:.2f}", label]
        for t, q, u, label in zip(run["time"], run["position"], run["torque"], labels, strict=True)
    ]
    assert read_recording(write(tmp_path / "run.csv", f"time,position,torque,{name}", rows)).starts == (
        0,
        third,
        2 * third,
    )
    if name != "segment":  # numbers of these are other quantities, as the phase of a motor
        rows = [[*row[:3], f"{k % 7}"] for k, row in enumerate(rows)]
        assert read_recording(write(tmp_path / "run.csv", f"time,position,torque,{name}", rows)).starts == (0,)


def test_an_optional_column_that_cannot_be_read_is_left_out_with_a_note(tmp_path: Path, run) -> None:
    rows = [
        [f"{t:.3f}", f"{q:.9f}", f"{u:.2f}", "n/a"]
        for t, q, u in zip(run["time"], run["position"], run["torque"], strict=True)
    ]
    path = write(tmp_path / "run.csv", "time,position,torque,temperature", rows)
    recording = read_recording(path)
    assert recording.temperature is None and any("temperature is left out" in note for note in recording.notes)
    with pytest.raises(RecordingError, match="'n/a' as temperature"):
        read_recording(path, columns={"temperature": "temperature"})


@pytest.mark.parametrize(("unit", "factor"), [("rev", 1 / (2 * np.pi)), ("deg", 180 / np.pi)])
def test_a_unit_that_the_motion_excludes_is_refused_with_the_line_that_reads_it(
    tmp_path: Path, run, unit, factor
) -> None:
    np.savez(tmp_path / "run.npz", t=run["time"], pos=factor * run["position"], tau=run["torque"])
    with pytest.raises(ColumnError, match=f"position=pos:{unit}"):
        read_recording(tmp_path / "run.npz")
    check(read_recording(tmp_path / "run.npz", columns={"position": f"pos:{unit}"}))


@pytest.mark.parametrize(
    "header",
    [
        "time,MODE,POSITION,VELOCITY,TORQUE,FAULT",
        "timestamp,mode,position,velocity,torque,fault",
        "t,Mode,Position,Velocity,Torque,Q_Current",
        "timestamp,d_current,position,velocity,torque,q_current",
    ],
)
def test_columns_of_moteus_are_turns(tmp_path: Path, run, header: str) -> None:
    turn = 2 * np.pi
    rows = [
        [f"{t:.3f}", "10", f"{0.2 * q / turn:.9f}", f"{0.2 * v / turn:.6f}", f"{u:.2f}", "0"]
        for t, q, v, u in zip(run["time"], run["position"], run["velocity"], run["torque"], strict=True)
    ]
    recording = read_recording(write(tmp_path / "run.csv", header, rows))
    assert recording.position == pytest.approx(0.2 * run["position"], abs=1e-6)
    assert recording.velocity == pytest.approx(0.2 * run["velocity"], abs=1e-4)
    assert any("position converted to rad" in note for note in recording.notes)


@pytest.mark.parametrize("name", ["tau_est", "tauEst", "estimated_torque", "torque_est"])
def test_an_estimated_torque_is_known_by_name_and_gives_way_to_a_measured_one(tmp_path: Path, run, name: str) -> None:
    np.savez(tmp_path / "run.npz", t=run["time"], q=run["position"], **{name: run["torque"]})
    np.testing.assert_array_equal(read_recording(tmp_path / "run.npz").torque, run["torque"])
    np.savez(tmp_path / "run.npz", t=run["time"], q=run["position"], tau=run["torque"], **{name: 0 * run["torque"]})
    np.testing.assert_array_equal(read_recording(tmp_path / "run.npz").torque, run["torque"])


def test_structures_of_matlab_73_are_dotted_paths_without_sides_of_one(tmp_path: Path, run) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, key, gain in (("encoders", "position", 180 / np.pi), ("torque", "torque", 1.0)):
            group = file.create_group(f"telemetry/{name}")
            data = np.zeros((len(run["time"]), 1, 4))
            data[:, 0, 2] = gain * run[key]
            group["data"] = data
            group["timestamps"] = 1.6e9 + run["time"][:, None]
            group["name"] = np.frombuffer(name.encode(), np.uint8).astype(np.uint16)[:, None]
            group["dimensions"] = np.array([[4.0], [1.0], [len(run["time"])]])
            for item in group.values():
                item.attrs["MATLAB_class"] = np.bytes_("double" if item.dtype.kind == "f" else "char")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    columns = {"position": "telemetry.encoders.data[2]:deg", "torque": "telemetry.torque.data[2]"}
    check(read_recording(path, columns=columns))


def test_a_stamp_beyond_the_samples_is_told(tmp_path: Path, run) -> None:
    later = np.append(run["time"], run["time"][-1] + run["time"][1])
    np.savez(tmp_path / "run.npz", t=later, q=run["position"], u=run["torque"])
    recording = read_recording(tmp_path / "run.npz")
    assert len(recording) == len(run["time"]) and any("one stamp more" in note for note in recording.notes)
