"""Rows of metadata between names and data, names behind a percent sign, nested rows, and counters that start again."""

import json

import numpy as np
import pytest

from pendulum_env.errors import ColumnError
from pendulum_env.recording import read_recording

TIME = np.arange(300) / 100
ROWS = [f"{10 * k}\t{np.sin(t):.6f}\t{np.cos(t):.6f}" for k, t in enumerate(TIME)]


def test_rows_that_describe_the_columns_are_no_data(tmp_path):
    path = tmp_path / "scope.csv"
    metadata = ["Comment\t\t", "SampleTime\t10\t10", "Device\t5.44.12.1\t", "Unit\trad\t"]
    path.write_text("\n".join(["Clock\tActual Position\tActual Torque", *metadata, "", *ROWS]) + "\n")
    read = read_recording(path, columns={"time": "Clock:ms"})
    np.testing.assert_allclose(read.time, TIME, atol=1e-9)
    np.testing.assert_allclose(read.position, np.sin(TIME), atol=1e-6)


def test_rows_whose_first_cell_is_empty_are_data(tmp_path):
    path = tmp_path / "sparse.csv"
    supply = ["", "NA", *["12.1"] * (len(TIME) - 2)]
    rows = [f"{u},{t:.2f},{np.sin(t):.6f},{np.cos(t):.6f}" for u, t in zip(supply, TIME, strict=True)]
    path.write_text("\n".join(["remark,time,position,torque", *rows]) + "\n")
    assert len(read_recording(path)) == len(TIME)


def test_names_behind_a_percent_sign_have_seconds_and_nanoseconds(tmp_path):
    path = tmp_path / "DataRecorder.log"
    seconds = [f"{1000 + int(t)} {round(t % 1 * 1e9)} {np.sin(t):.6f} {np.cos(t):.6f}" for t in TIME]
    path.write_text("\n".join(["%TimeInSec TimeInNanoSec position torque", *seconds]) + "\n")
    read = read_recording(path)
    np.testing.assert_allclose(read.time - read.time[0], TIME, atol=1e-6)


def test_rows_of_json_may_be_nested(tmp_path):
    path = tmp_path / "status.jsonl"
    rows = [{"time": t, "lift": {"pos": np.sin(t), "motor": {"effort": np.cos(t)}}, "arm": {"pos": 0.1}} for t in TIME]
    path.write_text("\n".join(map(json.dumps, rows)))
    read = read_recording(path, columns={"position": "lift.pos:rad", "torque": "lift.motor.effort:Nm"})
    np.testing.assert_allclose(read.position, np.sin(TIME), atol=1e-9)


def test_a_counter_of_many_turns_that_starts_again_is_unwrapped_as_printed(tmp_path):
    path, angle = tmp_path / "wheel.csv", 300 * TIME + 5 * np.sin(TIME)
    counts = np.rint(angle / (2 * np.pi) * 90).astype(int) % 9000
    np.savetxt(
        path, np.column_stack([TIME, counts, np.cos(TIME)]), delimiter=",", header="time,ticks,torque", comments=""
    )
    with pytest.raises(ColumnError) as refusal:
        read_recording(path, columns={"position": "ticks:counts/90"})
    assert "counts/9000*100" in str(refusal.value) and "unwrap" in str(refusal.value)
    read = read_recording(path, columns={"position": "ticks:counts/9000*100"}, unwrap=True)
    np.testing.assert_allclose(read.position - read.position[0], angle - angle[0], atol=0.08)
