"""A study: a file `study.toml` beside the data that says how each recording is to be read, and what it is for.

joints = ["lift", "elbow"]       # of an arm, those that move; see `pendulum_env.arms.read_body`

[columns]                        # of every recording, as in `expression.py`
position = "-motor_angle:deg/6"
torque = "current:A*0.091"

[drive]                          # the controller that followed the goal, see `pendulum_env.servo.drive`
preset = "xl330"

[[recording]]
file = "monday.csv"              # beside the study
role = "fit"                     # or "holdout"
unwrap = true                    # undo jumps of 2 pi in position
range = [2.0, 30.0]              # [s] from the first sample
load = {mass = 0.5, length = 0.2}    # [kg] at [m] from the axis, or inertia [kg m^2] and gravity [N m]
drive = {kp = 400}               # beside what [drive] says of all
columns = {torque = "i_q:A*0.091"}   # instead of those above
"""

import json
import math
import os
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, Protocol, Self, TypeVar, get_args

import numpy as np

from pendulum_env._typing import JSON, Array
from pendulum_env.files import write_whole
from pendulum_env.lookup import find
from pendulum_env.reading import LARGE, LARGEST, Unreadable, read_toml, shown
from pendulum_env.recording.columns import refuse_unknown_quantity
from pendulum_env.recording.record import ColumnError, Load, Recording, RecordingError
from pendulum_env.recording.storage import read_recording
from pendulum_env.servo.drive import Drive

Role = Literal["fit", "holdout"]
MOST = 1000  # recordings
LONGEST = 1000  # characters of what is said of a column
FORMAT = ("columns", "unwrap", "load", "drive")  # of what is said of a recording, that which the next is alike in

GRAVITY = 9.81  # [m/s^2]


class StudyError(RecordingError):
    """A study cannot be used; the message is one sentence with file, recording, reason and remedy."""


class Sliceable(Protocol):
    """A recording of one joint or of several: its time (N,) [s], and parts of it."""

    @property
    def time(self) -> Array:
        """Of the samples (N,) [s]."""
        ...

    def slice(self, start: int | None, stop: int | None) -> Self:
        """Samples start to stop - 1."""
        ...


Sliced = TypeVar("Sliced", bound=Sliceable)


@dataclass(frozen=True)
class Source:
    """A file with a recording: how it is to be read, and what it is for."""

    file: Path
    role: Role = "fit"  # fitted, or held out
    columns: Mapping[str, str] = field(default_factory=dict, hash=False)  # as in `read_recording`
    unwrap: bool = False
    range: tuple[float, float] | None = None  # [s] from the first sample; None: all of it
    load: Load | None = None  # what is known to hang on the joint
    drive: Drive | None = None  # the controller that followed the reference
    largest: float = LARGEST  # bytes that it may take
    joints: tuple[str, ...] | None = None  # of an arm, those that move; None: all that can
    of_study: bool = field(default=False, compare=False)  # which says all of it
    said_by: str = ""  # the model file that says what nobody else did

    def read(self) -> Recording:
        """Read the recording.

        Raises:
            RecordingError: if it cannot be read, holds too little within the range, or is of an arm.
        """
        if self.joints is not None:
            raise RecordingError(f"{self.file}: its study names joints of an arm: give the links with --robot ARM.urdf")
        return replace(self.within_range(_of_one_joint), load=self.load)

    @property
    def format(self) -> JSON:
        """How it is read, in the words of a study, as far as anything is said."""
        load = None if self.load is None else {"inertia": self.load.inertia, "gravity": self.load.gravity}
        drive = None if self.drive is None else self.drive.told()
        said = (dict(self.columns), self.unwrap, load, drive)
        return {key: value for key, value in zip(FORMAT, said, strict=True) if value}

    def within_range(self, read: Callable[..., Sliced], *arguments: Hashable) -> Sliced:
        """The part that is asked for of `read(source, *arguments)`, which has the whole file.

        The file is read once for all of its ranges that follow each other.

        Raises:
            RecordingError: as `read` does, or if the part holds too little.
        """
        if self.range is None:
            return read(self, *arguments)
        changed = self.file.stat().st_mtime_ns if self.file.exists() else 0
        recording = _whole(read, replace(self, role="fit", range=None, load=None), changed, *arguments)
        first, last = np.searchsorted(recording.time - recording.time[0], self.range)
        try:
            part: Sliced = deepcopy(recording.slice(int(first), int(last)))  # the rest of the file is not kept
            return part
        except RecordingError:
            raise RecordingError(
                f"{self.file}: holds no two samples from {self.range[0]:g} to {self.range[1]:g} s: "
                f"it lasts {recording.time[-1] - recording.time[0]:.3g} s"
            ) from None


def _of_one_joint(source: Source) -> Recording:
    try:
        return read_recording(
            source.file, unwrap=source.unwrap, columns=source.columns, drive=source.drive, largest=source.largest
        )
    except ColumnError as error:
        if not source.said_by:
            raise
        said = f"{error}; it was read as {source.said_by} says: say --columns for a log of another format"
        raise ColumnError(said) from None


@lru_cache(maxsize=1)
def _whole(read: Callable[..., Any], source: Source, changed: int, *arguments: Hashable) -> Any:
    """What `read` has of a file that was last changed then."""
    return read(source, *arguments)


def format_of(sources: Iterable[Source]) -> JSON:
    """What is said alike of all sources: how the next log of the same machine is to be read."""
    formats = [source.format for source in sources]
    alike = (key for key in FORMAT if formats and all(other.get(key) == formats[0].get(key) for other in formats))
    return {key: formats[0][key] for key in alike if key in formats[0]}


def read_as(source: Source, format: Mapping[str, Any], said_by: str) -> Source:
    """A source of which a model file says what nobody else did; a study says all of its own.

    Raises:
        StudyError: if that makes no sense.
    """
    unsaid = [key for key in FORMAT if key in format and key not in source.format]
    if source.of_study or not unsaid:
        return source
    try:
        told = _source(Path(), {"file": "log", **{key: format[key] for key in unsaid}}, {}, {})
    except ValueError as error:
        raise StudyError(f"{said_by}, log_format: {error}") from None
    return replace(source, **{key: getattr(told, key) for key in unsaid}, said_by=said_by)


def named_twice(sources: Iterable[Source]) -> Source | None:
    """The first source that holds samples of one before it: none must be fitted twice, nor held out as well."""
    taken: dict[Path, list[tuple[float, float]]] = {}
    for source in sources:
        ranges = taken.setdefault(source.file.resolve(), [])
        first, last = source.range or (0.0, math.inf)
        if any(first < end and begin < last for begin, end in ranges):
            return source
        ranges.append((first, last))
    return None


@dataclass(frozen=True, eq=False)
class Study:
    """Recordings that belong together, each as its source asks for."""

    path: Path
    sources: tuple[Source, ...]
    recordings: tuple[Recording, ...]  # one of each source

    @property
    def fitted(self) -> tuple[Recording, ...]:
        """Recordings to fit."""
        return tuple(r for r, source in zip(self.recordings, self.sources, strict=True) if source.role == "fit")

    @property
    def held_out(self) -> tuple[Recording, ...]:
        """Recordings to confirm on."""
        return tuple(r for r, source in zip(self.recordings, self.sources, strict=True) if source.role == "holdout")


def read_study(path: str | os.PathLike[str]) -> Study:
    """Read a study and its recordings.

    Raises:
        StudyError: if the study makes no sense.
        RecordingError: if a recording cannot be read as it asks for.
    """
    sources = read_sources(path)
    return Study(Path(path), sources, tuple(source.read() for source in sources))


def read_sources(path: str | os.PathLike[str]) -> tuple[Source, ...]:
    """Read which recordings a study holds, and leave them unread.

    Raises:
        StudyError: if the study makes no sense: with the number of the recording.
    """
    path, where = Path(path), ""
    try:
        content = read_toml(path)
        _refuse_unknown(content, "joints", "columns", "drive", "recording")
        joints = _joints(content.get("joints"))
        shared, drive = _columns(content.get("columns", {})), _drive(content.get("drive"), {})
        tables = content.get("recording")
        if not isinstance(tables, list) or not tables:
            raise StudyError('names no recordings: write [[recording]] and below it file = "run.csv"')
        if len(tables) > MOST:
            raise StudyError(f"names {len(tables)} recordings, at most {MOST} are read: divide it")
        sources = []
        for number, table in enumerate(tables, start=1):
            where = f", recording {number}"
            sources.append(replace(_source(path.parent, table, shared, drive), joints=joints, of_study=True))
    except Unreadable as error:
        raise StudyError(str(error)) from None
    except ValueError as error:
        raise StudyError(f"{path}{where}: {error}") from None
    if (twice := named_twice(sources)) is not None:
        raise StudyError(f"{path}: {twice.file.name} is named twice: give ranges that do not overlap")
    return tuple(sources)


def write_study(path: str | os.PathLike[str], sources: Sequence[Source]) -> None:
    """Write a study that reads back as these sources, files relative to it where they lie below.

    Raises:
        OSError: if it cannot be written.
    """
    path = Path(path)
    folder = path.resolve().parent
    shared = dict(sources[0].columns) if sources and all(s.columns == sources[0].columns for s in sources) else {}
    lines = [f"joints = {json.dumps(sources[0].joints)}", ""] if sources and sources[0].joints is not None else []
    lines += ["[columns]", *(f"{name} = {_text(told)}" for name, told in shared.items()), ""] if shared else []
    for source in sources:
        file = source.file.resolve()
        file = file.relative_to(folder) if file.is_relative_to(folder) else file
        lines += ["[[recording]]", f"file = {_text(file.as_posix())}", f"role = {_text(source.role)}"]
        if source.unwrap:
            lines.append("unwrap = true")
        if source.range is not None:
            lines.append(f"range = [{float(source.range[0])!r}, {float(source.range[1])!r}]")
        if source.load is not None:
            lines.append(
                f"load = {{inertia = {float(source.load.inertia)!r}, gravity = {float(source.load.gravity)!r}}}"
            )
        if source.drive is not None:
            drive = ", ".join(
                f"{name} = {_text(value) if isinstance(value, str) else repr(value)}"
                for name, value in source.drive.told().items()
            )
            lines.append(f"drive = {{{drive}}}")
        if source.columns and not shared:
            told = ", ".join(f"{name} = {_text(text)}" for name, text in source.columns.items())
            lines.append(f"columns = {{{told}}}")
        lines.append("")
    write_whole(path, "\n".join(lines))


def _source(folder: Path, table: Any, shared: Mapping[str, str], drive: Mapping[str, Any]) -> Source:
    if not isinstance(table, dict):
        raise StudyError('a recording is a table: write [[recording]] and below it file = "run.csv"')
    _refuse_unknown(table, "file", "role", "columns", "unwrap", "range", "load", "drive")
    file, role, unwrap = table.get("file"), table.get("role", "fit"), table.get("unwrap", False)
    if not isinstance(file, str) or not file.strip():
        raise StudyError('a recording needs its file: write file = "run.csv"')
    if role not in get_args(Role):
        raise StudyError(f'role is {shown(role)}: write "fit" or "holdout"')
    if not isinstance(unwrap, bool):
        raise StudyError(f"unwrap is {shown(unwrap)}: write true or false")
    columns, told = _columns(table.get("columns", {})), _drive(table.get("drive"), drive)
    return Source(
        folder / file, role, {**shared, **columns}, unwrap, _range(table.get("range")), _load(table.get("load")),
        Drive.of(told) if told else None,
    )  # fmt: skip


def _joints(value: Any) -> tuple[str, ...] | None:
    if value is None:
        return None
    if not (isinstance(value, list) and value and all(isinstance(name, str) and name.strip() for name in value)):
        raise StudyError(f'joints is {shown(value)}: write the names of those that move, ["lift", "elbow"]')
    return tuple(value)


def _columns(table: Any) -> dict[str, str]:
    if not isinstance(table, dict):
        raise StudyError(f'columns are a table, not {shown(table)}: write [columns] and below it torque = "tau"')
    for quantity, text in table.items():
        refuse_unknown_quantity(quantity, of_arm=True)
        if not isinstance(text, str) or not text.strip() or len(text) > LONGEST:
            raise StudyError(f"{quantity} is {shown(text)}: write the name of a column in quotes")
    return dict(table)


def _drive(table: Any, shared: Mapping[str, Any]) -> dict[str, Any]:
    """What is said of a drive, beside what is said of all."""
    if table is None:
        return dict(shared)
    if not isinstance(table, dict):
        raise StudyError(f'a drive is a table, not {shown(table)}: write [drive] and below it preset = "xl330"')
    Drive.of({"kp": 1.0, **shared, **table})  # what is wrong is told where it stands
    return {**shared, **table}


def _range(value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    if not (isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)) and 0 <= value[0] < value[1]):
        raise StudyError(f"range is {shown(value)}: write [from, to] in seconds from the first sample")
    return float(value[0]), float(value[1])


def _load(table: Any) -> Load | None:
    if table is None:
        return None
    if not isinstance(table, dict):
        raise StudyError(f"load is {shown(table)}: write {{mass = 0.5, length = 0.2}} in kg and m")
    _refuse_unknown(table, "mass", "length", "inertia", "gravity")
    for name, value in table.items():
        if not _is_number(value) or (name != "gravity" and value < 0):
            low = -LARGE if name == "gravity" else 0.0
            raise StudyError(f"{name} is {shown(value)}: write a number from {low:g} to {LARGE:g}")
    if set(table) == {"mass", "length"}:
        mass, length = float(table["mass"]), float(table["length"])
        return Load(mass * length * length, mass * GRAVITY * length)
    if set(table) == {"inertia", "gravity"}:
        return Load(float(table["inertia"]), float(table["gravity"]))
    raise StudyError("a load is told by mass and length, or by inertia and gravity: give one pair")


def _refuse_unknown(table: Mapping[str, Any], *known: str) -> None:
    for name in table:
        find("key", name, dict.fromkeys(known))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGE


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
