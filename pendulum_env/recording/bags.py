"""Read bags of ROS 1 and 2 and MCAP; each number in a message is a column named by its path, `/robot/effort[0]`.

Joint states are named by joint, `/joint_states/elbow/position`, because their order may change. Time is that of the
message's header, or else of its reception. Quantities of other topics than position are converted to the times of
position: torque is held, other quantities are interpolated.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.recording.columns import FileColumn
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.table import WIDEST, ColumnFinder, RawTable, require_module

TIME = "time"  # name of the time column of all messages
JOINT = ("position", "velocity", "effort")  # fields of a joint state, with one element per joint


def read_bag(path: Path, find: ColumnFinder) -> RawTable:
    """Read the needed columns of a bag, as a file or a folder, or of MCAP."""
    require_module("rosbags")
    with closing(_open_reader(path)) as reader:
        samples: dict[str, dict[str, float]] = {}
        for connection in reader.connections:
            message = next(iter(reader.messages([connection])), None)
            if message is not None:
                samples.setdefault(
                    connection.topic, dict(_list_numbers(reader.deserialize(message[2], connection.msgtype)))
                )
        owners = [(topic, field) for topic, fields in samples.items() for field in fields]
        headers = [TIME, *(f"{topic}/{field}" for topic, field in owners)]
        columns = find(headers)
        fields_by_topic: dict[str, list[str]] = {}
        for column in columns.values():
            if column.index:
                topic, field = owners[column.index - 1]
                fields_by_topic.setdefault(topic, []).append(field)
        series = {topic: _read_series(reader, topic, fields) for topic, fields in fields_by_topic.items()}
    values, notes = _merge_topics(columns, owners, series)
    message = series[owners[columns["position"].index - 1][0]][0][0]
    return RawTable(columns, values, notes, datetime.fromtimestamp(float(message) / 1e9, UTC))


def _open_reader(path: Path) -> Any:
    """Open a reader of a bag; without message definitions, load those of ROS, which is slow."""
    from rosbags.highlevel import AnyReader, AnyReaderError

    reader = AnyReader([path])
    try:
        reader.open()
    except AnyReaderError:
        from rosbags.typesys import Stores, get_typestore

        reader.default_typestore = get_typestore(Stores.LATEST)
        reader.open()
    return reader


def _read_series(reader: Any, topic: str, fields: Sequence[str]) -> tuple[NDArray[np.int64], dict[str, Array]]:
    """Read time since 1970 [ns] and fields of the messages of a topic, ordered by time, (N,) each."""
    times, rows = [], []
    for connection, reception, raw in reader.messages([c for c in reader.connections if c.topic == topic]):
        message = reader.deserialize(raw, connection.msgtype)
        numbers = dict(_list_numbers(message))
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        nanoseconds = 0 if stamp is None else stamp.sec * 1_000_000_000 + stamp.nanosec
        times.append(nanoseconds or reception)
        rows.append([numbers.get(field, np.nan) for field in fields])
    order = np.argsort(times, kind="stable")
    time = np.array(times, dtype=np.int64)[order]
    values = np.array(rows, dtype=np.float64)[order]
    return time, {field: values[:, k] for k, field in enumerate(fields)}


def _merge_topics(
    columns: dict[str, FileColumn], owners: Sequence[tuple[str, str]], series: Any
) -> tuple[dict[str, Array], tuple[Note, ...]]:
    topic, _ = owners[columns["position"].index - 1]
    base = series[topic][0]
    values: dict[str, Array] = {}
    notes = []
    for quantity, column in columns.items():
        if column.index == 0:
            values[quantity] = 1e-9 * (base - base[0])
            continue
        column_topic, field = owners[column.index - 1]
        stamps, fields = series[column_topic]
        if column_topic == topic:
            values[quantity] = fields[field]
        elif quantity == "torque":
            last = np.searchsorted(stamps, base, side="right") - 1
            values[quantity] = np.where(last >= 0, fields[field][last], np.nan)
        else:
            values[quantity] = np.interp(1e-9 * (base - base[0]), 1e-9 * (stamps - base[0]), fields[field])
        if column_topic != topic:
            notes.append(Note(NoteKind.OTHER_TOPIC, (quantity,), headers=(column_topic, topic)))
    return values, tuple(notes)


def _list_numbers(message: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield path and value of each number in a message."""
    if {"name", *JOINT} <= set(getattr(message, "__dataclass_fields__", ())):
        for field in JOINT:
            for joint, value in zip(message.name, getattr(message, field), strict=False):
                yield f"{path}{joint}/{field}", float(value)
        return
    for name in getattr(message, "__dataclass_fields__", ()):
        value = getattr(message, name)
        if name == "__msgtype__":
            continue
        if isinstance(value, bool | int | float | np.number):
            yield f"{path}{name}", float(value)
        elif isinstance(value, np.ndarray | list | tuple):
            for k, item in enumerate(value[:WIDEST]):
                if isinstance(item, int | float | np.number):
                    yield f"{path}{name}[{k}]", float(item)
                else:
                    yield from _list_numbers(item, f"{path}{name}[{k}]/")
        else:
            yield from _list_numbers(value, f"{path}{name}/")


def is_bag(path: Path) -> bool:
    """Return whether a folder is a bag of ROS 2."""
    return os.path.isfile(path / "metadata.yaml")  # False for a too long name
