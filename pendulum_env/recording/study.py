"""A study: a file `study.toml` beside the data that says how each recording is to be read, and what it is for.

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
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Protocol, Self, TypeVar, get_args

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.files import write_whole
from pendulum_env.lookup import find
from pendulum_env.reading import LARGE, Unreadable, read_text, read_toml, shown
from pendulum_env.recording.columns import refuse_unknown_quantity
from pendulum_env.recording.record import Load, Recording, RecordingError
from pendulum_env.recording.storage import read_recording
from pendulum_env.recording.table import LARGEST
from pendulum_env.servo.drive import Drive

Role = Literal["fit", "holdout"]
MOST = 1000  # recordings, each of which is compared with each
Key = tuple[str | int, ...]  # where something stands: `("recording", 0, "load", "mass")`

GRAVITY = 9.81  # [m/s^2]
KEYS = {
    (): ("columns", "drive", "recording"),
    ("recording",): ("file", "role", "columns", "unwrap", "range", "load", "drive"),
    ("load",): ("mass", "length", "inertia", "gravity"),
}


class StudyError(RecordingError):
    """A study cannot be used; the message is one sentence with the file, the line, the reason and the remedy."""


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
    columns: Mapping[str, str] = field(default_factory=dict)  # as in `read_recording`
    unwrap: bool = False
    range: tuple[float, float] | None = None  # [s] from the first sample; None: all of it
    load: Load | None = None  # what is known to hang on the joint
    drive: Drive | None = None  # the controller that followed the reference
    largest: float = LARGEST  # bytes that it may take

    def read(self, file: Path | None = None) -> Recording:
        """Read the recording, from a copy of the file if one is named.

        Raises:
            RecordingError: if it cannot be read, or holds too little within the range.
        """
        recording = read_recording(
            file or self.file, unwrap=self.unwrap, columns=self.columns, drive=self.drive, largest=self.largest
        )
        return self.within_range(replace(recording, load=self.load))

    def within_range(self, recording: Sliced) -> Sliced:
        """The part of a recording that is asked for.

        Raises:
            RecordingError: if it holds too little.
        """
        if self.range is None:
            return recording
        first, last = np.searchsorted(recording.time - recording.time[0], self.range)
        try:
            return recording.slice(int(first), int(last))
        except RecordingError:
            raise RecordingError(
                f"{self.file}: holds no two samples from {self.range[0]:g} to {self.range[1]:g} s: "
                f"it lasts {recording.time[-1] - recording.time[0]:.3g} s"
            ) from None

    def overlaps(self, other: "Source") -> bool:
        """Whether both hold the same samples, which must not be fitted twice, nor held out as well."""
        (a, b), (c, d) = (source.range or (0.0, math.inf) for source in (self, other))
        return self.file.resolve() == other.file.resolve() and a < d and c < b


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
        StudyError: if the study makes no sense: with the line of what is wrong.
    """
    path = Path(path)
    try:
        text = read_text(path)
        content = read_toml(path)
    except Unreadable as error:
        raise StudyError(str(error)) from None
    return _Reader(path, lines_of(text)).sources(content)


def write_study(path: str | os.PathLike[str], sources: Sequence[Source]) -> None:
    """Write a study that reads back as these sources, files relative to it where they lie below.

    Raises:
        OSError: if it cannot be written.
    """
    path = Path(path)
    folder = path.resolve().parent
    shared = dict(sources[0].columns) if sources and all(s.columns == sources[0].columns for s in sources) else {}
    lines = ["[columns]", *(f"{name} = {_text(told)}" for name, told in shared.items()), ""] if shared else []
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


def lines_of(text: str) -> dict[Key, int]:
    """Line, from 1, of each key and table of a TOML document, by where it stands; those in a table's line share it."""
    table: Key = ()
    counts: dict[str, int] = {}
    lines: dict[Key, int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if found := re.match(r"\s*\[\[\s*([\w-]+)\s*\]\]", line):
            counts[found[1]] = counts.get(found[1], -1) + 1
            table = (found[1], counts[found[1]])
        elif found := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line):
            table = tuple(
                part for name in found[1].split(".") for part in ((name, counts[name]) if name in counts else (name,))
            )
        elif found := re.match(r"""\s*(["']?)([^"'=#]+?)\1\s*=""", line):
            lines.setdefault((*table, *(part.strip() for part in found[2].split("."))), number)
            continue
        else:
            continue
        lines.setdefault(table, number)
    return lines


@dataclass(frozen=True)
class _Reader:
    """Takes a study apart, and knows where everything stands."""

    path: Path
    lines: Mapping[Key, int]

    def error(self, where: Key, what: str) -> StudyError:
        """What is wrong, with the line of it, or of the nearest around it that is known."""
        for end in range(len(where), 0, -1):
            if near := [line for key, line in self.lines.items() if key[:end] == where[:end]]:
                return StudyError(f"{self.path}, line {min(near)}: {what}")
        return StudyError(f"{self.path}: {what}")

    def sources(self, content: Mapping[str, Any]) -> tuple[Source, ...]:
        self.refuse_unknown((), content, KEYS[()])
        columns = self.columns(("columns",), content.get("columns", {}))
        recordings = content.get("recording")
        if not isinstance(recordings, list) or not recordings:
            raise self.error(("recording",), 'names no recordings: write [[recording]] and below it file = "run.csv"')
        if len(recordings) > MOST:
            raise self.error(("recording",), f"names {len(recordings)} recordings, at most {MOST} are read: divide it")
        drive = self.drive(("drive",), content.get("drive"), {})
        sources = tuple(self.source(("recording", k), table, columns, drive) for k, table in enumerate(recordings))
        for k, source in enumerate(sources):
            if any(source.overlaps(other) for other in sources[:k]):
                what = f"{source.file.name} is named twice: give ranges that do not overlap"
                raise self.error(("recording", k, "file"), what)
        return sources

    def source(self, where: Key, table: Any, shared: Mapping[str, str], drive: Mapping[str, Any]) -> Source:
        if not isinstance(table, dict):
            raise self.error(where, 'a recording is a table: write [[recording]] and below it file = "run.csv"')
        self.refuse_unknown(where, table, KEYS["recording",])
        file = table.get("file")
        if not isinstance(file, str) or not file.strip() or "\0" in file:
            raise self.error((*where, "file"), 'a recording needs its file: write file = "run.csv"')
        role = table.get("role", "fit")
        if role not in get_args(Role):
            raise self.error((*where, "role"), f'role is {shown(role)}: write "fit" or "holdout"')
        unwrap = table.get("unwrap", False)
        if not isinstance(unwrap, bool):
            raise self.error((*where, "unwrap"), f"unwrap is {shown(unwrap)}: write true or false")
        own = self.columns((*where, "columns"), table.get("columns", {}))
        return Source(
            self.path.parent / file,
            role,
            {**shared, **own},
            unwrap,
            self.range((*where, "range"), table.get("range")),
            self.load((*where, "load"), table.get("load")),
            self.made((*where, "drive"), self.drive((*where, "drive"), table.get("drive"), drive)),
        )

    def drive(self, where: Key, table: Any, shared: Mapping[str, Any]) -> dict[str, Any]:
        """What is said of a drive, beside what is said of all."""
        if table is None:
            return dict(shared)
        if not isinstance(table, dict):
            raise self.error(
                where, f'a drive is a table, not {shown(table)}: write [drive] and below it preset = "xl330"'
            )
        self.made(where, {"kp": 1.0, **shared, **table})
        return {**shared, **table}

    def made(self, where: Key, told: Mapping[str, Any]) -> Drive | None:
        """The drive that is meant; None if nothing is said of any."""
        try:
            return Drive.of(told) if told else None
        except ValueError as error:
            raise self.error(where, str(error)) from None

    def columns(self, where: Key, table: Any) -> dict[str, str]:
        if not isinstance(table, dict):
            raise self.error(
                where, f'columns are a table, not {shown(table)}: write [columns] and below it torque = "tau"'
            )
        for quantity, text in table.items():
            try:
                refuse_unknown_quantity(quantity, of_arm=True)
            except RecordingError as error:
                raise self.error((*where, quantity), str(error)) from None
            if not isinstance(text, str) or not text.strip():
                raise self.error(
                    (*where, quantity), f"{quantity} is {shown(text)}: write the name of a column in quotes"
                )
        return dict(table)

    def range(self, where: Key, value: Any) -> tuple[float, float] | None:
        if value is None:
            return None
        if not (
            isinstance(value, list)
            and len(value) == 2
            and all(_is_number(x) for x in value)
            and 0 <= value[0] < value[1]
        ):
            raise self.error(where, f"range is {shown(value)}: write [from, to] in seconds from the first sample")
        return float(value[0]), float(value[1])

    def load(self, where: Key, table: Any) -> Load | None:
        if table is None:
            return None
        if not isinstance(table, dict):
            raise self.error(where, f"load is {shown(table)}: write {{mass = 0.5, length = 0.2}} in kg and m")
        self.refuse_unknown(where, table, KEYS["load",])
        for name, value in table.items():
            if not _is_number(value) or (name != "gravity" and value < 0):
                low = -LARGE if name == "gravity" else 0.0
                what = f"{name} is {shown(value)}: write a number from {low:g} to {LARGE:g}"
                raise self.error((*where, name), what)
        try:
            if set(table) == {"mass", "length"}:
                mass, length = float(table["mass"]), float(table["length"])
                return Load(mass * length * length, mass * GRAVITY * length)
            if set(table) == {"inertia", "gravity"}:
                return Load(float(table["inertia"]), float(table["gravity"]))
        except RecordingError as error:
            raise self.error(where, str(error)) from None
        raise self.error(where, "a load is told by mass and length, or by inertia and gravity: give one pair")

    def refuse_unknown(self, where: Key, table: Mapping[str, Any], known: Collection[str]) -> None:
        for name in table:
            try:
                find("key", name, dict.fromkeys(known))
            except ValueError as error:
                raise self.error((*where, name), str(error)) from None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGE


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
