"""Recordings below a folder, with machine and date from their paths.

Each folder is one machine, without folders named by a date: `arm3/2026-03-01/run.csv` is a recording of arm3.
"""

import os
import re
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePosixPath

import numpy as np

from pendulum_env.recording import Source
from pendulum_env.recording.formats import READERS
from pendulum_env.recording.lerobot import find_dataset
from workbench.errors import InputError, escape_controls
from workbench.inputs import read_source_names

STUDY = "study.toml"
TABLES = ("survey.parquet", "survey.csv")  # output of a survey
ENDINGS = tuple(ending for ending in READERS if ending not in (".txt", ".json"))  # often notes, or a model
SIXTY = r"[0-5]\d"
TIME = rf"(?:[01]\d|2[0-3])([-:]?){SIXTY}(?:\2{SIXTY})?(?!\d|-\d\d-\d\d|k?Hz)"  # 2000Hz is a rate
DATE = re.compile(rf"(?<!\d)\d{{4}}(-?)\d\d\1\d\d(?:[T_ -]{TIME})?(?!\d)")
FUTURE = timedelta(days=1)  # largest difference of clocks and time zones


@dataclass(frozen=True)
class SurveyedRecording:
    """Source, machine and date of a recording to diagnose."""

    name: str  # path below the folder, with the time range if it is a part
    machine: str  # path of its folder without dates
    date: datetime  # UTC
    dated_by: str  # "name": date in the path; "file": last change of the file
    source: Source


def find_recordings(folder: Path, reading: Namespace) -> list[SurveyedRecording]:
    """List the recordings below a folder, sorted by name.

    Hidden files, text files and tables of surveys are ignored. `reading` holds the reading options; a `study.toml`
    sets those of its recordings. Raises InputError without recordings, and StudyError if a study is invalid.
    """
    if folder.is_file():
        raise InputError(f"{folder}: is a file: name a folder, or use diagnose for one recording")
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder: check the path")
    folder = Path(os.path.abspath(folder))  # absolute for workers of a cluster
    recordings = [_label_source(source, folder) for source in _find_sources(folder, reading)]
    if not recordings:
        raise InputError(f"{folder}: holds no recording: their names end in {', '.join(ENDINGS)}")
    return sorted(recordings, key=lambda recording: recording.name)


def _find_sources(folder: Path, reading: Namespace) -> Iterator[Source]:
    named: set[str] = set()  # files named by studies
    files: list[Path] = []
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        if STUDY in names:
            sources = read_source_names(str(Path(place, STUDY)), reading)
            named |= {os.path.realpath(source.file) for source in sources}
            yield from sources
        if find_dataset(place) is not None:
            folders.clear()
            files.append(Path(place))
            continue
        visible = [name for name in names if not (name.startswith(".") or name in TABLES)]
        files += [Path(place, name) for name in visible if name.lower().endswith(ENDINGS)]
    others = (source for file in files for source in read_source_names(str(file), reading))
    yield from (source for source in others if os.path.realpath(source.file) not in named)


def _label_source(source: Source, folder: Path) -> SurveyedRecording:
    path = PurePosixPath(escape_controls(Path(os.path.relpath(source.file, folder)).as_posix()))
    ends = [np.format_float_positional(time, trim="-") for time in source.range or ()]
    part = f"#{'-'.join(ends)}" if ends else ""
    folders = [name for name in path.parts[:-1] if name != ".."]
    machine = "/".join(name for name in folders if parse_date(name) is None) or folder.name
    texts = [match[0] for name in (path.name, *reversed(folders)) for match in DATE.finditer(name)]
    dates = [date for text in texts if (date := parse_date(text)) is not None and not is_future(date)]
    dataset = find_dataset(source.file)
    date = dates[0] if dates else _read_change_time(dataset[0] if dataset else source.file)
    return SurveyedRecording(f"{path}{part}", machine, date, "name" if dates else "file", source)


def is_future(date: datetime) -> bool:
    """Return whether a date is more than `FUTURE` from now."""
    return date > datetime.now(UTC) + FUTURE


def parse_date(text: str) -> datetime | None:
    """Parse a date such as `2026-03-01`, `20260301T1405` or `2026-03-01_14-05-30` as UTC; None for other texts."""
    if not DATE.fullmatch(text):
        return None
    try:
        return datetime.strptime(re.sub(r"\D", "", text).ljust(14, "0"), "%Y%m%d%H%M%S").replace(tzinfo=UTC)
    except ValueError:  # for example the 31st of February
        return None


def _read_change_time(file: Path) -> datetime:
    """Return the time of a file's last change; 1970 for a missing file."""
    try:
        return datetime.fromtimestamp(file.stat().st_mtime, UTC)
    except (OSError, ValueError, OverflowError):
        return datetime.fromtimestamp(0, UTC)
