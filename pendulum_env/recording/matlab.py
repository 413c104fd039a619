"""Read MATLAB files and HDF5; arrays in structures or groups are named by their path."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import scipy

from pendulum_env.recording.arrays import build_table, flatten_structures
from pendulum_env.recording.table import ColumnFinder, RawTable, require_module

DESCRIPTIONS = ("dimensions", "name")  # fields of MATLAB structures without samples


def read_mat(path: Path, find: ColumnFinder) -> RawTable:
    """Read MATLAB files, up to v7 by SciPy and v7.3 as HDF5; fields are named `run.position`."""
    with path.open("rb") as file:
        if file.read(128).startswith(b"MATLAB 7.3"):
            return read_hdf5(path, find)

    scipy.io.whosmat(path)  # refuses a damaged file that crashes loadmat
    content = scipy.io.loadmat(path, simplify_cells=True)
    return build_table(
        dict(flatten_structures("", {name: value for name, value in content.items() if not name.startswith("__")})),
        find,
    )


def read_hdf5(path: Path, find: ColumnFinder) -> RawTable:
    """Read datasets of HDF5 by their paths, `run/position`; external links are not followed.

    Structures and arrays of MATLAB 7.3 are named as in older files: `run.position`, `out.signals[0].values[1]`. Texts,
    names and sizes are ignored.
    """
    require_module("h5py")
    import h5py

    with path.open("rb") as start:
        is_matlab = start.read(128).startswith(b"MATLAB 7.3")
    with h5py.File(path, "r") as file:
        return build_table(
            dict(flatten_structures("", _read_matlab_value(file)) if is_matlab else _collect_datasets(file, "")), find
        )


def _collect_datasets(group: Any, path: str) -> Iterator[tuple[str, Any]]:
    for name, item in _find_members(group):
        if hasattr(item, "keys"):
            yield from _collect_datasets(item, f"{path}{name}/")
        else:
            yield path + name, item


def _find_members(group: Any) -> Iterator[tuple[str, Any]]:
    """Yield names and members of a group, without links and external datasets."""
    import h5py

    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            item = group[name]
            if isinstance(item, h5py.Group) or (isinstance(item, h5py.Dataset) and _is_whole(item)):
                yield name, item


def _is_whole(dataset: Any) -> bool:
    return dataset.shape is not None and not (dataset.external or dataset.is_virtual)


def _read_matlab_value(item: Any) -> Any:
    """Convert a value of MATLAB 7.3 to that of older files, without reading numeric datasets.

    An array of structures is a group of fields, and a cell is a dataset; both hold references to their elements.
    """
    import h5py

    if isinstance(item, h5py.Group):
        fields = {name: member for name, member in _find_members(item) if name[0] != "#" and name not in DESCRIPTIONS}
        arrays = {
            name: member
            for name, member in fields.items()
            if _has_references(member) and "MATLAB_class" not in member.attrs
        }
        rows = zip(*(_follow_reference(array) for array in arrays.values()), strict=True)
        structures = [dict(zip(arrays, row, strict=True)) for row in rows]
        return structures or {name: _read_matlab_value(member) for name, member in fields.items()}
    kind = item.attrs.get("MATLAB_class")
    if "MATLAB_empty" in item.attrs or kind == b"function_handle" or not _is_whole(item):
        return None
    if kind == b"char":
        return "".join(map(chr, item[()].flat))
    if _has_references(item):
        return _follow_reference(item)
    return item[()].item() if item.size == 1 else item


def _has_references(item: Any) -> bool:
    import h5py

    return isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is h5py.Reference


def _follow_reference(item: Any) -> list[Any]:
    return [_read_matlab_value(item.file[reference]) for reference in item[()].flat]
