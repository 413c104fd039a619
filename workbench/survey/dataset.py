"""The Parquet dataset of a survey: one row for each case, in files that are whole or not there."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pendulum_env.files import replacing, write_whole

Row = Mapping[str, Any]

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
        "status": TEXT,  # done, refused (the file cannot be used) or failed (to be tried again)
        "reason": TEXT,  # why it was refused or failed
        "verdict": TEXT,  # nothing, missing, unexplained
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
        "memory": NUMBER,  # most that the worker has had [MB]
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
MERGED = 16  # files up to which a dataset is left as it is
CROWD = 200  # the same while a survey goes on: two milliseconds each, whenever it is looked at
READINGS = 3  # of a dataset whose files are merged meanwhile
GROUP = 500  # rows that are copied at a time


@dataclass(frozen=True)
class Dataset:
    """A folder of Parquet files, `cases/*.parquet`; any Parquet reader takes them as one table.

    Of several rows for a case the last one holds. One survey at a time may write there.
    """

    folder: Path

    @property
    def parts(self) -> list[Path]:
        """Its files, oldest first."""
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
        """Add rows as one more file, whole or not at all.

        Raises:
            OSError: if it cannot be written, as on a full disk.
        """
        if rows:
            self._write([pa.Table.from_pylist([dict(row) for row in rows], schema=SCHEMA)])

    def _write(self, tables: Iterable[pa.Table]) -> None:
        number = int(self.parts[-1].name.split("-")[0]) + 1 if self.parts else 0
        path = self.folder / "cases" / f"{number:08d}-{uuid.uuid4().hex[:8]}.parquet"
        with replacing(path) as file, pq.ParquetWriter(file, SCHEMA, compression="zstd") as writer:
            for table in tables:
                writer.write_table(table)

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """The last row of every case, in the order of names; all columns, or some.

        Raises:
            OSError: if its files are merged again and again while they are read.
        """
        wanted = list(columns) if columns is not None else SCHEMA.names
        read = list(dict.fromkeys(["name", *wanted]))
        for _ in range(READINGS):
            parts = self.parts
            rows = _last(parts)
            tables = [part.take(rows[k]) for k, path in enumerate(parts) if (part := _part(path, read)) is not None]
            if set(parts) <= set(self.parts):  # else a survey has merged some meanwhile: their rows are elsewhere
                together = pa.concat_tables([SCHEMA.empty_table().select(read), *tables])
                return together.sort_by("name").select(wanted)
        raise OSError(f"{self.folder}: its files change while they are read: try again")

    def rows(self, columns: Sequence[str] | None = None) -> list[dict[str, Any]]:
        """`table` as dictionaries."""
        found: list[dict[str, Any]] = self.table(columns).to_pylist()
        return found

    def merge(self, most: int = MERGED) -> bool:
        """Put all files into one, which holds the last row of each case, if there are more; a part at a time is held.

        Whenever this is cut short, no row is lost: the new file is there before the old ones go. Where the disk has no
        room for both, or one is damaged, they stay.

        Returns:
            Whether it is worth trying again: False if it failed, or there are more files that cannot be read.
        """
        everything = self.parts
        if len(everything) <= most:
            return True
        parts = [path for path in everything if _part(path, ("name",)) is not None]  # others may be readable again
        if len(parts) > most:
            try:
                self._write(_kept(parts))
                for path in parts:
                    path.unlink(missing_ok=True)
            except (OSError, pa.ArrowException, ValueError):
                return False
        return len(everything) - len(parts) <= most


def _last(parts: Sequence[Path]) -> list[pa.Array]:
    """Places in each file of those rows that are the last of their case."""
    last: dict[str, tuple[int, int, int]] = {}  # time, file, place
    for k, path in enumerate(parts):
        table = _part(path, ("name", "finished"))
        if table is not None:
            times = table["finished"].cast(pa.int64()).to_pylist()
            for place, (name, time) in enumerate(zip(table["name"].to_pylist(), times, strict=True)):
                last[name] = max(last.get(name, (time, k, place)), (time, k, place))
    places: list[list[int]] = [[] for _ in parts]
    for _, k, place in last.values():
        places[k].append(place)
    return [pa.array(sorted(own), pa.int64()) for own in places]


def _kept(parts: Sequence[Path]) -> Iterator[pa.Table]:
    """The last row of each case, a few at a time."""
    for path, places in zip(parts, _last(parts), strict=True):
        if not len(places):
            continue
        first = 0
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(GROUP):
                inside = pc.and_(pc.greater_equal(places, first), pc.less(places, first + len(batch)))
                own = pc.subtract(places.filter(inside), first)
                first += len(batch)
                if len(own):
                    yield pa.Table.from_batches([batch]).take(own).cast(SCHEMA)


def _part(path: Path, columns: Sequence[str]) -> pa.Table | None:
    """Columns of one file; None if it is no such file: its cases are then diagnosed again."""
    try:
        return pq.read_table(path, schema=SCHEMA, columns=list(columns))
    except (OSError, pa.ArrowException):
        return None
