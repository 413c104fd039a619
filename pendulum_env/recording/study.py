"""Read and write studies: files `study.toml` with the reading options and the role of each recording.

joints = ["lift", "elbow"]       # moving joints with links; see `robots.arms.read_body`

[columns]                        # columns of all recordings, as in `expression.py`
position = "-motor_angle:deg/6"
torque = "current:A*0.091"

[drive]                          # controller that follows the reference, of an installed package
preset = "xl330"

[drive.elbow]                    # of one joint of an arm, in addition
kp = 800

[[recording]]
file = "monday.csv"              # relative to the study
role = "fit"                     # or "holdout"
unwrap = true                    # undo jumps of a turn in position
range = [2.0, 30.0]              # [s] from the first sample
load = {mass = 0.5, length = 0.2}    # [kg] at [m] from the axis, or inertia [kg m^2] and gravity [N m]; a measured
                                     # load torque is a column, `load_torque`
drive = {kp = 400}               # in addition to [drive]
columns = {torque = "i_q:A*0.091"}   # in place of the common column
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from msgspec import Meta, Struct

from pendulum_env._typing import JSON
from pendulum_env.errors import ColumnError, FileError, RecordingError
from pendulum_env.files import write_whole
from pendulum_env.reading import NonNegative, Number, Text, convert, format_toml, read_toml
from pendulum_env.recording.actuator import Actuator, list_conventions, parse_actuator
from pendulum_env.recording.channel import Load
from pendulum_env.recording.columns import refuse_unknown_quantity, strip_joint
from pendulum_env.recording.lerobot import list_recordings
from pendulum_env.recording.notes import warn_of_notes
from pendulum_env.recording.record import Recording
from pendulum_env.recording.storage import describe_reading, read_rows
from pendulum_env.settings import format_setting

Role = Literal["fit", "holdout"]
READING = ("columns", "unwrap", "drive")  # arguments of `read_recording`
FORMAT = ("columns", "unwrap", "load", "drive")  # options that the next log of the same machine shares

GRAVITY = 9.81  # [m/s^2]


class StudyError(RecordingError):
    """Invalid study; the message has file, recording, reason and remedy."""


class _Load(Struct, forbid_unknown_fields=True):
    """Load in a study, by mass and length or by inertia and gravity."""

    mass: NonNegative | None = None  # [kg]
    length: NonNegative | None = None  # [m]
    inertia: NonNegative | None = None  # [kg m^2]
    gravity: Number | None = None  # [N m]

    @property
    def known(self) -> Load:
        """Return the load on the joint."""
        match self:
            case _Load(float(mass), float(length), None, None):
                return Load(mass * length**2, mass * GRAVITY * length)
            case _Load(None, None, float(inertia), float(gravity)):
                return Load(inertia, gravity)
        raise RecordingError("load needs mass and length, or inertia and gravity")


class _Recording(Struct, forbid_unknown_fields=True):
    """Recording in a study."""

    file: Text
    role: Role = "fit"
    columns: dict[str, Any] = {}
    unwrap: bool = False
    range: tuple[NonNegative, NonNegative] | None = None
    load: _Load | None = None
    drive: dict[str, Any] = {}


class _Study(Struct, forbid_unknown_fields=True):
    """Content of a study."""

    joints: Annotated[tuple[Text, ...], Meta(min_length=1)] | None = None
    columns: dict[str, Any] = {}
    drive: dict[str, Any] = {}
    recording: list[_Recording] = []


Sliced = TypeVar("Sliced", bound=Recording)  # recording of one or several joints


@dataclass(frozen=True)
class Source:
    """File of a recording with its reading options and role."""

    file: Path
    role: Role = "fit"  # fitted or held out
    columns: Mapping[str, str] = field(default_factory=dict, hash=False)  # as in `read_recording`
    unwrap: bool = False
    range: tuple[float, float] | None = None  # [s] from the first sample; None: all of it
    load: Load | None = None  # known load on the joint
    drive: Actuator | None = None  # controller that follows the reference
    joints: tuple[str, ...] | None = None  # moving joints with links; None: all movable joints
    has_gravity: bool = field(default=True, compare=False)  # as in `read_recording`
    is_of_study: bool = field(default=False, compare=False)  # whether a study has all options
    format_source: str = ""  # model file that supplied missing options

    def read(self) -> Recording:
        """Read the recording; its `notes` list rows that are left out and uncertain units, without a warning."""
        if self.joints is not None:
            raise RecordingError(
                f"{self.file}: its study names joints of an arm: give its links, {format_setting('robot', 'ARM.urdf')}"
            )
        return replace(self.select_range(_read_pendulum(self)), load=self.load)

    def expand(self) -> tuple["Source", ...]:
        """Return a source for each episode of a dataset, and the source itself for another file."""
        return tuple(replace(self, file=Path(file)) for file in list_recordings(self.file))

    @property
    def reading_options(self) -> dict[str, Any]:
        """Return the arguments of `read_recording`."""
        return {name: getattr(self, name) for name in READING}

    @property
    def format(self) -> JSON:
        """Return the given reading options as keys of a study."""
        load = None if self.load is None else asdict(self.load)
        options = {**describe_reading(**self.reading_options), "load": load}
        return {key: options[key] for key in FORMAT if options.get(key)}

    def select_range(self, recording: Sliced) -> Sliced:
        """Return the samples of the source's range from the recording of the whole file."""
        if self.range is None:
            return recording
        first, end = np.searchsorted(recording.time - recording.time[0], self.range)
        try:
            return recording.slice(int(first), int(end))
        except RecordingError:
            raise RecordingError(
                f"{self.file}: holds no two samples from {self.range[0]:g} to {self.range[1]:g} s: "
                f"it lasts {recording.time[-1] - recording.time[0]:.3g} s"
            ) from None


def _read_pendulum(source: Source) -> Recording:
    try:
        return read_rows(source.file, has_gravity=source.has_gravity, **source.reading_options)
    except ColumnError as error:
        if not source.format_source:
            raise
        raise ColumnError(
            f"{error}; it was read as {source.format_source} says: name the columns of a log of another format, "
            f"{format_setting('columns', {'QUANTITY': 'NAME'})}"
        ) from None


def collect_log_format(recordings: Sequence[Recording]) -> JSON:
    """Return the common reading options of all recordings, for the next log of the same machine.

    The result also has the `conventions` of the controller that were given or decided.
    """
    loads = ({} if recording.load is None else {"load": asdict(recording.load)} for recording in recordings)
    formats: list[JSON] = [{**recording.log_format, **load} for recording, load in zip(recordings, loads, strict=True)]
    shared_keys = (key for key in FORMAT if formats and all(other.get(key) == formats[0].get(key) for other in formats))
    conventions = [recording.actuator.conventions for recording in recordings if recording.actuator.conventions]
    first = conventions[0] if conventions else {}
    decided = {name: value for name, value in first.items() if value and all(c.get(name) == value for c in conventions)}
    return {key: formats[0][key] for key in shared_keys if key in formats[0]} | decided


def parse_log_format(log_format: Mapping[str, Any]) -> Source:
    """Parse the log format of a model to a source without a file; raise a ValueError if it is invalid."""
    conventions = {*log_format} - {*FORMAT} and list_conventions()
    options = {key: value for key, value in log_format.items() if key not in conventions}
    return _build_source(Path(), convert({"file": "log", **options}, _Recording), _Study())


def apply_log_format(source: Source, format: Mapping[str, Any], format_source: str) -> Source:
    """Return a source with options of a model file's log format for those that user and study did not give."""
    missing_keys = [key for key in FORMAT if key in format and key not in source.format]
    if source.is_of_study or not missing_keys:
        return source
    try:
        defaults = parse_log_format({key: format[key] for key in missing_keys})
    except ValueError as error:
        raise StudyError(f"{format_source}, log_format: {error}") from None
    return replace(source, **{key: getattr(defaults, key) for key in missing_keys}, format_source=format_source)


def find_duplicate(sources: Iterable[Source]) -> Source | None:
    """Return the first source that overlaps an earlier one, or None."""
    ranges_by_file: dict[Path, list[tuple[float, float]]] = {}
    for source in sources:
        ranges = ranges_by_file.setdefault(source.file.resolve(), [])
        first, stop = source.range or (0.0, np.inf)
        if any(first < end and begin < stop for begin, end in ranges):
            return source
        ranges.append((first, stop))
    return None


@dataclass(frozen=True, eq=False)
class Study:
    """Recordings of a study, with their sources."""

    path: Path
    sources: tuple[Source, ...]
    recordings: tuple[Recording, ...]  # one per source

    @property
    def fitted(self) -> tuple[Recording, ...]:
        """Return the recordings to fit."""
        return tuple(r for r, source in zip(self.recordings, self.sources, strict=True) if source.role == "fit")

    @property
    def held_out(self) -> tuple[Recording, ...]:
        """Return the recordings that are held out."""
        return tuple(r for r, source in zip(self.recordings, self.sources, strict=True) if source.role == "holdout")


def read_study(path: str | os.PathLike[str]) -> Study:
    """Read a study and its recordings, with warnings as `read_recording`.

    Raises:
        StudyError: if the study is invalid.
        RecordingError: if a recording cannot be read.
    """
    sources = read_sources(path)
    study = Study(Path(path), sources, tuple(source.read() for source in sources))
    for source, recording in zip(sources, study.recordings, strict=True):
        warn_of_notes(str(source.file), recording.notes)
    return study


def read_sources(path: str | os.PathLike[str]) -> tuple[Source, ...]:
    """Read the sources of a study without reading the recordings."""
    path, location, sources = Path(path), "", list[Source]()
    try:
        content = read_toml(path)
    except FileError as error:
        raise StudyError(str(error)) from None
    try:
        if isinstance(content.get("recording"), dict):  # [recording] instead of [[recording]]
            content["recording"] = [content["recording"]]
        study = convert(content, _Study)
        if not study.recording:
            raise StudyError('names no recordings: write [[recording]] and below it file = "run.csv"')
        study.columns = _check_columns(study.columns)
        for k, data in enumerate(study.recording):
            location = f"'recording[{k}]': "
            source = _build_source(path.parent, data, study)
            sources += replace(source, joints=study.joints, is_of_study=True).expand()
    except ValueError as error:
        raise StudyError(f"{path}: {location}{error}") from None
    if (duplicate := find_duplicate(sources)) is not None:
        raise StudyError(f"{path}: {duplicate.file.name} is named twice: give ranges that do not overlap")
    return tuple(sources)


def write_study(sources: Sequence[Source], path: str | os.PathLike[str]) -> None:
    """Write a study of sources; paths below its folder are relative.

    Raises:
        OSError: if the file cannot be written.
    """
    path = Path(path)
    folder = path.resolve().parent
    shared = dict(sources[0].columns) if sources and all(s.columns == sources[0].columns for s in sources) else {}
    joints = sources[0].joints if sources else None
    lines = format_toml({} if joints is None else {"joints": joints})
    lines += ["", "[columns]", *format_toml(shared)] if shared else []
    for source in sources:
        file = source.file.resolve()
        file = file.relative_to(folder) if file.is_relative_to(folder) else file
        options: JSON = {"file": file.as_posix(), "role": source.role}
        options |= {} if source.range is None else {"range": source.range}
        options |= {key: value for key, value in source.format.items() if not (shared and key == "columns")}
        lines += ["", "[[recording]]", *format_toml(options)]
    write_whole(path, "\n".join([*lines, ""]))


def _build_source(folder: Path, data: _Recording, study: _Study) -> Source:
    if data.range is not None and data.range[0] >= data.range[1]:
        raise StudyError(f"range is {list(data.range)}: expected [from, to] in seconds from the first sample")
    settings = _merge(study.drive, data.drive)
    return Source(
        folder / data.file, data.role, {**study.columns, **_check_columns(data.columns)}, data.unwrap, data.range,
        None if data.load is None else data.load.known, parse_actuator(settings),
    )  # fmt: skip


def _merge(common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Merge settings and their tables; `own` ones take precedence."""
    nested = {name: _merge(common.get(name, {}), value) for name, value in own.items() if isinstance(value, Mapping)}
    return {**common, **own, **nested}


def _check_columns(table: Mapping[str, Any]) -> dict[str, str]:
    for quantity in table:
        refuse_unknown_quantity(strip_joint(quantity))
    return {quantity: convert(text, Text, f"columns.{quantity}") for quantity, text in table.items()}
