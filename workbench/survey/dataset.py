"""The Parquet dataset of a survey: a row for each case, in files that are whole or not there."""

from __future__ import annotations

import uuid
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pendulum_env.files import replacing, write_whole
from pendulum_env.reading import regular_size
from workbench.mistakes import printable
from workbench.survey.cases import file_time

Row = Mapping[str, Any]

STATUSES = ("failed", "refused", "done")  # to be tried again; a file that cannot be used; diagnosed
VERDICTS = ("missing", "unexplained", "nothing")
TEXT = pa.string()
NUMBER = pa.float64()
SCHEMA = pa.schema(
    {
        "name": TEXT,  # of the case
        "robot": TEXT,
        "joint": TEXT,
        "kind": TEXT,
        "date": pa.timestamp("us", "UTC"),
        "dated_by": TEXT,
        "file": TEXT,
        "status": TEXT,  # one of `STATUSES`
        "reason": TEXT,  # why it was refused or failed
        "verdict": TEXT,  # one of `VERDICTS`
        "headline": TEXT,
        "score": NUMBER,  # probability of the surest effect that is missing
        "selected": pa.list_(TEXT),
        "ambiguous": pa.list_(pa.list_(TEXT)),
        "candidates": pa.list_(
            pa.struct(
                {
                    "effect": TEXT,
                    "verdict": TEXT,
                    "score": NUMBER,
                    "gain": NUMBER,  # [nat]
                    "gain_error": NUMBER,
                    "variants": pa.int64(),
                }
            )
        ),
        "parameters": pa.list_(pa.struct({"name": TEXT, "value": NUMBER, "std": NUMBER, "unit": TEXT})),
        "torque_unit": TEXT,
        "noise_floor": NUMBER,  # [N m], as all torque
        "torque_rms": NUMBER,  # held out, with the final model
        "position_rms": NUMBER,  # [rad]
        "samples": pa.int64(),
        "duration": NUMBER,  # of the recording [s]
        "seconds": NUMBER,  # that the diagnosis took
        "diagnosis": TEXT,  # JSON, as `diagnose --json` writes it
        "report": TEXT,  # file of the case's own page, below the survey's folder
        "hash": TEXT,  # of the file's content
        "size": pa.int64(),  # bytes
        "changed": pa.int64(),  # when the file was [ns since 1970]
        "version": TEXT,  # of this project
        "settings": TEXT,  # hash of all that was asked for
        "finished": pa.timestamp("us", "UTC"),
    }
)
OWN = ("name", "status", "verdict", "date", "finished")  # columns without which no row makes sense
FULL = {"selected": (), "candidates": ("effect", "verdict"), "parameters": ("name", "value", "unit")}  # lists, likewise
FILES = 16  # that a dataset is left with: each takes two milliseconds whenever it is read
GROUP = 500  # rows that are read at a time
MOST, LARGEST = 500_000, 2_000_000_000  # rows of a file, and bytes of them in memory: some 2 kB each


@dataclass(frozen=True)
class Dataset:
    """A folder of Parquet files, `cases/*.parquet`; any Parquet reader takes them as one table.

    Of several rows for a case the one that was finished last holds. One survey at a time may write there.
    """

    folder: Path

    @property
    def parts(self) -> list[Path]:
        """Its files."""
        return sorted((self.folder / "cases").glob("*.parquet"))

    def create(self) -> None:
        """Make the folder, if it is not there.

        Raises:
            OSError: if it cannot be made.
        """
        (self.folder / "cases").mkdir(parents=True, exist_ok=True)
        if not (self.folder / "SURVEY").exists():
            write_whole(self.folder / "SURVEY", "Written by pendulum-ident survey: cases/ is one Parquet dataset.\n")

    def append(self, rows: Sequence[Row]) -> None:
        """Add rows, if there are any, as one more file, whole or not at all.

        Raises:
            OSError: if it cannot be written, as on a full disk.
        """
        if rows:
            self._write([pa.Table.from_pylist([dict(row) for row in rows], schema=SCHEMA)])

    def _write(self, tables: Iterable[pa.Table]) -> None:
        path = self.folder / "cases" / f"{uuid.uuid4().hex}.parquet"
        with replacing(path) as file, pq.ParquetWriter(file, SCHEMA, compression="zstd") as writer:
            for table in tables:
                writer.write_table(table)

    def rows(self, columns: Sequence[str] = tuple(SCHEMA.names)) -> list[dict[str, Any]]:
        """The last row of every case, in the order of names, and one for each file that makes no sense."""
        parts = self.parts
        found = [row for path in parts for row in _rows(path, {*columns, *OWN}) or [_spoilt(path)]]
        if not set(parts) <= set(self.parts):  # a survey has merged some meanwhile: their rows are elsewhere
            return self.rows(columns)
        last = _last(found)
        return [{column: last[name][column] for column in columns} for name in sorted(last)]

    def merge(self) -> None:
        """Put all files into one with the last row of each case, if they are many.

        Whenever this is cut short, no row is lost: the new file is there before the old ones go. Where the disk has no
        room for both, or one is damaged, they stay.
        """
        own = {path: rows for path in self.parts if (rows := _rows(path, OWN))}
        if len(own) > FILES:
            last = _last(row for rows in own.values() for row in rows)
            with suppress(OSError, pa.ArrowException):
                self._write(_kept(own, last))
                for path in own:
                    path.unlink(missing_ok=True)


def _last(rows: Iterable[Row]) -> dict[str, Row]:
    """The row of each case that was finished last, by name."""
    return {row["name"]: row for row in sorted(rows, key=lambda row: row["finished"])}


def _rows(path: Path, columns: Collection[str]) -> list[dict[str, Any]]:
    """Rows of a file; none if it is damaged, or no survey wrote it: its cases are then diagnosed again."""
    rows: list[dict[str, Any]] = []
    try:
        left = LARGEST - regular_size(path, LARGEST)  # nor is a pipe waited for
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(GROUP, columns=list(columns)) if file.metadata.num_rows <= MOST else ():
                table = _chosen(pa.Table.from_batches([batch]), columns)
                left -= table.nbytes  # what stands there often is stored once
                if left < 0:
                    return []
                rows += table.to_pylist()
    except (OSError, ValueError, KeyError, OverflowError, pa.ArrowException):
        return []
    return rows if all(map(_makes_sense, rows)) else []


def _chosen(table: pa.Table, columns: Iterable[str]) -> pa.Table:
    """Columns of a table as the schema has them: an earlier version may have had more."""
    return table.select(list(columns)).cast(pa.schema([SCHEMA.field(column) for column in columns]))


def _makes_sense(row: Row) -> bool:
    """Whether what is read of a row is all there: of one that was diagnosed, verdict and lists."""
    if row["status"] not in STATUSES or None in (row["name"], row["date"], row["finished"]):
        return False
    lists = [(row[name], keys) for name, keys in FULL.items() if name in row]
    return row["status"] != "done" or (row["verdict"] in VERDICTS and all(_is_full(*one) for one in lists))


def _is_full(items: Sequence[Any] | None, keys: Sequence[str]) -> bool:
    return items is not None and all(one is not None and None not in [one[key] for key in keys] for one in items)


def _spoilt(path: Path) -> dict[str, Any]:
    """Row of a file that makes no sense."""
    return dict.fromkeys(SCHEMA.names) | {
        "name": f"cases/{printable(path.name)}",
        "date": file_time(path),
        "dated_by": "file",
        "status": "failed",
        "reason": "it is damaged, or no survey wrote it: remove it from the dataset",
        "finished": file_time(path),
    }


def _kept(parts: Iterable[Path], last: Mapping[str, Row]) -> Iterator[pa.Table]:
    """Those rows of files that are the last of their cases, a few at a time."""
    for path in parts:
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(GROUP):
                table = _chosen(pa.Table.from_batches([batch]), SCHEMA.names)
                names, times = (table[column].to_pylist() for column in ("name", "finished"))
                yield table.filter([last[name]["finished"] == time for name, time in zip(names, times, strict=True)])
