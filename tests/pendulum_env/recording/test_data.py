"""Tables in memory come in by the door of files: the same names, units, checks and mending."""

import ast
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from estimators import compare, identify
from pendulum_env.errors import ColumnError
from pendulum_env.physics import BASE, Model
from pendulum_env.recording import Recording, RecordingError, read_recording, write_recording
from pendulum_env.settings import format_argument, use_writer
from tests.notes import list_notes

MODEL = Model.build(BASE, [0.09, 2.0, 0.35, 0.9])
START = 1_700_000_000.25  # [s] since 1970


class Stream:
    """Only what the Arrow PyCapsule interface asks for."""

    def __init__(self, table: pa.Table) -> None:
        self.table = table

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        return self.table.__arrow_c_stream__(requested_schema)


def pandas_frame(columns: dict[str, np.ndarray]) -> Any:
    return pytest.importorskip("pandas").DataFrame(columns)


def polars_frame(columns: dict[str, np.ndarray]) -> Any:
    return pytest.importorskip("polars").DataFrame(columns)


KINDS: dict[str, Callable[[dict[str, np.ndarray]], Any]] = {
    "mapping": dict,
    "lists": lambda columns: {name: values.tolist() for name, values in columns.items()},
    "nested": lambda columns: {"log": columns, "rate": 500.0},
    "structured": lambda columns: np.rec.fromarrays(list(columns.values()), names=list(columns)),
    "pyarrow": pa.table,
    "stream": lambda columns: Stream(pa.table(columns)),
    "pandas": pandas_frame,
    "polars": polars_frame,
}


def columns_of(run: Recording, **changes: np.ndarray) -> dict[str, np.ndarray]:
    return {"t": run.time, "angle_deg": np.degrees(run.position), "tau": run.torque} | changes


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_table_is_read_as_its_file(tmp_path: Path, swing: Recording, kind: str) -> None:
    columns = columns_of(swing, t=START + swing.time)
    np.savez(tmp_path / "run.npz", **columns)
    file, data = read_recording(tmp_path / "run.npz"), read_recording(KINDS[kind](columns), name="mine")
    np.testing.assert_allclose(data.time, swing.time, rtol=0, atol=1e-6)
    for quantity in ("time", "position", "torque"):
        np.testing.assert_array_equal(getattr(data, quantity), getattr(file, quantity))
    assert (data.name, data.start_date) == ("mine", file.start_date)
    assert len(data.notes) == len(file.notes)


@pytest.mark.parametrize("kind", ["mapping", "pyarrow"])
def test_tables_are_mended_and_refused_as_files_are(swing: Recording, kind: str) -> None:
    gap = np.r_[0:1000, 1100 : len(swing)]
    columns = {name: values[gap].copy() for name, values in columns_of(swing).items()}
    columns["angle_deg"][500] = 4e3
    recording = read_recording(KINDS[kind](columns))
    assert columns["angle_deg"][500] == 4e3  # what the caller has stays as it is
    assert len(recording.starts) == 2 and any("jumps for one sample" in note for note in list_notes(recording))
    columns["q"] = columns.pop("angle_deg")
    with pytest.raises(ColumnError, match=r"position.*q:deg"):
        read_recording(KINDS[kind](columns))
    data = KINDS[kind](columns_of(swing))
    assert read_recording(data, columns={"torque": "-tau*2"}).torque[5] == -2 * swing.torque[5]
    with pytest.raises(RecordingError, match="mine: no column for torque"):
        read_recording(KINDS[kind]({"time": swing.time, "q": swing.position, "m1": swing.torque}), name="mine")


def test_a_table_without_known_names_is_refused_with_the_call_that_reads_it(swing: Recording) -> None:
    columns = {"a": 1e3 * swing.time, "b": swing.position, "c": swing.torque}
    use_writer(format_argument)
    with pytest.raises(ColumnError) as refusal:
        identify(columns)
    (call,) = re.findall(r"columns=(\{.*?\})", str(refusal.value))
    given = ast.literal_eval(call)
    assert "--columns" not in str(refusal.value) and set(given) == {"time", "position", "torque"}
    recording = read_recording(columns, columns=given | {"time": "a:ms", "position": "b", "torque": "c"})
    np.testing.assert_array_equal(recording.torque, swing.torque)


def texts_of(columns: dict[str, np.ndarray], decimal: str = ".") -> dict[str, np.ndarray]:
    return {name: np.array([str(v).replace(".", decimal) for v in values]) for name, values in columns.items()}


def mixed(columns: dict[str, np.ndarray]) -> Any:
    frame = pandas_frame(columns).astype(object)
    frame.loc[3, "tau"] = str(frame.loc[3, "tau"])
    return frame


@pytest.mark.parametrize("kind", [*KINDS, "comma", "mixed"])
def test_text_cells_of_tables_are_read_as_those_of_a_file(tmp_path: Path, swing: Recording, kind: str) -> None:
    stamps = np.datetime_as_string(np.datetime64("2026-03-01T12:00", "us") + np.round(1e6 * swing.time).astype(int))
    columns = columns_of(swing, t=stamps)
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    text = "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)])
    (tmp_path / "run.csv").write_text(text + "\n")
    make = {**KINDS, "comma": pa.table, "mixed": mixed}[kind]
    words = columns if kind == "mixed" else texts_of(columns, "," if kind == "comma" else ".")
    file, data = read_recording(tmp_path / "run.csv"), read_recording(make(words))
    for quantity in ("time", "position", "torque"):
        np.testing.assert_array_equal(getattr(data, quantity), getattr(file, quantity))
    assert (data.start_date, len(data.notes)) == (file.start_date, len(file.notes))
    if kind != "mixed":
        words["tau"] = np.where(np.arange(len(swing)) == 7, "spoilt", words["tau"])
        with pytest.raises(RecordingError, match=r"data row 8 .*'spoilt' as torque"):
            read_recording(make(words))


@pytest.mark.parametrize("kind", [float, np.datetime64])
def test_an_index_of_time_is_the_time(swing: Recording, kind: type) -> None:
    time = swing.time if kind is float else np.datetime64("2026-01-01", "us") + np.round(1e6 * swing.time).astype(int)
    table = pa.table({"q": swing.position, "tau": swing.torque, "__index_level_0__": pa.array(time)})
    np.testing.assert_allclose(read_recording(table).time, swing.time, rtol=0, atol=1e-6)


@pytest.mark.parametrize("source", [3, None, np.zeros((10, 3)), [1.0, 2.0]])
def test_what_is_no_table(source: Any) -> None:
    with pytest.raises(TypeError, match="is no table: give a path, a mapping of arrays or a data frame"):
        read_recording(source)


def test_functions_take_what_the_door_takes(tmp_path: Path, swing: Recording) -> None:
    write_recording(swing, tmp_path / "swing.csv")
    columns = {"time": swing.time, "position": swing.position, "torque": swing.torque, "velocity": swing.velocity}
    expected = identify(swing, schemes="filtered_dynamic").least_squares.theta
    for source in (tmp_path / "swing.csv", str(tmp_path / "swing.csv"), columns, [columns, tmp_path / "swing.csv"]):
        theta = identify(source, schemes="filtered_dynamic").least_squares.theta
        np.testing.assert_allclose(theta, expected, rtol=1e-6)
    errors = [compare(MODEL, source).errors.torque_rms for source in (swing, columns)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-9)


@pytest.mark.parametrize(("unit", "factor"), [("deg", 180 / np.pi), ("rev", 1 / (2 * np.pi))])
def test_arrays_in_another_unit_are_refused_with_the_line_that_reads_them(swing: Recording, unit, factor) -> None:
    time, position, torque = swing.time, factor * swing.position, swing.torque
    with pytest.raises(ColumnError, match=f"position:{unit}") as refusal:
        Recording(time, position, torque)
    line = str(refusal.value).split("read it with ")[1].split(" if it is")[0]
    recording = eval(line, {"read_recording": read_recording, "time": time, "position": position, "torque": torque})
    np.testing.assert_allclose(recording.position, swing.position, atol=1e-9)
    forced = read_recording({"t": time, "q": position, "tau": torque}, columns={"position": "q:rad"})
    np.testing.assert_array_equal(forced.position, position)


def test_an_uneven_clock_of_arrays_is_refused_with_the_call_that_mends_it(swing: Recording) -> None:
    time = swing.time + 0.1 / swing.rate * np.random.default_rng(0).standard_normal(len(swing))
    with pytest.raises(
        RecordingError, match=r"not uniform and increasing: read it with read_recording\(\{'time': time"
    ):
        Recording(time, swing.position, swing.torque)
    mended = read_recording({"time": time, "position": swing.position, "torque": swing.torque})
    np.testing.assert_allclose(mended.time, np.arange(len(mended)) / mended.rate, atol=1e-9)
