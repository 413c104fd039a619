"""Files that hold arrays by name: NPZ, MATLAB and HDF5, with columns of a matrix as columns of their own: `x[0]`."""

import math
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.reading import DEPTH, Stored, blocks, open_arrays, refuse_inflation, refuse_size
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.record import RecordingError
from pendulum_env.recording.table import LARGEST, REMEDY, Find, Table, need

WIDEST = 64  # columns of a matrix


def read_npz(path: Path, find: Find = find_columns, largest: float = LARGEST) -> Table:
    """The arrays in need, never unpickled.

    Raises:
        RecordingError: if an array is missing, does not hold real numbers, is no vector, or if the lengths differ.
        Unreadable: if the arrays in need hold more than `largest` bytes.
    """
    if not zipfile.is_zipfile(path):
        raise RecordingError("it is no NPZ archive, or a damaged one: write it with numpy.savez")
    with open_arrays(path) as stored:
        return _table(stored, find, largest)


def read_mat(path: Path, find: Find = find_columns, largest: float = LARGEST) -> Table:
    """MATLAB, up to v7 by SciPy, v7.3 as the HDF5 file that it is; fields of structures are `run.position`.

    Raises:
        RecordingError: as `read_npz`.
    """
    with path.open("rb") as file:
        hdf5 = file.read(128).startswith(b"MATLAB 7.3")
    if hdf5:
        return read_hdf5(path, find, largest)
    _refuse_inflation(path, largest)
    from scipy.io import loadmat  # takes a while to import

    content = loadmat(path, simplify_cells=True)
    return _table(
        [*_flat("", {name: value for name, value in content.items() if not name.startswith("__")})], find, largest
    )


def _refuse_inflation(path: Path, largest: float) -> None:
    """Refuse a MATLAB file whose packed variables hold more than `largest` bytes.

    Source: MAT-File Format, MathWorks: after 128 bytes of header come elements, each its type and its bytes, as two
    numbers of 32 bits, and what is in it; type 15 is packed.
    """
    size = 0
    with path.open("rb") as file:
        header = file.read(128)
        order: Literal["little", "big"] = "big" if header[126:] == b"MI" else "little"
        if 0 in header[:4]:
            return  # of version 4, which packs nothing and nests nothing
        while len(tag := file.read(8)) == 8:
            kind, length = (int.from_bytes(part, order) for part in (tag[:4], tag[4:]))
            begin = file.tell()
            if kind == PACKED:
                took = refuse_inflation(blocks(file, length), zlib.MAX_WBITS, largest - size, REMEDY)
                size += took
                file.seek(begin)
                inflated = zlib.decompress(file.read(length), bufsize=max(took, 1))  # at once, not piece by piece
                kind, inner = (int.from_bytes(part, order) for part in (inflated[:4], inflated[4:8]))
                content = memoryview(inflated)[8 : 8 + inner]
            else:
                content, inner = memoryview(file.read(length)), length
            if kind != MATRIX or len(content) != inner:
                raise RecordingError("it is damaged, or no MATLAB file: save it again")
            _refuse_nonsense(content, order)
            file.seek(begin + length)


def _refuse_nonsense(content: memoryview, order: Literal["little", "big"], depth: int = 0) -> None:
    """Refuse an array whose parts are of no type that an array has: SciPy believes them, and may crash."""
    place, number, holds = 0, 0, False
    while place + 8 <= len(content):
        first, length = (int.from_bytes(content[place + k : place + k + 4], order) for k in (0, 4))
        if first >> 16:  # type, length and content in 8 bytes
            kind, length, begin, place = first & 0xFFFF, first >> 16, place + 4, place + 8
            fits = length <= 4
        else:
            kind, begin = first, place + 8
            place = begin + -(-length // 8) * 8
            fits = begin + length <= len(content)
        if number == 0:
            kept = int.from_bytes(content[begin : begin + 4], order) & 0xFF  # class of the array
            holds = kept in HOLDING
            fits = fits and kind == FLAGS and length == 8 and kept in CLASSES
        elif number == 1 and kept not in OPAQUE:
            fits = fits and kind == SHAPE
        if not fits or kind not in TYPES or (kind == MATRIX and not (holds and number > 1)) or depth > DEPTH:
            raise RecordingError("it is damaged: a variable holds what no MATLAB file holds, save it again")
        if kind == MATRIX:
            _refuse_nonsense(content[begin : begin + length], order, depth + 1)
        number += 1


# numbers of the format: elements, classes of arrays, and those of which whole arrays are parts
SHAPE, FLAGS, MATRIX, PACKED = 5, 6, 14, 15
TYPES = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 14, 16, 17, 18}
CLASSES, HOLDING, OPAQUE = range(1, 19), {1, 2, 3, 16, 17, 18}, {17, 18}


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


def read_hdf5(path: Path, find: Find = find_columns, largest: float = LARGEST) -> Table:
    """Datasets of HDF5, those in groups by their paths: `run/position`.

    Raises:
        RecordingError: as `read_npz`, or if h5py is not installed.
    """
    need("h5py")
    import h5py

    with h5py.File(path, "r") as file:
        found: list[Stored] = []
        for number, (name, item) in enumerate(_below(file)):
            if number == MOST:
                raise RecordingError(f"it holds more than {MOST} groups and datasets: leave in those of one run")
            if isinstance(item, h5py.Dataset):
                found.append(Stored(name, item.shape or (), item.dtype, partial(_unpacked, item, largest)))
        return _table(found, find, largest)


def _below(group: Any, path: str = "", depth: int = 1) -> Iterator[tuple[str, Any]]:
    """Name and item of what hangs below a group, perhaps itself again; not of links, nor of MATLAB's references."""
    import h5py

    if depth > DEPTH:
        raise RecordingError(f"its groups nest more than {DEPTH} deep: save it flatter")
    for name in group:
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group[name]
        yield path + name, item
        if isinstance(item, h5py.Group):
            yield from _below(item, f"{path}{name}/", depth + 1)


def _unpacked(dataset: Any, largest: float) -> NDArray[Any]:
    """What a dataset holds, all of it in this file, and of a size that is known before it is unpacked.

    Filters are applied to each chunk in their order, so that what is stored is what the last one made. Deflation says
    nothing of how much it packed, and what has any length may be there many times and stored once.

    Source: HDF5 File Format Specification 3.0, IV.A.2.l and VIII.
    """
    made = dataset.id.get_create_plist()
    filters = [made.get_filter(k)[0] for k in range(made.get_nfilters())]
    while filters and filters[-1] == CHECKSUM:
        filters.pop()
    if dataset.external or dataset.is_virtual:
        raise RecordingError(f"dataset {dataset.name!r} lies in another file: save it in this one")
    before, last = {*filters[:-1]}, {*filters[-1:]}
    if dataset.dtype.hasobject or not before <= {SHUFFLE, CHECKSUM} or not last <= {DEFLATE, SHUFFLE}:
        raise RecordingError(
            f"dataset {dataset.name!r} is packed in a way whose size nobody can know before: save real numbers, with "
            "compression='gzip' or none"
        )
    if dataset.chunks is not None:
        whole, damaged = math.prod(dataset.chunks) * dataset.dtype.itemsize, f"dataset {dataset.name!r} is damaged"
        refuse_size(whole, largest, REMEDY)
        if dataset.id.get_num_chunks() > CHUNKS:
            raise RecordingError(f"dataset {dataset.name!r} is in more than {CHUNKS} chunks: save it in larger ones")
        places: list[tuple[int, ...]] = []
        dataset.id.chunk_iter(lambda chunk: places.append(chunk.chunk_offset))
        for place in places if DEFLATE in filters else ():
            left_out, stored = dataset.id.read_direct_chunk(place)  # filters of this chunk, as bits
            if left_out & 1 << filters.index(DEFLATE):
                continue
            sums = sum(one == CHECKSUM and not left_out & 1 << k for k, one in enumerate(filters))
            size = whole + 4 * sums  # those taken before it was packed
            if refuse_inflation([stored], zlib.MAX_WBITS, size, f"{damaged}, save it again") != size:
                raise RecordingError(f"{damaged}: save it again")
    return np.asarray(dataset[()])


MOST = 30_000  # groups and datasets of a file
CHUNKS = 100_000  # of a dataset
DEFLATE, SHUFFLE, CHECKSUM = 1, 2, 3  # numbers of HDF5's filters


def _width(one: Stored) -> int:
    """Columns of a matrix, whose longer side is time; 1 of a vector, and of what is neither."""
    return min(one.shape) if len(one.shape) == 2 else 1


def _table(stored: Sequence[Stored], find: Find, largest: float) -> Table:
    places = [(one, k) for one in stored for k in range(_width(one) if _width(one) <= WIDEST else 0)]
    columns = find([one.name if _width(one) == 1 else f"{one.name}[{k}]" for one, k in places])
    uses = Counter(places[column.index][0].name for column in columns.values())
    kept = {one.name: uses[one.name] == 1 and _width(one) == 1 for one in stored}  # and not copied
    needed = [one for one in stored if one.name in uses]
    copies = sum(  # of a matrix, its columns in need alone
        8 * uses[one.name] * (math.prod(one.shape) // max(_width(one), 1))
        for one in needed
        if not (kept[one.name] and one.dtype == np.float64)
    )
    refuse_size(sum(one.size for one in needed) + copies, largest, REMEDY)
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
        values[quantity] = np.require(array, np.float64, "W") if kept[one.name] else np.array(array, dtype=np.float64)
    if len({len(array) for array in values.values()}) > 1:
        lengths = ", ".join(f"{quantity} {len(array)}" for quantity, array in values.items())
        raise RecordingError(f"the arrays differ in length ({lengths}): store one value of each per sample")
    return Table(columns, values)
