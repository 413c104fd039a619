"""Files that hold arrays by name: NPZ, MATLAB and HDF5, with columns of a matrix as columns of their own: `x[0]`."""

import zipfile
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.record import RecordingError
from pendulum_env.recording.table import Find, Table, need

WIDEST = 64  # columns of a matrix


def read_npz(path: Path, find: Find = find_columns) -> Table:
    """The arrays in need, never unpickled.

    Raises:
        RecordingError: if an array is missing, does not hold real numbers, is no vector, or if the lengths differ.
    """
    if not zipfile.is_zipfile(path):
        raise RecordingError("it is no NPZ archive, or a damaged one: write it with numpy.savez")
    arrays: dict[str, NDArray[Any]] = {}
    with np.load(path, allow_pickle=False) as archive:
        for name in archive.files:
            try:
                arrays[name] = np.asarray(archive[name])
            except ValueError as error:
                if "allow_pickle" not in str(error):
                    raise RecordingError(f"array '{name}' is damaged: write it anew with numpy.savez") from None
                arrays[name] = np.empty((), dtype=object)  # which only unpickling would make
    return _table(arrays, find)


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
    named = {name: value for name, value in content.items() if not name.startswith("__")}
    return _table(dict(_flat("", named)), find)


def _flat(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
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
        yield name, value


def read_hdf5(path: Path, find: Find = find_columns) -> Table:
    """Datasets of HDF5, those in groups by their paths: `run/position`.

    Raises:
        RecordingError: as `read_npz`, or if h5py is not installed.
    """
    need("h5py")
    import h5py

    with h5py.File(path, "r") as file:
        return _table(dict(_below(file)), find)


def _below(group: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Datasets that hang below a group, none of them behind a link or a reference of MATLAB."""
    import h5py

    for name in group:
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            yield from _below(item, f"{path}{name}/")
        elif isinstance(item, h5py.Dataset) and item.shape is not None:
            yield path + name, item


def _loaded(stored: Any) -> NDArray[Any]:
    """What a dataset of HDF5 holds, all of it in this file: others of this computer are nobody's business."""
    if getattr(stored, "external", None) or getattr(stored, "is_virtual", False):
        raise RecordingError(f"dataset {stored.name!r} lies in another file: save it in this one")
    return np.asarray(stored[()])


def _width(shape: tuple[int, ...]) -> int:
    """Columns of a matrix, whose longer side is time; 1 of a vector, and of what is neither."""
    return min(shape) if len(shape) == 2 else 1


def _table(stored: Mapping[str, Any], find: Find) -> Table:
    """Columns of arrays by name, those of HDF5 not read yet."""
    widths = {name: _width(array.shape) for name, array in stored.items()}
    places = [(name, k) for name, width in widths.items() if width <= WIDEST for k in range(width)]
    headers = [name if widths[name] == 1 else f"{name}[{k}]" for name, k in places]
    columns = find(headers)
    load = cache(lambda name: _loaded(stored[name]))
    values: dict[str, Array] = {}
    for quantity, column in columns.items():
        name, k = places[column.index]
        shape, dtype = stored[name].shape, stored[name].dtype
        dates = quantity == "time" and dtype.kind == "M"
        if not (dates or dtype.kind in "iufO") or len(shape) not in (1, 2):
            raise RecordingError(
                f"array {name!r} ({quantity}) has type {dtype} and shape {shape}: "
                "store real numbers, one of each per sample"
            )
        array = load(name)
        if array.ndim == 2:
            array = array[:, k] if shape[0] >= shape[1] else array[k]
        if dates:
            array = (array - array[0]) / np.timedelta64(1, "s")
        values[quantity] = np.asarray(array, dtype=np.float64)
    if len({len(array) for array in values.values()}) > 1:
        lengths = ", ".join(f"{quantity} {len(array)}" for quantity, array in values.items())
        raise RecordingError(f"the arrays differ in length ({lengths}): store one value of each per sample")
    return Table(headers, columns, values)
