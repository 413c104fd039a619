"""The Parquet dataset of a survey: a row for each case, in files that are whole or not there."""

import uuid
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from pendulum_env._typing import JSON
from pendulum_env.files import replacing, write_whole
from pendulum_env.recording.arrays import read_rows
from workbench.mistakes import printable
from workbench.survey.cases import file_time

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
        "version": TEXT,  # of this project
        "settings": TEXT,  # hash of all that was asked for
        "finished": pa.timestamp("us", "UTC"),
    }
)
# What has to be in a row, where it is asked for, if it is done, and in each item of that.
LISTS = {"selected": (), "ambiguous": (), "candidates": ("effect", "verdict"), "parameters": ("name", "value", "unit")}
OWN = ("name", "status", "verdict", "date", "finished")  # columns by which a row is judged
SPOILT = "it is damaged, or no survey wrote it: remove it from the dataset"
FILES = 16  # that a dataset is left with: each takes two milliseconds whenever it is read


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
        """Make the folder, if it is not there; raises OSError if it cannot be made."""
        (self.folder / "cases").mkdir(parents=True, exist_ok=True)
        if not (self.folder / "SURVEY").exists():
            write_whole(self.folder / "SURVEY", "Written by pendulum-ident survey: cases/ is one Parquet dataset.\n")

    def append(self, rows: Iterable[JSON]) -> None:
        """Add rows as one more file, whole or not at all; raises OSError if it cannot be written, as on a full disk."""
        self._write(pa.Table.from_pylist(list(rows), schema=SCHEMA))

    def _write(self, table: pa.Table) -> None:
        with replacing(self.folder / "cases" / f"{uuid.uuid4().hex}.parquet") as file:
            pq.write_table(table, file, compression="zstd")

    def rows(self, columns: Sequence[str] = tuple(SCHEMA.names)) -> list[JSON]:
        """The last row of every case, in the order of names, and one for each file that is damaged.

        A row that no survey wrote is one of a case that failed, which says so.
        """
        parts = self.parts
        needed = list(dict.fromkeys((*OWN, *columns)))
        tables = {path: _read(path, needed) for path in parts}
        if not set(parts) <= set(self.parts):  # a survey has merged some meanwhile: their rows are elsewhere
            return self.rows(columns)
        broken = [(f"cases/{path.name}", file_time(path), file_time(path)) for path in parts if tables[path] is None]
        damaged = pa.Table.from_pylist([_spoilt(*one) for one in broken], schema=SCHEMA)
        found = _last([damaged.select(needed), *(table for table in tables.values() if table is not None)])
        now, rows = datetime.now(UTC), found.to_pylist()
        for row in rows:
            if not _is_sound(row):
                row |= dict.fromkeys(row) | _spoilt(row["name"], row["date"] or now, row["finished"] or now)
        return [{name: row[name] for name in columns} for row in rows]

    def merge(self) -> None:
        """Put all files into one with the last row of each case, if they are many.

        The new file is there before the old ones go. Where the disk has no room for both, they stay; so does one that
        is damaged.
        """
        if len(parts := self.parts) <= FILES:
            return
        read = {path: table for path in parts if (table := _read(path, SCHEMA.names)) is not None}
        with suppress(OSError, pa.ArrowException):
            self._write(_last(list(read.values())))
            for path in read:
                path.unlink(missing_ok=True)


def _read(path: Path, columns: Sequence[str]) -> pa.Table | None:
    """Columns of a file; None if it is damaged, or no survey wrote it: its cases are then diagnosed again."""
    try:
        table = read_rows(path, pa.schema([SCHEMA.field(name) for name in columns]))
        table.select(["date", "finished"]).to_pylist()  # dates have a year
    except (OSError, ValueError, OverflowError):
        return None
    return None if table["name"].null_count else table


def _is_sound(row: JSON) -> bool:
    """Whether a row is as a survey writes it, as far as anything is made of it."""
    page = row.get("report") or ""
    is_page = page.isprintable() and len(page.encode()) <= 200  # bytes of its name
    if row["status"] not in STATUSES or None in (row["date"], row["finished"]) or not is_page:
        return False
    if row["status"] != "done":
        return True
    lists = {name: keys for name, keys in LISTS.items() if name in row}
    return (
        row["verdict"] in VERDICTS
        and None not in [row[name] for name in lists]
        and all(
            one is not None and None not in [one[key] for key in lists[name]] for name in lists for one in row[name]
        )
        and all(one["variants"] is None or one["variants"] > 0 for one in row.get("candidates", ()))
    )


def _spoilt(name: str, date: datetime, finished: datetime) -> JSON:
    """What a row that makes no sense becomes, and a file that cannot be read."""
    known = {"name": printable(name), "date": date, "finished": finished}
    return known | {"dated_by": "file", "status": "failed", "reason": SPOILT}


def _last(tables: Sequence[pa.Table]) -> pa.Table:
    """The row of each case that was finished last, in the order of names."""
    table = pa.concat_tables(tables).sort_by("finished")
    place = {name: k for k, name in enumerate(table["name"].to_pylist())}
    return table.take(pa.array([place[name] for name in sorted(place)], pa.int64()))
