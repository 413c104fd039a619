"""Layouts that programs write: cells that are words or empty, turns, labels of segments."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from pendulum_env.recording import Recording, RecordingError, read_recording
from tests.notes import list_notes

TURN = 2 * np.pi


def cells(values: np.ndarray, digits: int = 9, *, only_changes: bool = False, lost: np.ndarray | None = None) -> list:
    """Numbers as text; empty where they are lost or, if only changes are logged, as before."""
    texts = [f"{value:.{digits}f}" for value in values]
    if only_changes:
        return [text if k == 0 or text != texts[k - 1] else "" for k, text in enumerate(texts)]
    return texts if lost is None else ["" if gone else text for text, gone in zip(texts, lost, strict=True)]


def read(folder: Path, header: str, *columns: list, **options: object) -> Recording:
    """A CSV file of these columns, read."""
    rows = map(",".join, zip(*columns, strict=True))
    (folder / "run.csv").write_text("\n".join([header, *rows]) + "\n")
    return read_recording(folder / "run.csv", **options)


@pytest.fixture
def lost(swing: Recording) -> np.ndarray:
    """30 samples amid the others."""
    gone = np.random.default_rng(0).choice(np.arange(50, len(swing) - 50), 30, replace=False)
    return np.isin(np.arange(len(swing)), gone)


def test_cells_that_are_empty_unless_changed_hold_the_last_value(tmp_path: Path, swing: Recording) -> None:
    slower = slice(None, None, 4)
    turns, torque = np.round(swing.position[slower] / TURN * 4096) / 4096, np.round(swing.torque[slower], 2)
    columns = cells(swing.time[slower], 6), cells(turns, 6, only_changes=True), cells(torque, 2, only_changes=True)
    header = "Timestamp,/Arm/PositionRotations,/Arm/Torque,/DS/Enabled"
    recording = read(tmp_path, header, *columns, ["true", *[""] * (len(turns) - 1)])
    np.testing.assert_allclose(recording.torque, torque, atol=1e-9)
    np.testing.assert_allclose(recording.position, TURN * turns, atol=1e-5)
    assert recording.enabled is not None and recording.enabled.all()
    switch, half = [""] * len(swing), len(swing) // 2
    switch[0], switch[half] = "true", "false"  # alone in a file whose other cells are written
    whole = cells(swing.time), cells(swing.position), cells(swing.torque)
    enabled = read(tmp_path, "time,position,torque,enabled", *whole, switch).enabled
    np.testing.assert_array_equal(enabled, np.arange(len(swing)) < half)


def test_lost_cells_are_no_values_that_are_held(tmp_path: Path, swing: Recording, lost: np.ndarray) -> None:
    """Whether the column repeats its values, never does, or turns on and on."""
    ramp = np.cumsum(np.where(np.arange(len(lost)) % 100 < 50, 0.01, -0.01))
    held, time, q = np.repeat(swing.torque[::4], 4), cells(swing.time), cells(swing.position)
    turning = cells(10 * swing.time, 3, lost=lost), cells(swing.torque)
    logs = (q, cells(held, lost=lost)), turning, (q, cells(ramp, lost=lost))
    for columns, quantity in zip(logs, ("torque", "position", "torque"), strict=True):
        recording = read(tmp_path, "time,position,torque", time, *columns)
        assert any(note.startswith(f"{quantity} is empty") and "left out" in note for note in list_notes(recording))


def test_truth_values_are_no_torque(tmp_path: Path, swing: Recording) -> None:
    with pytest.raises(RecordingError, match=r"data row 1 .* has 'true' as torque, not a number"):
        read(tmp_path, "time,position,torque", cells(swing.time), cells(swing.position), ["true"] * len(swing))


@pytest.mark.parametrize(
    ("yes", "no"), [("true", "false"), ("True", "False"), ("TRUE", "FALSE"), ("1", "0"), ("ON", "OFF"), ("Yes", "no")]
)
def test_words_of_a_switch_are_1_and_0(tmp_path: Path, swing: Recording, yes: str, no: str) -> None:
    on = np.sin(3 * swing.time) > -0.8
    numbers = cells(swing.time), cells(swing.position), cells(swing.torque)
    recording = read(tmp_path, "time,position,torque,enabled", *numbers, np.where(on, yes, no).tolist())
    np.testing.assert_array_equal(recording.enabled, on.astype(float))
    np.testing.assert_allclose(recording.torque, np.where(on, swing.torque, 0.0), atol=1e-8)


@pytest.mark.parametrize("name", ["segment", "state", "phase", "test"])
def test_labels_in_words_begin_a_segment_where_they_change(tmp_path: Path, swing: Recording, name: str) -> None:
    third, header = len(swing) // 3, f"time,position,torque,{name}"
    labels = np.repeat(["homing", "sweep up", "homing"], [third, third, len(swing) - 2 * third])
    log = {"time": swing.time, "position": swing.position, "torque": swing.torque}
    assert read(tmp_path, header, *map(cells, log.values()), labels.tolist()).starts == (0, third, 2 * third)
    assert read_recording(log | {name: labels}).starts == (0, third, 2 * third)
    for kind in (pa.string(), pa.large_string(), pa.dictionary(pa.int32(), pa.string())):
        table = pa.table(log | {name: pa.array(labels).cast(kind)})
        assert read_recording(table).starts == (0, third, 2 * third)
    if name != "segment":  # numbers of these are other quantities, as the phase of a motor
        assert read_recording(log | {name: np.arange(len(swing)) % 7}).starts == (0,)


def test_an_optional_column_of_words_is_refused_with_the_line_that_leaves_it_out(tmp_path, swing: Recording) -> None:
    columns = cells(swing.time), cells(swing.position), cells(swing.torque), ["n/a"] * len(swing)
    with pytest.raises(RecordingError, match=r"'n/a' as temperature.*--columns temperature=none"):
        read(tmp_path, "time,position,torque,temperature", *columns)
    recording = read_recording(tmp_path / "run.csv", columns={"temperature": "none"})
    assert recording.temperature is None and len(recording) == len(swing)


@pytest.mark.parametrize(
    "header",
    [
        "time,MODE,POSITION,VELOCITY,TORQUE,FAULT",
        "t,Mode,Position,Velocity,Torque,Q_Current",
        "timestamp,d_current,position,velocity,torque,q_current",
    ],
)
def test_columns_of_moteus_are_turns(swing: Recording, header: str) -> None:
    zero = 0 * swing.time
    columns = swing.time, zero + 10, 0.2 * swing.position / TURN, 0.2 * swing.velocity / TURN, swing.torque, zero
    recording = read_recording(dict(zip(header.split(","), columns, strict=True)))
    assert recording.position == pytest.approx(0.2 * swing.position)
    assert recording.velocity == pytest.approx(0.2 * swing.velocity)
    assert any("position converted to rad" in note for note in list_notes(recording))


@pytest.mark.parametrize("name", ["tau_est", "tauEst", "estimated_torque", "torque_est"])
def test_an_estimated_torque_is_known_by_name_and_gives_way_to_a_measured_one(swing: Recording, name: str) -> None:
    log = {"t": swing.time, "q": swing.position}
    for torques in ({name: swing.torque}, {"tau": swing.torque, name: 0 * swing.torque}):
        np.testing.assert_array_equal(read_recording(log | torques).torque, swing.torque)
