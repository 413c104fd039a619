"""What is surveyed: recordings in folders, globs, studies and tables, each with its robot, joint and date.

A table has a column `file`, relative to the table, and may have `robot`, `joint`, `date` and `kind`; siblings are the
joints of one kind. Elsewhere the path tells: `arm3/elbow/2026-03-01.csv`, or what a pattern makes of it.
"""

from __future__ import annotations

import csv
import glob
import math
import os
import re
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import takewhile
from pathlib import Path, PurePosixPath

import pyarrow.parquet as pq

from pendulum_env.lookup import find
from pendulum_env.mistake import Mistake
from pendulum_env.reading import amount, read_bytes, regular_size
from pendulum_env.recording import Source
from pendulum_env.recording.storage import READERS
from workbench.inputs import sources_of
from workbench.mistakes import InputError

STUDY = "study.toml"
PROSE = (".txt",)  # endings that a folder is not searched for: they are rarely recordings
LABELS = ("robot", "joint", "kind", "date")
DATE = re.compile(
    r"(?<!\d)(?P<year>\d{4})(?P<dash>-?)(?P<month>\d\d)(?P=dash)(?P<day>\d\d)"
    r"(?:[T_ -](?P<hour>\d\d)[-:h]?(?P<minute>\d\d)(?:[-:m]?(?P<second>\d\d))?)?(?!\d)"
)
TABLE = 100_000_000  # bytes, of a million rows


@dataclass(frozen=True)
class Case:
    """One recording to diagnose.

    Attributes:
        name: its path below what is surveyed, and its stretch of time if that is not all: the same in every run.
        source: the file, and how it is read.
        robot: the machine.
        joint: of the machine.
        kind: joints of one kind are siblings; the joint's own name unless a table says otherwise.
        date: when it was recorded, UTC.
        dated_by: what tells that: the table, the name, or the time of the file.
    """

    name: str
    source: Source
    robot: str
    joint: str
    kind: str
    date: datetime
    dated_by: str


def find_cases(names: Sequence[str], reading: Namespace, pattern: str | None = None) -> list[Case]:
    """The recordings that folders, globs, studies, tables and files name, in the order of their names.

    Args:
        names: of folders, globs, `study.toml`, tables, or recordings.
        reading: how recordings are read that no study speaks of: `columns`, `unwrap`, `max_size`.
        pattern: what names mean, such as `{robot}/{joint}_{date}`, for files that no table speaks of.

    Raises:
        InputError: if there are none, one is named twice, or a table or a name makes no sense.
        StudyError: if a study makes no sense.
    """
    given = [named for name in names for named in _expanded(name)]
    root = Path(os.path.commonpath([_root(Path(_before_pattern(name))) for name in names]))
    found: dict[str, Case] = {}
    for path in given:
        for case in _cases(path, root, reading, pattern):
            if found.setdefault(case.name, case) is not case:
                raise InputError(f"{case.source.file}: is named twice: name each recording once")
    if not found:
        raise InputError(f"{names[0]}: holds no recording: files end in {', '.join(_endings())}, or in .txt if named")
    return [found[name] for name in sorted(found)]


def _expanded(name: str) -> list[Path]:
    if Path(name).exists():
        return [Path(name)]
    if not glob.has_magic(name):
        raise InputError(f"{name}: there is no such folder or file: check the path")
    paths = [Path(path) for path in sorted(glob.glob(name, recursive=True))]
    if not paths:
        raise InputError(f"{name}: names no file: check the pattern")
    return [path for path in paths if path.is_file()] or paths


def _before_pattern(name: str) -> str:
    """Folders of a name up to its first pattern, so that cases are called alike whatever it matches today."""
    if not glob.has_magic(name) or Path(name).exists():
        return name
    return str(Path(*takewhile(lambda part: not glob.has_magic(part), Path(name).parts)))


def _root(path: Path) -> Path:
    path = Path(os.path.abspath(path))  # a link is called as it is called, not as what it leads to
    return path if path.is_dir() else path.parent


def _endings() -> list[str]:
    return [ending for ending in READERS if ending not in PROSE]


def _cases(path: Path, root: Path, reading: Namespace, pattern: str | None) -> Iterator[Case]:
    if path.is_dir():
        yield from (_named(source, root, pattern) for source in _in_folder(path, reading))
    elif (rows := _rows(path)) is not None:
        for number, row in enumerate(rows, 2):
            try:
                yield _tabled(path.parent, row, root, reading, pattern)
            except InputError as error:
                raise InputError(f"{path}, row {number}: {error}") from None
    else:
        yield from (_named(source, root, pattern) for source in sources_of(str(path), reading))


def _in_folder(folder: Path, reading: Namespace) -> Iterator[Source]:
    """Recordings below a folder; what a study names is read as it says, hidden files and surveys are passed over."""
    told: set[Path] = set()
    files: list[Path] = []
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and not is_survey(Path(where, name)))
        if STUDY in names:
            for source in sources_of(str(Path(where, STUDY)), reading):
                told.add(source.file.resolve())
                yield source
        ending = tuple(_endings())
        files += [Path(where, name) for name in names if name.lower().endswith(ending) and not name.startswith(".")]
    for file in files:
        if file.resolve() not in told:
            yield from sources_of(str(file), reading)


def is_survey(folder: Path) -> bool:
    """Whether a survey was written there: its dataset is no recording."""
    return (folder / "cases").is_dir() and (folder / "SURVEY").exists()


# ------------------------------------------------------------------------------------------------- tables and names


def _rows(path: Path) -> list[dict[str, str]] | None:
    """Rows of a table of recordings; None if the file is no such table."""
    name = path.name.lower()
    try:
        if name.endswith((".csv", ".parquet")):
            regular_size(path, math.inf)
        if name.endswith(".csv"):
            with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
                headers = next(csv.reader([file.readline(1 << 16)]), [])
            if "file" not in map(_key, headers):
                return None
            rows = csv.reader(read_bytes(path, TABLE).decode("utf-8-sig").splitlines())
            next(rows)
            return [_row(path, headers, row) for row in rows if row]
        if name.endswith(".parquet"):
            headers = pq.read_schema(path).names
            if "file" not in map(_key, headers):
                return None
            return [_row(path, headers, row) for row in _cells(path)]
    except (OSError, ValueError, csv.Error) as error:
        if isinstance(error, Mistake):
            raise
        return None  # what cannot be read is told where recordings are read
    return None


def _cells(path: Path) -> Iterator[list[str]]:
    """Rows of a table in Parquet, where what stands there often is stored once."""
    size = 0
    with pq.ParquetFile(path) as file:
        for batch in file.iter_batches(batch_size=16):
            cells = ["" if cell is None else str(cell) for row in batch.to_pylist() for cell in row.values()]
            size += sum(map(len, cells))
            if size > TABLE:
                raise InputError(f"{path}: holds more than the {amount(TABLE)} that a table may: leave out columns")
            yield cells


def _key(header: str) -> str:
    return header.strip().lower()


def _row(path: Path, headers: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    row = {_key(header): cell.strip() for header, cell in zip(headers, cells, strict=False)}
    for name in row:
        try:
            find("column", name, dict.fromkeys(("file", *LABELS)))
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
    return row


def _tabled(folder: Path, row: Mapping[str, str], root: Path, reading: Namespace, pattern: str | None) -> Case:
    if not row.get("file"):
        raise InputError("names no file: fill in the column file")
    (source,) = _one(sources_of(str(folder / row["file"]), reading), row["file"])
    return _named(source, root, pattern, {name: row[name] for name in LABELS if row.get(name)})


def _one(sources: Sequence[Source], name: str) -> Sequence[Source]:
    if len(sources) != 1:
        raise InputError(f"{name}: a table names recordings, one in each row: name the study itself to survey it")
    return sources


def _named(source: Source, root: Path, pattern: str | None, told: Mapping[str, str] | None = None) -> Case:
    """A case from its source; what is not told of it, the path below the root tells."""
    told = dict(told or {})
    below = PurePosixPath(Path(os.path.relpath(source.file, root)).as_posix())
    guessed = _matched(below, pattern) if pattern is not None else _guessed(below)
    stretch = "" if source.range is None else f"#{source.range[0]:g}-{source.range[1]:g}"
    if "date" in told:
        date, dated_by = _date(told["date"]), "table"
        if date is None:
            raise InputError(f"{told['date']!r} is no date: write it as 2026-03-01 or 2026-03-01T14:30")
    else:
        date, dated_by = _date(guessed.get("date", "")), "name"
    if date is None:
        date, dated_by = _file_time(source.file), "file"
    labels = guessed | told
    joint = labels.get("joint", "")
    return Case(
        str(below) + stretch, source, labels.get("robot", ""), joint, labels.get("kind") or joint, date, dated_by
    )


def _guessed(below: PurePosixPath) -> dict[str, str]:
    """Robot, joint and date from a path: folders name robot and joint, or the file the joint of a dated folder."""
    stem = _stem(below)
    folders = [part for part in below.parts[:-1] if part != ".."]
    plain = [part for part in folders if _date(part) is None]
    rest = DATE.sub("", stem).strip(" _-.")
    dates = [text[0] for part in (stem, *reversed(folders)) if (text := DATE.search(part)) and _date(text[0])]
    dated_folder = len(plain) < len(folders) and DATE.search(stem) is None
    words = [*plain, rest or stem] if dated_folder or not plain else plain
    found = {"joint": words[-1], "robot": words[-2] if len(words) > 1 else ""}
    return found | ({"date": dates[0]} if dates else {})


def _matched(below: PurePosixPath, pattern: str) -> dict[str, str]:
    parts = re.split(r"(\{\w*\}|\*)", pattern)
    try:
        for part in parts[1::2]:
            if part != "*":
                find("part of a name", part[1:-1], dict.fromkeys(LABELS))
        text = "".join(
            "[^/]*" if part == "*" else f"(?P<{part[1:-1]}>[^/]+?)" if k % 2 else re.escape(part)
            for k, part in enumerate(parts)
        )
        compiled = re.compile(f"(?:.*/)?{text}")
    except (ValueError, re.error) as error:
        raise InputError(f"{pattern}: {error}: write names as {{robot}}/{{joint}}_{{date}}") from None
    match = compiled.fullmatch(str(below.parent / _stem(below)))
    if match is None:
        raise InputError(f"{below}: does not read as {pattern}: mend --names, or use a table")
    return match.groupdict()


def _stem(path: PurePosixPath) -> str:
    ending = next((ending for ending in READERS if path.name.lower().endswith(ending)), path.suffix)
    return path.name[: len(path.name) - len(ending)]


def _date(text: str) -> datetime | None:
    """A date, UTC unless it says otherwise; None if the text is none."""
    if match := DATE.fullmatch(text.strip()):
        day, hour, minute, second = (
            "".join(match.group("year", "month", "day")),
            *match.group("hour", "minute", "second"),
        )
        try:
            return datetime.strptime(f"{day}{hour or '00'}{minute or '00'}{second or '00'}+0000", "%Y%m%d%H%M%S%z")
        except ValueError:
            return None
    try:
        date = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return date.astimezone(UTC) if date.tzinfo else date.replace(tzinfo=UTC)


def _file_time(file: Path) -> datetime:
    try:
        return datetime.fromtimestamp(file.stat().st_mtime, UTC)
    except OSError:  # told when the file is read
        return datetime.fromtimestamp(0, UTC)


def joints(cases: Iterable[Case]) -> int:
    """Number of joints among cases."""
    return len({(case.robot, case.joint) for case in cases})
