"""Read episodes of LeRobot datasets, versions 2 and 3: folders with `meta/info.json` and Parquet files below `data`.

An episode is a recording, `FOLDER#12`, with columns `time`, `position_JOINT` of `observation.state`, `goal_JOINT` of
`action`, and other observations by joint. Angles are converted to radians. LeRobot writes degrees or percent of the
range of a joint, from -100 to 100, of a gripper from 0 to 100. The files do not say which. Degrees change by counts of
an encoder of `COUNTS` counts; percent change by a share of the range. Percent need the ranges, from a copy of the arm's
calibration file, `calibration.json` in the folder or in `meta`. Its homing offsets are those of the counts already.
"""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.errors import ColumnError, FileError, RecordingError
from pendulum_env.reading import check_size, convert, read_json
from pendulum_env.recording.arrays import build_table
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.rounding import find_least_change
from pendulum_env.recording.table import ColumnFinder, RawTable, convert_series
from pendulum_env.recording.vocabulary import PERCENT_OF_RANGE, UNKNOWN_UNIT
from pendulum_env.settings import Blank, format_setting

INFO, CALIBRATION = Path("meta", "info.json"), "calibration.json"
COUNTS = 4096  # counts of a turn of the encoders of SO-100, SO-101 and Koch
COUNT_TOLERANCE = 0.002  # largest relative difference of a step from counts; LeRobot divides 360 degrees by 4095
MOST_COUNTS = 3  # of the least step of a moving joint
LARGEST_PERCENT, LARGEST_RADIANS = 100.5, 7.0  # magnitudes above which values have another unit
STAMP_ERROR = 1e-3  # [s], largest rounding error of stamps in single precision
OF_STATE = {"pos": "position", "vel": "velocity"}  # quantities by the ending of a name, `elbow_flex.pos`
CONVERTED = ("position", "velocity", "goal")
UNITS = ("degrees", "radians", "percent", "percent without range", "unknown")
N_CACHED = 16  # datasets whose files and units are kept until they change
MOST_FILES = 5  # files whose positions decide the units, so that all episodes have the same
_Stamps = tuple[tuple[Path, int, int], ...]  # path, modification time [ns], size


class _Feature(Struct):
    """Feature of a dataset in `meta/info.json`."""

    dtype: str
    names: Any = None


class _Info(Struct):
    """Content of `meta/info.json`."""

    fps: float
    features: dict[str, _Feature]
    data_path: str = ""


class _Range(Struct):
    """Calibration of a joint: the counts of its ends, and whether its direction is inverted."""

    range_min: float
    range_max: float
    drive_mode: int = 0


@dataclass(frozen=True)
class JointUnit:
    """Conversion of the values of a joint to radians; without a range, percent have no gain."""

    unit: str  # of `UNITS`
    gain: float | None
    offset: float = 0.0


def find_dataset(path: str | os.PathLike[str]) -> tuple[Path, str] | None:
    """Split a path into the folder of a dataset and episodes, as 12 of `FOLDER#12`; None for other paths."""
    text = os.fspath(path)
    for folder, episodes in ((text, ""), text.rpartition("#")[::2]):
        if folder and os.path.isfile(Path(folder) / INFO):
            return Path(folder), episodes
    return None


def list_recordings(path: str | os.PathLike[str]) -> tuple[str | os.PathLike[str], ...]:
    """List the episodes of a dataset as paths, all of `FOLDER`, or some of `FOLDER#0-9`; other paths stay as they are.

    Raises FileError if there is no such episode.
    """
    if (dataset := find_dataset(path)) is None:
        return (path,)
    folder, text = dataset
    try:
        files = _find_files(folder)
    except (OSError, KeyError, ValueError) as error:
        raise FileError(f"{path}: not a readable dataset of LeRobot ({error}): download it again") from None
    span = re.fullmatch(r"(\d+)(?:-(\d+))?", text)
    ends = (int(span[1]), int(span[2] or span[1])) if span else (0, max(files, default=0))
    chosen = [k for k in sorted(files) if ends[0] <= k <= ends[1]]
    if not chosen or (text and not span):
        known = f"it has {min(files)} to {max(files)}" if files else "download its folder data"
        raise FileError(f"{path}: the dataset has no such episode: {known}")
    return tuple(Path(f"{folder}#{k}") for k in chosen)


def read_episode(path: Path, find: ColumnFinder) -> RawTable:
    """Read the needed columns of an episode; of percent without a range, the columns have no quantity."""
    folder = (find_dataset(path) or (path, ""))[0]
    if len(paths := list_recordings(path)) > 1:
        raise FileError(f"is a dataset of {len(paths)} episodes: name one, as {os.path.basename(paths[0])}")
    episode = int(str(paths[0]).rpartition("#")[2])
    info, files = _read_info(folder), _find_files(folder)
    series = _read_series(files[episode], info, episode)
    vectors = {name: values for name, values in series.items() if values.ndim == 2}
    if "observation.state" not in vectors:
        raise RecordingError("the dataset has no positions, `observation.state`: name another one")
    names = tuple(_list_names(info, "observation.state", vectors))
    units = _read_units(folder, names, _stamp(_choose_files(files.values())), _stamp(_list_calibrations(folder)))
    columns = {"time": _find_time(series, info.fps)}
    for feature, values in vectors.items():
        for name, cells in zip(_list_names(info, feature, vectors), values.T, strict=True):
            joint, ending = _split_name(name)
            kind = _name_quantity(feature, ending)
            header, unit = f"{kind}_{joint}", units.get(joint) if kind in CONVERTED else None
            if unit is not None and unit.gain is None:
                header += UNKNOWN_UNIT if unit.unit == "unknown" else PERCENT_OF_RANGE
            elif unit is not None and unit.gain is not None:
                cells = unit.gain * cells + (unit.offset if kind != "velocity" else 0.0)
            columns[header] = cells
    try:
        table = build_table(columns, find)
    except ColumnError as error:
        if not str(error).startswith("no column for"):
            raise
        if unknown := [joint for joint, unit in units.items() if unit.unit == "unknown"]:
            column = f"position_{unknown[0]}"
            options = [format_setting("columns", {column: f"{column}:{unit}"}) for unit in ("rad", "deg")]
            raise ColumnError(
                f"units of {', '.join(unknown)} are unknown, since most joints stay below 2 pi and others exceed it: "
                f"name each one, as in {options[0]} or {options[1]}"
            ) from None
        if any(unit.gain is not None for unit in units.values()):
            raise
        column = f"position_{next(iter(units))}"
        option = format_setting("columns", {column: f"{column}:deg*0.9"})
        raise ColumnError(
            f"positions are in percent of the range of each joint: copy the arm's calibration file of LeRobot to "
            f"{Blank(folder / CALIBRATION)}, or give half of its range in degrees over 100, as in {option}"
        ) from None
    by_unit = ((unit, tuple(joint for joint in units if units[joint].unit == unit)) for unit in UNITS)
    notes = (Note(NoteKind.DATASET_UNIT, headers=joints, text=unit) for unit, joints in by_unit if joints)
    return replace(table, notes=(*table.notes, *notes))


def find_units(positions: Mapping[str, Array], calibration: Mapping[str, _Range]) -> dict[str, JointUnit]:
    """Find the unit of each joint from its positions (N,), by joint.

    The joints other than grippers decide. Values up to 2 pi are radians. A dataset has degrees if values exceed 100, or
    most moving joints change by counts of an encoder. Otherwise, if most joints stay below 2 pi, the units are unknown.
    A gripper from 0 to 100 has percent also beside radians or degrees; one beyond that has degrees, or an unknown unit.

    Raises RecordingError if there are no joints.
    """
    if not positions:
        raise RecordingError("the dataset has no positions of joints, `observation.state`: name another one")
    finite = {joint: x[np.isfinite(x)] for joint, x in positions.items()}
    arm = [joint for joint in positions if "gripper" not in joint.lower()] or list(positions)
    largest = {joint: float(np.abs(x).max(initial=0.0)) for joint, x in finite.items()}
    steps = {joint: find_least_change(finite[joint]) * COUNTS / 360.0 for joint in arm}
    moving = [joint for joint in arm if steps[joint] > 0]
    has_counts = 2 * sum(_are_counts(steps[joint]) for joint in moving) > len(moving)
    known = [joint for joint in arm if len(finite[joint])] or arm
    n_small = sum(largest[joint] <= LARGEST_RADIANS for joint in known)
    if n_small == len(known):
        unit = "radians"
    elif has_counts:
        unit = "degrees"
    elif 2 * n_small > len(known):
        unit = "unknown"
    else:
        unit = "degrees" if max(largest[joint] for joint in arm) > LARGEST_PERCENT else "percent"
    units = dict[str, JointUnit]()
    for joint, x in finite.items():
        is_gripper = "gripper" in joint.lower() and x.min(initial=0.0) >= 0.0 and largest[joint] <= LARGEST_PERCENT
        own = unit
        if is_gripper and (unit == "degrees" or largest[joint] > LARGEST_RADIANS):
            own = "percent"
        elif joint not in arm and unit != "degrees" and largest[joint] > LARGEST_RADIANS:
            own = "unknown"
        units[joint] = _convert(own, calibration.get(joint), is_gripper)
    return units


def _convert(unit: str, ends: _Range | None, is_gripper: bool) -> JointUnit:
    """Return the conversion of a unit to radians; of percent, from the ends of the range [counts]."""
    if unit != "percent":
        return JointUnit(unit, {"radians": 1.0, "degrees": np.pi / 180.0}.get(unit))
    if ends is None:
        return JointUnit("percent without range", None)
    turn = (ends.range_max - ends.range_min) / COUNTS * 2.0 * np.pi  # [rad]
    gain = turn / (100.0 if is_gripper else 200.0) * (-1.0 if ends.drive_mode else 1.0)
    return JointUnit("percent", gain, turn if is_gripper and gain < 0 else 0.0)


def _are_counts(step: float) -> bool:
    """Return whether the least step of a joint [counts] is a small whole number of counts."""
    count = round(step)
    return 1 <= count <= MOST_COUNTS and abs(step - count) <= COUNT_TOLERANCE * count


def _read_info(folder: Path) -> _Info:
    return convert(read_json(folder / INFO, "download the dataset again"), _Info)


def _read_calibration(folder: Path) -> dict[str, _Range]:
    """Read the calibration of the joints, empty without a file."""
    file = next((file for file in _list_calibrations(folder) if file.is_file()), None)
    return {} if file is None else convert(read_json(file, "copy it again"), dict[str, _Range], CALIBRATION)


def _list_calibrations(folder: Path) -> tuple[Path, ...]:
    """List the places of the calibration file."""
    return (folder / CALIBRATION, folder / "meta" / CALIBRATION)


def _stamp(paths: Iterable[Path]) -> _Stamps:
    """Return the paths that are there, with their modification time [ns] and size."""
    stats = ((path, path.stat()) for path in paths if path.exists())
    return tuple((path, stat.st_mtime_ns, stat.st_size) for path, stat in stats)


def _find_files(folder: Path) -> Mapping[int, Path]:
    """Find the data file of each episode that is there: by its name, or by `meta/episodes` of version 3."""
    return _list_files(folder, _stamp([*(folder / "data").glob("**/"), *(folder / "meta").rglob("*")]))


@lru_cache(maxsize=N_CACHED)
def _list_files(folder: Path, stamps: _Stamps) -> Mapping[int, Path]:
    """List the data file of each episode; the stamps are those of the folders and files that tell them."""
    files = sorted((folder / "data").rglob("*.parquet"))
    numbers = {file: match for file in files if (match := re.fullmatch(r"episode_(\d+)", file.stem))}
    if numbers:
        return {int(match[1]): file for file, match in numbers.items()}
    template, found = _read_info(folder).data_path, dict[int, Path]()
    keys = ("episode_index", "data/chunk_index", "data/file_index")
    for file in sorted((folder / "meta" / "episodes").rglob("*.parquet")):
        for episode, chunk, number in zip(*_read_columns(file, keys).values(), strict=True):
            data = folder / template.format(chunk_index=int(chunk), file_index=int(number))
            found |= {int(episode): data} if data in files else {}
    return found


def _read_series(file: Path, info: _Info, episode: int) -> dict[str, NDArray[Any]]:
    """Read the rows of an episode, by feature."""
    others = ("timestamp", "frame_index", "episode_index")
    names = [name for name in info.features if name.startswith("observation.") or name in ("action", *others)]
    series = _read_columns(file, [name for name in names if info.features[name].dtype not in ("image", "video")])
    rows = series.get("episode_index", np.full(1, episode)) == episode
    return {name: values if len(rows) == 1 else values[rows] for name, values in series.items()}


def _choose_files(files: Iterable[Path]) -> list[Path]:
    """Choose up to `MOST_FILES` of the files, spread over the dataset."""
    unique = sorted(set(files))
    chosen = np.unique(np.linspace(0, len(unique) - 1, MOST_FILES).round().astype(int))
    return [unique[k] for k in chosen]


@lru_cache(maxsize=N_CACHED)
def _read_units(folder: Path, names: tuple[str, ...], files: _Stamps, calibrations: _Stamps) -> dict[str, JointUnit]:
    """Find the unit of each joint from its positions in some files; the stamps tell whether a file has changed."""
    states = np.concatenate([_read_columns(file, ["observation.state"])["observation.state"] for file, *_ in files])
    joints = zip(map(_split_name, names), states.T, strict=True)
    return find_units({joint: x for (joint, kind), x in joints if kind == "pos"}, _read_calibration(folder))


def _read_columns(file: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Read columns of numbers of a Parquet file that are there."""
    import pyarrow.parquet as pq  # slow import

    check_size(file)
    with pq.ParquetFile(file, pre_buffer=False) as parquet:
        known = [name for name in names if name in parquet.schema_arrow.names]
        table = parquet.read(columns=known, use_threads=False)
    if not table.num_rows:
        raise RecordingError(f"{file.name} of the dataset has no rows: download it again")
    series = {name: convert_series(table[name]) for name in known}
    return {name: values for name, values in series.items() if values.dtype.kind == "f"}


def _list_names(info: _Info, feature: str, vectors: Mapping[str, Array]) -> list[str]:
    """List the names of the elements of a vector: its own, those of the state, or numbers."""
    for given in (info.features[feature].names, info.features["observation.state"].names):
        names = given
        if isinstance(names, dict):  # {"motors": [...]}, or the place of each name
            names = next((value for value in names.values() if isinstance(value, list)), list(names))
        if isinstance(names, list) and len(names) == vectors[feature].shape[1]:
            return [str(name) for name in names]
    return [str(k) for k in range(vectors[feature].shape[1])]


def _split_name(name: str) -> tuple[str, str]:
    """Split the name of an element into the joint and the ending, `pos` without one."""
    joint, dot, ending = name.rpartition(".")
    return (joint, ending) if dot else (name, "pos")


def _name_quantity(feature: str, ending: str) -> str:
    """Name the quantity of an element, for the header of its column."""
    if feature == "action":
        return "goal" if ending == "pos" else f"goal_{ending}"
    return OF_STATE.get(ending, ending) if feature == "observation.state" else feature.removeprefix("observation.")


def _find_time(series: Mapping[str, Array], fps: float) -> Array:
    """Return the time of each row [s]: of its frame, unless the stamps differ from it by more than their rounding."""
    frames = series.get("frame_index", np.arange(float(len(series["observation.state"])))) / fps
    stamps = series.get("timestamp", frames)
    is_nominal = np.allclose(stamps - stamps[0], frames - frames[0], rtol=0.0, atol=STAMP_ERROR)
    return np.asarray(frames if is_nominal else stamps)
