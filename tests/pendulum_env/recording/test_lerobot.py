"""Datasets of LeRobot, written as its versions 2.1 and 3.0 do, and other logs of arms of servos."""

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from estimators.arguments import select_recordings
from pendulum_env.errors import ColumnError
from pendulum_env.recording import Recording, RecordingError, read_recording
from pendulum_env.recording.lerobot import find_units, list_recordings
from pendulum_env.recording.preview import read_preview
from pendulum_env.recording.study import read_sources, read_study
from tests.notes import list_notes
from workbench.inputs import read_source_names
from workbench.survey.recordings import find_recordings

JOINTS = ("shoulder_pan", "elbow_flex", "gripper")
FPS, FRAMES = 30, 240
COUNT = 2 * np.pi / 4096  # [rad]
RANGES = {"shoulder_pan": (725, 3449), "elbow_flex": (842, 3047), "gripper": (2032, 3288)}  # [counts]
READ = {"position": "position_elbow_flex", "reference": "goal_elbow_flex", "torque": "none"}


def make_counts(episode: int) -> np.ndarray:
    """Encoder counts of each joint (FRAMES, 3), within their ranges, from the middle of the range."""
    t = np.arange(FRAMES) / FPS + episode
    middles = np.array([sum(ends) / 2 for ends in RANGES.values()])
    waves = np.stack([900 * np.sin(1.3 * t), 700 * np.sin(1.7 * t), 400 * np.sin(0.9 * t)], axis=1)
    return np.round(middles + waves)


def normalise(counts: np.ndarray, unit: str) -> np.ndarray:
    """Values that LeRobot writes: degrees from the middle, or -100 to 100, and 0 to 100 of a gripper."""
    low, high = (np.array(ends, dtype=float) for ends in zip(*RANGES.values(), strict=True))
    percent = 200 * (counts - low) / (high - low) - 100
    values = (counts - (low + high) / 2) * 360 / 4095 if unit == "degrees" else percent
    values[:, 2] = (percent[:, 2] + 100) / 2
    return values


def write_dataset(
    folder: Path,
    version: str = "v2.1",
    unit: str = "degrees",
    names: Any = None,
    calibration: Any = None,
    still: int | None = None,
) -> Path:
    """Write a dataset of three episodes, in one of which only the gripper may move; version 3.0 has two in a file."""
    names = [f"{joint}.pos" for joint in JOINTS] if names is None else names
    vector = {"dtype": "float32", "shape": [3], "names": names}
    scalar = {"dtype": "int64", "shape": [1], "names": None}
    video = {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"]}
    features = {"action": vector, "observation.state": vector, "observation.images.top": video}
    features |= {"timestamp": {**scalar, "dtype": "float32"}, "frame_index": scalar, "episode_index": scalar}
    episode_path = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    shared_path = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    info = {"codebase_version": version, "fps": FPS, "total_episodes": 3, "chunks_size": 1000, "features": features}
    info["data_path"] = episode_path if version == "v2.1" else shared_path
    tables = []
    for episode in range(3):
        counts = make_counts(episode)
        if episode == still:
            counts[:, :2] = counts[0, :2]
        state = normalise(counts, unit)
        frames = np.arange(FRAMES)
        columns = {
            name: pa.FixedSizeListArray.from_arrays(pa.array(x.ravel(), pa.float32()), 3)
            for name, x in {"action": state + 1.0, "observation.state": state}.items()
        }
        columns |= {"timestamp": pa.array(frames / FPS, pa.float32()), "frame_index": pa.array(frames)}
        tables.append(pa.table({**columns, "episode_index": pa.array(np.full(FRAMES, episode))}))
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    (folder / "data" / "chunk-000").mkdir(parents=True)
    if version == "v2.1":
        for episode, table in enumerate(tables):
            pq.write_table(table, folder / episode_path.format(episode_chunk=0, episode_index=episode))
    else:
        files = [0, 0, 1]
        pq.write_table(pa.concat_tables(tables[:2]), folder / shared_path.format(chunk_index=0, file_index=0))
        pq.write_table(tables[2], folder / shared_path.format(chunk_index=0, file_index=1))
        episodes = {"episode_index": [0, 1, 2], "data/chunk_index": [0, 0, 0], "data/file_index": files}
        (folder / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
        pq.write_table(pa.table(episodes), folder / "meta/episodes/chunk-000/file-000.parquet")
    if calibration is not None:
        (folder / "calibration.json").write_text(json.dumps(calibration))
    return folder


def calibrate(**changed: Any) -> dict[str, Any]:
    """Calibration as LeRobot saves it."""
    common = {"drive_mode": 0, "homing_offset": -1196, **changed}
    return {j: {"id": k, **common, "range_min": a, "range_max": b} for k, (j, (a, b)) in enumerate(RANGES.items(), 1)}


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
@pytest.mark.parametrize(
    "names", [None, {"motors": list(JOINTS)}, list(JOINTS), {joint: k for k, joint in enumerate(JOINTS)}]
)
def test_an_episode_has_positions_and_goals_in_radians_by_joint(tmp_path: Path, version: str, names: Any) -> None:
    folder = write_dataset(tmp_path / "pick", version, names=names)
    for episode in range(3):
        preview = read_preview(f"{folder}#{episode}")
        columns = dict(zip(preview.headers, preview.values, strict=True))
        expected = (make_counts(episode)[:, 1] - sum(RANGES["elbow_flex"]) / 2) * COUNT
        np.testing.assert_allclose(columns["position_elbow_flex"], expected, rtol=3e-4, atol=1e-6)
        np.testing.assert_allclose(
            columns["goal_elbow_flex"], columns["position_elbow_flex"] + np.radians(1.0), atol=1e-6
        )
        np.testing.assert_allclose(columns["time"], np.arange(FRAMES) / FPS, atol=1e-12)
    recording = read_recording(f"{folder}#2", columns=READ)
    assert recording.reference is not None and (recording.rate, len(recording)) == (FPS, FRAMES)
    assert any("'gripper' is in percent" in note for note in list_notes(recording))  # no radians without its range


def test_all_episodes_have_the_unit_of_the_dataset(tmp_path: Path) -> None:
    headers = [read_preview(f"{write_dataset(tmp_path / 'pick', still=1)}#1").headers]
    headers += [read_preview(f"{tmp_path / 'pick'}#{k}").headers for k in (0, 2)]
    assert headers[0] == headers[1] == headers[2] and "position_elbow_flex" in headers[0]


@pytest.mark.parametrize("inverted", [0, 1])
def test_percent_of_the_range_becomes_radians_by_the_calibration(tmp_path: Path, inverted: int) -> None:
    folder = write_dataset(tmp_path / "pick", unit="percent", calibration=calibrate(drive_mode=inverted))
    preview = read_preview(f"{folder}#0")
    columns = dict(zip(preview.headers, preview.values, strict=True))
    for joint, counts in zip(JOINTS, make_counts(0).T, strict=True):
        low, high = RANGES[joint]
        zero = low if joint == "gripper" else (low + high) / 2
        seen = low + high - counts if inverted else counts  # LeRobot mirrors an inverted joint within its range
        np.testing.assert_allclose(columns[f"position_{joint}"], (seen - zero) * COUNT, atol=1e-5)


def test_percent_without_a_calibration_needs_the_ranges(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "pick", unit="percent")
    with pytest.raises(ColumnError, match=r"percent of the range .*calibration.json"):
        read_recording(f"{folder}#0", columns={"torque": None})
    with pytest.raises(ColumnError, match=r"calibration\.json"):  # also of columns that are named
        read_recording(f"{folder}#0", columns={**READ, "torque": None})
    half = 0.5 * (RANGES["elbow_flex"][1] - RANGES["elbow_flex"][0]) * 360 / 4096 / 100
    columns = {name: f"{column}:deg*{half!r}" for name, column in READ.items() if column != "none"}
    recording = read_recording(f"{folder}#0", columns={**columns, "torque": None})
    np.testing.assert_allclose(recording.position, (make_counts(0)[:, 1] - 1944.5) * COUNT, atol=1e-5)


@pytest.mark.parametrize(("top", "unit"), [(255.0, "unknown"), (100.0, "percent without range"), (1.5, "radians")])
def test_a_gripper_does_not_change_the_unit_of_an_arm(top: float, unit: str) -> None:
    t = np.arange(FRAMES) / FPS
    arm = {f"joint_{k}": 1.5 * np.sin((1.0 + 0.3 * k) * t) for k in range(3)}
    lost = {"lost": np.full(FRAMES, np.nan)}
    units = find_units({**arm, **lost, "gripper": top * np.sin(t) ** 2}, {})
    assert [units[joint].unit for joint in arm] == 3 * ["radians"] and units["gripper"].unit == unit
    with pytest.raises(RecordingError, match="no positions"):
        find_units({}, {})


def test_a_channel_in_another_unit_than_most_needs_units_by_name(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "pick", names=["lift", "elbow_flex", "wrist"])
    angle = np.sin(np.arange(FRAMES) / FPS * 3.0)
    for file in folder.rglob("*.parquet"):
        state = pa.FixedSizeListArray.from_arrays(pa.array(np.outer(angle, [300.0, 1.2, 0.7]).ravel()), 3)
        table = pq.read_table(file)
        pq.write_table(
            table.set_column(table.schema.get_field_index("observation.state"), "observation.state", state), file
        )
    for columns in ({"torque": None}, {"position": "position_elbow_flex", "torque": None}):
        with pytest.raises(ColumnError, match=r":rad.* or .*:deg"):
            read_recording(f"{folder}#0", columns=columns)
    recording = read_recording(f"{folder}#0", columns={"position": "position_elbow_flex:rad", "torque": None})
    np.testing.assert_allclose(recording.position, 1.2 * angle, atol=1e-6)


def test_a_dataset_without_rows_is_refused(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "pick")
    for file in folder.rglob("*.parquet"):
        pq.write_table(pq.read_table(file).slice(0, 0), file)
    with pytest.raises(RecordingError, match="no rows"):
        read_recording(f"{folder}#0", columns=READ)


def test_a_dataset_is_scanned_once_until_it_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, opened, parquet_file = write_dataset(tmp_path / "pick"), list[str](), pq.ParquetFile
    position = read_recording(f"{folder}#0", columns=READ).position
    monkeypatch.setattr(pq, "ParquetFile", lambda file, **k: opened.append(Path(file).name) or parquet_file(file, **k))
    read_recording(f"{folder}#1", columns=READ)
    assert opened == ["episode_000001.parquet"]
    for file in folder.rglob("*.parquet"):  # in radians now
        table = pq.read_table(file)
        state = pa.array([np.radians(row).tolist() for row in table["observation.state"].to_pylist()])
        pq.write_table(table.set_column(1, "observation.state", state), file)
    np.testing.assert_allclose(read_recording(f"{folder}#0", columns=READ).position, position, rtol=1e-5, atol=1e-6)
    (folder / "data/chunk-000/episode_000002.parquet").unlink()
    assert len(list_recordings(folder)) == 2


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_each_episode_is_a_recording(tmp_path: Path, version: str) -> None:
    folder = write_dataset(tmp_path / "pick", version)
    assert [Path(path).name for path in list_recordings(folder)] == ["pick#0", "pick#1", "pick#2"]
    study = tmp_path / "study.toml"
    columns = "\n".join(f'{name} = "{column}"' for name, column in READ.items())
    study.write_text(
        f'[columns]\n{columns}\n[[recording]]\nfile = "pick#0-1"\n[[recording]]\nfile = "pick#2"\nrole = "holdout"\n'
    )
    assert [len(part) for part in (read_study(study).fitted, read_study(study).held_out)] == [2, 1]
    reading = Namespace(columns=READ, unwrap=False)
    assert [source.read().name for source in read_source_names(str(folder), reading)] == ["pick#0", "pick#1", "pick#2"]
    surveyed = find_recordings(folder, reading)
    assert [(one.name, one.machine) for one in surveyed][2:] == [("../pick#2", "pick")] and surveyed[0].date.year > 2000
    recordings = select_recordings(folder, log_format={"columns": READ})
    assert [recording.name for recording in recordings] == ["pick#0", "pick#1", "pick#2"]


def test_an_unusable_dataset_is_refused_in_a_sentence(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "pick")
    for path, text in ((folder, "3 episodes"), (f"{folder}#7", "no such episode"), (f"{folder}#x", "no such episode")):
        with pytest.raises(RecordingError, match=text):
            read_recording(path, columns=READ)
    (tmp_path / "study.toml").write_text('[[recording]]\nfile = "pick#5"\n')
    with pytest.raises(RecordingError, match=r"recording\[0\].*no such episode"):
        read_sources(tmp_path / "study.toml")
    for file, content in (("calibration.json", "[1]"), ("meta/info.json", "{}"), ("meta/info.json", "{")):
        (folder / file).write_text(content)
        with pytest.raises(RecordingError, match=Path(file).name.split(".")[0] + "|fps|JSON"):
            read_recording(f"{folder}#0", columns=READ)


def test_lists_in_cells_are_columns(tmp_path: Path, swing: Recording) -> None:
    """As pandas writes lists, and as NumPy prints arrays."""
    for separator in (", ", " "):
        rows = [
            f'{t},"[{separator.join([str(q), str(tau)])}]",{k}'
            for k, (t, q, tau) in enumerate(zip(swing.time, swing.position, swing.torque, strict=True))
        ]
        (tmp_path / "run.csv").write_text("\n".join(["timestamp,states,row", *rows]) + "\n")
        recording = read_recording(tmp_path / "run.csv", columns={"position": "states[0]", "torque": "states[1]"})
        np.testing.assert_allclose(recording.position, swing.position, atol=1e-12)
        np.testing.assert_allclose(recording.torque, swing.torque, atol=1e-12)


@pytest.mark.parametrize(("first", "last"), [("[nan, 0.1]", "[null 0.2]"), ("", "[]"), ("[-inf, nan]", "NaN")])
def test_lists_may_lack_elements_and_cells_their_lists(tmp_path: Path, swing: Recording, first: str, last: str) -> None:
    lists = [f"[{q}, {tau}]" for q, tau in zip(swing.position, swing.torque, strict=True)]
    lists[0], lists[-1] = first, last
    rows = [f'{t},"{cell}",{k}' for k, (t, cell) in enumerate(zip(swing.time, lists, strict=True))]
    (tmp_path / "run.csv").write_text("\n".join(["timestamp,states,row", *rows]) + "\n")
    recording = read_recording(tmp_path / "run.csv", columns={"position": "states[0]", "torque": "states[1]"})
    np.testing.assert_allclose(recording.position, swing.position[1:-1], atol=1e-12)
    np.testing.assert_allclose(recording.torque, swing.torque[1:-1], atol=1e-12)


def test_goals_of_a_second_file_are_joined_by_their_stamps(tmp_path: Path, swing: Recording) -> None:
    goals, start = np.round(swing.position, 1), 1.7e9
    states = np.column_stack([start + swing.time, swing.position])
    controls = np.column_stack([start + swing.time, goals])[3:]  # the log of the goals begins later
    for name, table in (("states.csv", states), ("goals.csv", controls)):
        np.savetxt(tmp_path / name, table, delimiter=",", header="timestamp,elbow", comments="", fmt="%.6f")
    columns = {"position": "elbow", "reference": "goal_elbow", "torque": None}
    recording = read_recording(tmp_path / "states.csv+goals.csv", columns=columns)
    np.testing.assert_allclose(recording.position, swing.position[3:], atol=1e-6)
    np.testing.assert_allclose(recording.reference, goals[3:], atol=1e-6)
    np.savetxt(tmp_path / "goals.csv", controls + 0.005, delimiter=",", header="timestamp,elbow", comments="")
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(tmp_path / "my+run.csv", columns=columns)
    with pytest.raises(RecordingError, match=r"only 0 of \d+ times"):
        read_recording(tmp_path / "states.csv+goals.csv", columns=columns)


def test_a_current_without_sign_is_no_torque(tmp_path: Path, swing: Recording) -> None:
    current = np.round(1000 * np.abs(swing.torque))
    table = {"time": swing.time, "position": swing.position, "current": current, "goal": np.round(swing.position, 1)}
    with pytest.raises(ColumnError, match="never negative while the motion reverses"):
        read_recording(table, columns={"torque": "current:mA*0.1"})
    drive = {"output": "current", "kp": 5.0, "gain": 0.1}
    left_out = read_recording(table, drive=drive)
    assert any("'current' is left out" in note for note in list_notes(left_out))
    assert left_out.torque.min() < 0  # computed from the goals
    signed = read_recording({**table, "current": 1000 * swing.torque}, columns={"torque": "current:mA*0.1"})
    np.testing.assert_allclose(signed.torque, 0.1 * swing.torque)


@pytest.mark.parametrize("driven", ["never", "first push", "upward"])
def test_a_current_that_drives_one_way_or_never_has_its_sign(swing: Recording, driven: str) -> None:
    rising = np.gradient(swing.position) > 0
    is_on = {"never": 0 * swing.time, "first push": swing.time < 0.1 * swing.duration, "upward": rising}[driven]
    table = {"time": swing.time, "position": swing.position, "current": is_on * (1.0 + np.abs(swing.torque))}
    recording = read_recording(table, columns={"torque": "current:A*0.1"})
    np.testing.assert_allclose(recording.torque, 0.1 * table["current"], atol=1e-12)
