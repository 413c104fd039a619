"""What is surveyed: recordings in folders, studies and tables, each with its robot, joint and date.

What no table says, the path does: `arm3/elbow/2026-03-01.csv` is of a robot, a joint and a date.
"""

import csv
import os
import re
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path, PurePosixPath

import pyarrow.parquet as pq

from pendulum_env.lookup import find
from pendulum_env.mistake import Mistake
from pendulum_env.recording import Source, StudyError
from pendulum_env.recording.arrays import read_rows
from pendulum_env.recording.storage import READERS
from workbench.inputs import sources_of
from workbench.mistakes import InputError, printable

STUDY = "study.toml"
ENDINGS = tuple(ending for ending in READERS if ending != ".txt")  # that a folder is searched for; text is often prose
LABELS = ("robot", "joint", "kind", "date")
WILD = 4  # words and stars in a folder's name, which take a power of its length to try
DATE = re.compile(r"(?<!\d)\d{4}(-?)\d\d\1\d\d(?:[T_ -]\d\d[-:h]?\d\d(?:[-:m]?\d\d)?)?(?!\d)")


@dataclass(frozen=True)
class Case:
    """One recording to diagnose."""

    name: str  # its path below what is surveyed, and its range of time if that is not all: the same in every run
    source: Source  # the file, and how it is read
    robot: str  # the machine
    joint: str  # of the machine
    kind: str  # joints of one kind are siblings; the joint's own name unless a table says otherwise
    date: datetime  # when it was recorded, UTC
    dated_by: str  # what tells that: the table, the name, or the time of the file


def find_cases(names: Sequence[str], reading: Namespace, pattern: str | None = None) -> list[Case]:
    """The recordings that folders, studies, tables and files name, in the order of their names.

    Args:
        names: of folders, `study.toml`, tables, or recordings.
        reading: how recordings are read that no study speaks of: `columns`, `unwrap`.
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
        for source, row in _sources(path, reading):
            case = _case(source, row, root, pattern)
            if found.setdefault(case.name, case) is not case:
                raise InputError(f"{source.file}: is named twice: name each recording once")
    if not found:
        raise InputError(f"{names[0]}: holds no recording: files end in {', '.join(ENDINGS)}, or in .txt if named")
    return [found[name] for name in sorted(found)]


def _sources(path: Path, reading: Namespace) -> Iterator[tuple[Source, Mapping[str, str]]]:
    """Recordings of a folder, a table, a study or a file, each with what a table says of it."""
    rows = _table(path) if path.is_file() else None
    if path.is_dir():
        yield from ((source, {}) for source in _in_folder(path, reading))
    elif rows is None:
        yield from ((source, {}) for source in sources_of(str(path), reading))
    for number, row in enumerate(rows or (), 2):
        where = f"{path}, row {number}"
        if "\0" in row.get("file", "\0"):
            raise InputError(f"{where}: names no file: fill in the column file")
        if "date" in row and date_of(row["date"]) is None:
            raise InputError(f"{where}: {row['date']!r} is no date: write it as 2026-03-01 or 2026-03-01T14:30")
        if Path(row["file"]).suffix.lower() == ".toml":
            raise InputError(f"{where}: {row['file']}: is a study: a table names recordings, one in each row")
        yield from ((source, row) for source in sources_of(str(path.parent / row["file"]), reading))


def _in_folder(folder: Path, reading: Namespace) -> Iterator[Source]:
    """Recordings below a folder, read as a study there says; hidden files and rows of surveys are none."""
    in_study: set[str] = set()
    files: list[Path] = []
    for where, folders, names in _walk(folder):
        own = ["cases"] if is_survey(Path(where)) else []
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name not in own)
        if STUDY in names:
            try:
                told = sources_of(str(Path(where, STUDY)), reading)
            except StudyError:  # its row will say why; nobody knows how the recordings beside it are read
                told, names = (Source(Path(where, STUDY)),), []
            in_study |= {os.path.realpath(source.file) for source in told}
            yield from told
        files += [Path(where, name) for name in names if name.lower().endswith(ENDINGS) and not name.startswith(".")]
    for file in files:
        if os.path.realpath(file) not in in_study:
            yield from sources_of(str(file), reading)


def _walk(folder: Path) -> Iterator[tuple[str, list[str], list[str]]]:
    try:
        yield from os.walk(folder)
    except RecursionError:  # which Python 3.12 no longer knows
        raise InputError(f"{folder}: has folders in folders without end: survey one further down") from None


def is_survey(folder: Path) -> bool:
    """Whether a survey was written there, perhaps beside recordings: its rows, below `cases`, are none."""
    return (folder / "cases").is_dir() and (folder / "SURVEY").exists()


def _table(path: Path) -> list[dict[str, str]] | None:
    """Rows of a table of recordings, without empty cells; None if the file is none: it has no column `file`."""
    try:
        if path.suffix.lower() == ".parquet":
            table = read_rows(path) if "file" in pq.read_schema(path).names else None
            lines = [] if table is None else [table.column_names, *zip(*table.to_pydict().values(), strict=True)]
        elif path.suffix.lower() == ".csv":
            with path.open(encoding="utf-8-sig", newline="") as file:
                reader = csv.reader(file)
                first = [header.strip().lower() for header in next(reader, [])]
                lines = [first, *reader] if "file" in first else []
        else:
            return None
    except (OSError, ValueError, csv.Error):
        return None  # what cannot be read is told where recordings are read
    if not lines:
        return None
    headers, *rows = lines
    try:
        for header in headers:
            find("column", header, dict.fromkeys(("file", *LABELS)))
    except Mistake as error:
        raise InputError(f"{path}: {error}") from None
    cells = [["" if cell is None else str(cell).strip() for cell in row] for row in rows if row]
    return [{name: cell for name, cell in zip(headers, row, strict=False) if cell} for row in cells]


def _case(source: Source, row: Mapping[str, str], root: Path, pattern: str | None) -> Case:
    """A case from its source; what a table does not tell of it, the path below the root tells."""
    below = PurePosixPath(printable(Path(os.path.relpath(source.file, root)).as_posix()))
    part = "" if source.range is None else f"#{source.range[0]:g}-{source.range[1]:g}"
    labels = (guessed(below) if pattern is None else matched(below, pattern)) | dict(row)
    date, dated_by = date_of(labels.get("date", "")), "table" if "date" in row else "name"
    if date is None:
        date, dated_by = file_time(source.file), "file"
    joint = labels.get("joint", "")
    return Case(f"{below}{part}", source, labels.get("robot", ""), joint, labels.get("kind", joint), date, dated_by)


def date_of(text: str) -> datetime | None:
    """A date, UTC unless it says otherwise; None if the text is none."""
    try:
        if DATE.fullmatch(text):
            return datetime.strptime(re.sub(r"\D", "", text).ljust(14, "0"), "%Y%m%d%H%M%S").replace(tzinfo=UTC)
        date = datetime.fromisoformat(text)
        return date.astimezone(UTC) if date.tzinfo else date.replace(tzinfo=UTC)
    except (ValueError, OverflowError):  # of the 31st of February
        return None


def guessed(path: PurePosixPath) -> dict[str, str]:
    """Robot, joint and date: folders name robot and joint, or the file the joint of a folder that is a date."""
    stem = _stem(path)
    folders = [part for part in path.parts[:-1] if part != ".."]
    plain = [part for part in folders if date_of(part) is None]
    dates = [match[0] for part in (stem, *reversed(folders)) if (match := DATE.search(part)) and date_of(match[0])]
    names_joint = not plain or (len(plain) < len(folders) and DATE.search(stem) is None)
    words = ["", *plain, *[DATE.sub("", stem).strip(" _-.") or stem] * names_joint]
    return {"robot": words[-2], "joint": words[-1]} | ({"date": dates[0]} if dates else {})


def matched(path: PurePosixPath, pattern: str) -> dict[str, str]:
    """What a pattern such as `{robot}/{joint}_{date}` takes from the end of a path, folder by folder.

    Raises:
        InputError: if the pattern makes no sense, or the path does not match it.
    """
    wanted = [_expression(folder) for folder in pattern.split("/")]
    for label in LABELS:
        if pattern.count(f"{{{label}}}") > 1:
            raise InputError(f"{pattern}: {label} is named twice: name it once")
    parts = [*path.parts[:-1], _stem(path)][-len(wanted) :]
    found = [expression.fullmatch(part) for expression, part in zip(wanted, parts, strict=False)]
    if len(parts) < len(wanted) or None in found:
        raise InputError(f"{path}: does not read as {pattern}: mend --names, or use a table")
    return {label: text for match in found if match for label, text in match.groupdict().items()}


@cache
def _expression(folder: str) -> re.Pattern[str]:
    """A folder's name in a pattern as a regular expression."""
    if len(re.findall(r"\{\w*\}|\*+", folder)) > WILD:
        raise InputError(f"{folder}: holds more than {WILD} words and * between slashes: use a table")
    for label in re.findall(r"\{(\w*)\}", folder):
        find("part of a name", label, dict.fromkeys(LABELS))
    plain = re.sub(r"(\\\*)+", ".*", re.escape(folder))
    try:
        return re.compile(re.sub(r"\\\{(\w+)\\\}", r"(?P<\1>.+?)", plain))
    except re.error as error:
        raise InputError(f"{folder}: {error}: write names as {{robot}}/{{joint}}_{{date}}, or use a table") from None


def _stem(path: PurePosixPath) -> str:
    ending = next((ending for ending in READERS if path.name.lower().endswith(ending)), path.suffix)
    return path.name[: len(path.name) - len(ending)]


def file_time(file: Path) -> datetime:
    """When a file was changed last; 1970 if there is none, which is told when it is read."""
    try:
        return datetime.fromtimestamp(file.stat().st_mtime, UTC)
    except (OSError, ValueError, OverflowError):
        return datetime.fromtimestamp(0, UTC)


def joints(cases: Iterable[Case]) -> int:
    """Number of joints among cases."""
    return len({(case.robot, case.joint) for case in cases})
