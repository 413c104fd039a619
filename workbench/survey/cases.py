"""What is surveyed: recordings in folders, studies and tables, each with its robot, joint and date."""

from __future__ import annotations

import csv
import os
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

import pyarrow.parquet as pq

from pendulum_env.lookup import find
from pendulum_env.recording import Source
from pendulum_env.recording.storage import READERS
from workbench.inputs import sources_of
from workbench.mistakes import InputError, printable
from workbench.survey.names import LABELS, date_of, guessed, matched

STUDY = "study.toml"
ENDINGS = tuple(ending for ending in READERS if ending != ".txt")  # that a folder is searched for; text is often prose
HEADER = 1 << 16  # characters of a table's first line


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
    """The recordings that folders, studies, tables and files name, in the order of their names.

    Args:
        names: of folders, `study.toml`, tables, or recordings.
        reading: how recordings are read that no study speaks of: `columns`, `unwrap`, `max_size`.
        pattern: what names mean, such as `{robot}/{joint}_{date}`, for files that no table speaks of.

    Raises:
        InputError: if there are none, one is named twice, or a table or a name makes no sense.
        StudyError: if a study makes no sense.
    """
    paths = [Path(name) for name in names]
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: there is no such folder or file: check the path, all below a folder is surveyed")
    places = [Path(os.path.abspath(path)) for path in paths]  # a link is called as it is called, not as where it leads
    root = Path(os.path.commonpath([place if place.is_dir() else place.parent for place in places]))
    found: dict[str, Case] = {}
    for path in paths:
        for source, told in _sources(path, reading):
            case = _case(source, told, root, pattern)
            if found.setdefault(case.name, case) is not case:
                raise InputError(f"{source.file}: is named twice: name each recording once")
    if not found:
        raise InputError(f"{names[0]}: holds no recording: files end in {', '.join(ENDINGS)}, or in .txt if named")
    return [found[name] for name in sorted(found)]


def _sources(path: Path, reading: Namespace) -> Iterator[tuple[Source, Mapping[str, str]]]:
    """Recordings of a folder, a table, a study or a file, each with what a table says of it."""
    if path.is_dir():
        yield from ((source, {}) for source in _in_folder(path, reading))
    elif not _is_table(path):
        yield from ((source, {}) for source in sources_of(str(path), reading))
    else:
        for number, row in enumerate(_table(path), 2):
            where = f"{path}, row {number}"
            if "file" not in row:
                raise InputError(f"{where}: names no file: fill in the column file")
            if "date" in row and date_of(row["date"]) is None:
                raise InputError(f"{where}: {row['date']!r} is no date: write it as 2026-03-01 or 2026-03-01T14:30")
            if Path(row["file"]).suffix.lower() == ".toml":
                raise InputError(f"{where}: {row['file']}: is a study: a table names recordings, one in each row")
            yield from ((source, row) for source in sources_of(str(path.parent / row["file"]), reading))


def _in_folder(folder: Path, reading: Namespace) -> Iterator[Source]:
    """Recordings below a folder; what a study names is read as it says, hidden files and rows of surveys are not."""
    told: set[str] = set()
    files: list[Path] = []
    left = [folder]  # a tree may be deeper than functions may call themselves
    while left:
        where, folders, names = next(os.walk(left.pop()), ("", [], []))  # one that may not be read is empty
        own = {"cases"} if is_survey(Path(where)) else set()
        kept = [Path(where, name) for name in folders if not (_is_hidden(name) or name in own)]
        left += [place for place in sorted(kept, reverse=True) if not place.is_symlink()]
        if STUDY in names:
            for source in sources_of(str(Path(where, STUDY)), reading):
                told.add(os.path.realpath(source.file))
                yield source
        files += [Path(where, name) for name in names if name.lower().endswith(ENDINGS) and not _is_hidden(name)]
    for file in files:
        if os.path.realpath(file) not in told:
            yield from sources_of(str(file), reading)


def _is_hidden(name: str) -> bool:
    return name.startswith(".") and name != ".."


def is_survey(folder: Path) -> bool:
    """Whether a survey was written there, perhaps beside recordings: its rows, below `cases`, are none."""
    return (folder / "cases").is_dir() and (folder / "SURVEY").exists()


def _is_table(path: Path) -> bool:
    """Whether a file has a column `file`; what cannot be read is told where recordings are read."""
    if not path.is_file():  # a pipe would be waited for
        return False
    try:
        if path.suffix.lower() == ".parquet":
            return "file" in _plain(pq.read_schema(path).names)
        if path.suffix.lower() != ".csv":
            return False
        with path.open(encoding="utf-8-sig") as lines:
            return "file" in _plain(lines.readline(HEADER).split(","))
    except (OSError, ValueError):
        return False


def _table(path: Path) -> list[dict[str, str]]:
    """Rows of a table of recordings, without cells in which nothing stands."""
    try:
        if path.suffix.lower() == ".parquet":
            table = pq.read_table(path)
            lines: list[Sequence[Any]] = [table.column_names, *zip(*table.to_pydict().values(), strict=True)]
        else:
            lines = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
        headers, *rows = filter(None, lines)
        for header in _plain(headers):
            find("column", header, dict.fromkeys(("file", *LABELS)))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: {error}") from None
    cells = [["" if cell is None else str(cell).strip() for cell in row] for row in rows]
    return [{name: cell for name, cell in zip(_plain(headers), row, strict=False) if cell} for row in cells]


def _plain(headers: Sequence[str]) -> list[str]:
    return [header.strip(' "').lower() for header in headers]


def _case(source: Source, told: Mapping[str, str], root: Path, pattern: str | None) -> Case:
    """A case from its source; what a table does not tell of it, the path below the root tells."""
    below = PurePosixPath(printable(Path(os.path.relpath(source.file, root)).as_posix()))
    stretch = "" if source.range is None else f"#{source.range[0]:g}-{source.range[1]:g}"
    from_name = matched(below, pattern) if pattern is not None else guessed(below)
    labels = from_name | dict(told)
    date, dated_by = date_of(labels.get("date", "")), "table" if "date" in told else "name"
    if date is None:
        date, dated_by = file_time(source.file), "file"
    joint = labels.get("joint", "")
    return Case(f"{below}{stretch}", source, labels.get("robot", ""), joint, labels.get("kind", joint), date, dated_by)


def file_time(file: Path) -> datetime:
    """When a file was changed last; 1970 if there is none, which is told when it is read."""
    try:
        return datetime.fromtimestamp(file.stat().st_mtime, UTC)
    except (OSError, ValueError, OverflowError):
        return datetime.fromtimestamp(0, UTC)


def joints(cases: Iterable[Case]) -> int:
    """Number of joints among cases."""
    return len({(case.robot, case.joint) for case in cases})
