"""Files that hold arrays by name: NPZ, MATLAB and HDF5, with columns of a matrix as columns of their own: `x[0]`."""

import math
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.record import RecordingError
from pendulum_env.recording.table import Find, Table, need

WIDEST = 64  # columns of a matrix


@dataclass(frozen=True)
class Stored:
    """An array in a file, not read yet."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    load: Callable[[], NDArray[Any]]


def read_npz(path: Path, find: Find = find_columns) -> Table:
    """The arrays in need, never unpickled.

    Raises:
        RecordingError: if an array is missing, does not hold real numbers, is no vector, or if the lengths differ.
    """
    if not zipfile.is_zipfile(path):
        raise RecordingError("it is no NPZ archive, or a damaged one: write it with numpy.savez")
    with zipfile.ZipFile(path) as archive:
        return _table([_member(archive, name) for name in archive.namelist() if name.endswith(".npy")], find)


def _member(archive: zipfile.ZipFile, name: str) -> Stored:
    """An array of an archive, of which only the description is read yet."""

    def load() -> NDArray[Any]:
        with archive.open(name) as file:
            array = np.lib.format.read_array(file, allow_pickle=False)
            if file.read(1):  # its end is where the checksum is compared
                raise ValueError(f"'{name}' is longer than it says")
        return np.asarray(array)

    with archive.open(name) as file:
        first = np.lib.format.read_magic(file) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    return Stored(name.removesuffix(".npy"), shape, dtype, load)


def read_mat(path: Path, find: Find = find_columns) -> Table:
    """MATLAB, up to v7 by SciPy, v7.3 as the HDF5 file that it is; fields of structures are `run.position`.

    Raises:
        RecordingError: as `read_npz`.
    """
    with path.open("rb") as file:
        if file.read(128).startswith(b"MATLAB 7.3"):
            return read_hdf5(path, find)
    from scipy.io import loadmat  # takes a while to import

    content = loadmat(path, simplify_cells=True)
    return _table([*_flat("", {name: value for name, value in content.items() if not name.startswith("__")})], find)


def _flat(name: str, value: Any) -> Iterator[Stored]:
    """Arrays in nested structures; of Simulink's signals the label is the name."""
    if isinstance(value, dict):
        label = value.get("label")
        if isinstance(label, str) and label and "values" in value:
            yield from _flat(f"{name.rpartition('.')[0]}.{label}".lstrip("."), value["values"])
            return
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, list):
        for k, inner in enumerate(value[:WIDEST]):
            yield from _flat(f"{name}[{k}]", inner)
    elif isinstance(value, np.ndarray):
        yield Stored(name, value.shape, value.dtype, lambda: value)


def read_hdf5(path: Path, find: Find = find_columns) -> Table:
    """Datasets of HDF5, those in groups by their paths: `run/position`.

    Raises:
        RecordingError: as `read_npz`, or if h5py is not installed.
    """
    need("h5py")
    import h5py

    with h5py.File(path, "r") as file:
        return _table([*_below(file)], find)


def _below(group: Any, path: str = "") -> Iterator[Stored]:
    """Datasets that hang below a group, none of them behind a link or a reference of MATLAB."""
    import h5py

    for name in group:
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from _below(item, f"{path}{name}/")
        elif isinstance(item, h5py.Dataset):
            yield Stored(path + name, item.shape or (), item.dtype, partial(_unpacked, item))


def _unpacked(dataset: Any) -> NDArray[Any]:
    """What a dataset holds, all of it in this file: others of this computer are nobody's business."""
    if dataset.external or dataset.is_virtual:
        raise RecordingError(f"dataset {dataset.name!r} lies in another file: save it in this one")
    return np.asarray(dataset[()])


def _width(one: Stored) -> int:
    """Columns of a matrix, whose longer side is time; 1 of a vector, and of what is neither."""
    return min(one.shape) if len(one.shape) == 2 else 1


def _table(stored: Sequence[Stored], find: Find) -> Table:
    places = [(one, k) for one in stored for k in range(_width(one) if _width(one) <= WIDEST else 0)]
    columns = find([one.name if _width(one) == 1 else f"{one.name}[{k}]" for one, k in places])
    loaded: dict[str, NDArray[Any]] = {}
    values: dict[str, Array] = {}
    for quantity, column in columns.items():
        one, k = places[column.index]
        dates = quantity == "time" and one.dtype.kind == "M"
        if (
            not (dates or one.dtype.kind in "iufO")
            or len(one.shape) not in (1, 2)
            or max(one.shape) != math.prod(one.shape) // max(_width(one), 1)
        ):
            raise RecordingError(
                f"array {one.name!r} ({quantity}) has type {one.dtype} and shape {one.shape}: "
                "store real numbers, one of each per sample"
            )
        if one.name not in loaded:
            loaded[one.name] = one.load()
        array = loaded[one.name]
        if array.ndim == 2:
            array = array[:, k] if array.shape[0] >= array.shape[1] else array[k]
        if dates:
            array = (array - array[0]) / np.timedelta64(1, "s")
        values[quantity] = np.asarray(array, dtype=np.float64)
    if len({len(array) for array in values.values()}) > 1:
        lengths = ", ".join(f"{quantity} {len(array)}" for quantity, array in values.items())
        raise RecordingError(f"the arrays differ in length ({lengths}): store one value of each per sample")
    return Table(columns, values)
