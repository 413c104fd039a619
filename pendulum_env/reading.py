"""The door for files that anybody may have written: nothing of them is believed before it is measured.

Only regular files are read, up to a size; JSON and TOML up to a depth, with texts and whole numbers that can be
printed; NPZ with arrays whose sizes are known before they are unpacked. What stands in a JSON file is then taken by
`Value`, which knows its key. Every fault is an `Unreadable`: one sentence with the file and, where there is one, the
key.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import stat
import sys
import threading
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pendulum_env.files import at_once
from pendulum_env.mistake import Mistake

DOCUMENT = 5_000_000  # bytes of JSON or TOML; a long diagnosis takes 100 kB
ARRAYS = 50_000_000  # bytes of all arrays of a policy; those that ship take 60 kB
DEPTH = 32  # of tables in tables; the deepest file here has 7
DIGITS = 18  # of a whole number: those fit into 64 bits
LARGE = 1e9  # of any number in a file: in SI units no pendulum has more of anything, and squares stay finite
DIRECTORY = 1_000_000  # bytes of a ZIP archive's list of contents, of some 10,000 entries
HEADER = 1 << 16  # bytes of an array's description, of which NumPy's own takes 128
BLOCK = 1 << 20  # bytes read at a time
SHOWN = 60  # characters of a value that a sentence quotes
LIMITS = threading.Lock()  # belong to the process, and to those that are begun while they are set: hold it to begin one

JSON_TEXT = re.compile(r'"[^"\\]*+(?:\\.[^"\\]*+)*+(?:"|\Z)', re.DOTALL)
TOML_TEXT = re.compile(
    r'"""(?:[^"\\]++|\\.|"(?!""))*+(?:"""|\Z)|'
    r"'''(?:[^']++|'(?!''))*+(?:'''|\Z)|"
    r'"[^"\\\n]*+(?:\\[^\n][^"\\\n]*+)*+"?|'
    r"'[^'\n]*+'?|"
    r"#[^\n]*+",
    re.DOTALL,
)
BRACKET = re.compile(r"[\[\]{}]")
DOTTED = re.compile(rf"(?<![\w.-])(?:[\w-]*+[ \t]*+\.[ \t]*+){{{DEPTH},}}")  # a key of TOML, its texts taken out


class Unreadable(Mistake):
    """A file that cannot be read, or a value in it that cannot be; the message is one sentence."""


def shown(value: object) -> str:
    """A value as a sentence quotes it."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 10**DIGITS:
        return f"a number of more than {DIGITS} digits"
    text = repr(value) if not isinstance(value, dict | list | tuple | set) else _shallow(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


def _shallow(value: dict[Any, Any] | list[Any] | tuple[Any, ...] | set[Any]) -> str:
    """What holds other values, but for those that hold others in turn: they may nest without end."""
    if isinstance(value, dict):
        return "a table" if value else "an empty table"
    if any(isinstance(item, dict | list | tuple | set) for item in value):
        return "a list of lists or tables"
    return f"[{', '.join(shown(item) for item in list(value)[:8])}{', ...' if len(value) > 8 else ''}]"


def amount(size: float) -> str:
    """Bytes as a sentence tells them: `12 GB`."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size:.0f} bytes"


# ----------------------------------------------------------------------------------------------------------- files


def regular_size(path: str | os.PathLike[str], most: float, remedy: str = "it is not what was asked for") -> int:
    """Size of a regular file, links followed [bytes].

    Raises:
        Unreadable: if there is none of that name, it is a folder, a device or a pipe, or larger than `most`.
    """
    try:
        status = os.stat(path)
        made_up = status.st_size == 0 and hasattr(os, "statvfs") and os.statvfs(path).f_blocks == 0  # as /proc/kmsg
    except (OSError, ValueError) as error:
        raise Unreadable(f"{path}: cannot be read ({_reason(error)}): check the path") from None
    if stat.S_ISDIR(status.st_mode):
        raise Unreadable(f"{path}: cannot be read (it is a directory): name a file in it")
    if not stat.S_ISREG(status.st_mode):
        raise Unreadable(f"{path}: cannot be read (it is a device or a pipe): copy what it gives to a file first")
    if made_up:
        raise Unreadable(f"{path}: cannot be read (the system makes it up, maybe without end): copy it to a file first")
    if status.st_size > most:
        raise Unreadable(f"{path}: holds {amount(status.st_size)}, of which at most {amount(most)} are read: {remedy}")
    return status.st_size


def read_bytes(path: str | os.PathLike[str], most: int = DOCUMENT) -> bytes:
    """What is in a regular file.

    Raises:
        Unreadable: as `regular_size`, or if it cannot be read.
    """
    regular_size(path, most)
    try:
        with open(path, "rb") as file:
            data = file.read(most + 1)  # files of /proc are larger than they say
    except OSError as error:
        raise Unreadable(f"{path}: cannot be read ({_reason(error)})") from None
    if len(data) > most:
        raise Unreadable(f"{path}: holds more than the {amount(most)} that are read: it is not what was asked for")
    return data


def read_own(path: str | os.PathLike[str]) -> bytes:
    """What is in a file that only this user can have written, since reading it runs what is in it.

    Raises:
        Unreadable: if it cannot be read, belongs to somebody else, or others may write to it.
    """
    try:
        with open(path, "rb", opener=at_once) as file:
            status = os.fstat(file.fileno())  # of the file that is read, whatever takes its name meanwhile
            if not stat.S_ISREG(status.st_mode):
                raise Unreadable(f"{path}: cannot be read (it is no file): check the path")
            if hasattr(os, "getuid"):  # Windows has no such owners
                if status.st_uid != os.getuid():
                    raise Unreadable(f"{path}: belongs to another user: reading it would run what is in it")
                if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                    raise Unreadable(
                        f"{path}: others may write to it, and reading it runs what is in it: chmod go-w it"
                    )
            return file.read()
    except OSError as error:
        raise Unreadable(f"{path}: cannot be read ({_reason(error)})") from None


def read_text(path: str | os.PathLike[str]) -> str:
    """The text in a regular file, each line ended by a line feed.

    Raises:
        Unreadable: as `read_bytes`, or if it is not UTF-8.
    """
    try:
        return read_bytes(path).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise Unreadable(f"{path}: is no text: save it as UTF-8") from None


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


# ------------------------------------------------------------------------------------------------------- documents


def read_json(path: str | os.PathLike[str], hint: str) -> Any:
    """What a JSON file holds.

    Args:
        path: of the file.
        hint: which file is meant, such as `a model is what identify -o writes`.

    Raises:
        Unreadable: if it cannot be read, is no JSON, is nested too deeply, or holds what no one could have meant.
    """
    try:
        text = read_text(path)
    except Unreadable as error:
        if "is no text" in str(error):
            raise Unreadable(f"{path}: is not JSON; {hint}") from None
        raise
    try:
        _refuse_depth(JSON_TEXT.sub("0", text))
        content = json.loads(text, parse_int=_whole)
        _refuse_values(content)
    except Unreadable as error:
        raise Unreadable(f"{path}: {error}") from None
    except (ValueError, RecursionError):
        raise Unreadable(f"{path}: is not JSON; {hint}") from None
    return content


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What a TOML file holds.

    Raises:
        Unreadable: as `read_json`.
    """
    text = read_text(path)
    try:
        return parse_toml(text)
    except Unreadable as error:
        raise Unreadable(f"{path}: {error}") from None


def parse_toml(text: str) -> dict[str, Any]:
    """What a TOML document holds.

    Raises:
        Unreadable: as `read_toml`, without the file.
    """
    bare = TOML_TEXT.sub(lambda found: "" if found[0][0] == "#" else "0" + "\n" * found[0].count("\n"), text)
    _refuse_depth(bare)
    if found := DOTTED.search(bare):
        raise Unreadable(f"line {_line(bare, found.start())}: nests more than {DEPTH} deep: write fewer dots in a key")
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise Unreadable(f"is not TOML: {' '.join(str(error).split())[:200]}") from None
    except ValueError:  # Python reads no whole number of 4,300 digits
        raise Unreadable(f"holds a number of more than {DIGITS} digits: write it shorter") from None
    except RecursionError:
        raise Unreadable(f"nests more than {DEPTH} deep: write it flatter") from None
    _refuse_values(content)
    return content


def _whole(text: str) -> int | float:
    return int(text) if len(text) <= 400 else math.inf  # Python itself refuses those of 4,300 digits


def _refuse_depth(bare: str) -> None:
    """Refuse brackets in brackets, before a parser that calls itself for each meets them."""
    depth = 0
    for found in BRACKET.finditer(bare):
        depth += 1 if found[0] in "[{" else -1
        if depth > DEPTH:
            raise Unreadable(f"line {_line(bare, found.start())}: nests more than {DEPTH} deep: write it flatter")


def _line(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1


def _refuse_values(content: Any) -> None:
    """Refuse texts that cannot be printed or name a file, and whole numbers that no float could hold."""
    stack: list[tuple[Any, Any]] = [((), content)]  # where a value stands, as (where the table stands, its key)
    while stack:
        where, value = stack.pop()
        if isinstance(value, dict):
            for key, inner in value.items():
                _refuse_text((where, key), key)
                stack.append(((where, key), inner))
        elif isinstance(value, list):
            stack.extend(((where, k), inner) for k, inner in enumerate(value))
        elif isinstance(value, str):
            _refuse_text(where, value)
        elif isinstance(value, int) and abs(value) >= 10**DIGITS:
            raise Unreadable(f"{_key(where)} has more than {DIGITS} digits: write a smaller number")


def _refuse_text(where: Any, text: str) -> None:
    if "\0" in text or any("\ud800" <= letter <= "\udfff" for letter in text):
        raise Unreadable(f"{_key(where)} holds {shown(text)}, which is no text: take out the characters that are none")


def _key(where: Any) -> str:
    """A key as it is told: `theta.inertia.value`, `recording[0].file`."""
    parts: list[str] = []
    while where:
        where, part = where
        parts.append(f"[{part}]" if isinstance(part, int) else f".{part[:SHOWN].encode('unicode_escape').decode()}")
    return "".join(reversed(parts)).lstrip(".") or "the file"


@dataclass(frozen=True)
class Value:
    """A value of a document and the key that it stands under; every method takes it as what is asked for.

    Attributes:
        of: what the document is, as a sentence names it: `the model`.
        key: such as `theta.inertia.value`; empty for the whole document.
        content: as the parser gave it.
    """

    of: str
    key: str
    content: Any

    def fault(self, asked: str) -> Unreadable:
        """The mistake that it is not what was asked for."""
        if not self.key:
            return Unreadable(f"{self.of} is {shown(self.content)}: it has to be {asked}")
        return Unreadable(f"'{self.key}' of {self.of} is {shown(self.content)}: it has to be {asked}")

    def __getitem__(self, name: str | int) -> Value:
        """What stands under a key of a table, or at a place in a list.

        Raises:
            Unreadable: if this is no table, or lacks the key.
        """
        if isinstance(name, int):
            return Value(self.of, f"{self.key}[{name}]", self.content[name])
        found = self.get(name)
        if found is None:
            inside = f" under '{self.key}'" if self.key else ""
            raise Unreadable(f"{self.of} lacks '{name}'{inside}")
        return found

    def get(self, name: str) -> Value | None:
        """What stands under a key of a table, None if nothing does, or null.

        Raises:
            Unreadable: if this is no table.
        """
        if not isinstance(self.content, dict):
            raise self.fault("a table")
        inner = self.content.get(name)
        return None if inner is None else Value(self.of, f"{self.key}.{name}".lstrip("."), inner)

    def items(self, most: int = 10_000) -> list[Value]:
        """The values of a list.

        Raises:
            Unreadable: if it is none, or longer than `most`.
        """
        if not isinstance(self.content, list | tuple):
            raise self.fault("a list")
        if len(self.content) > most:
            raise Unreadable(f"'{self.key}' of {self.of} is a list of {len(self.content)}: at most {most} are read")
        return [self[k] for k in range(len(self.content))]

    def text(self, most: int = 200) -> str:
        """A text.

        Raises:
            Unreadable: if it is none, empty, or of more than `most` characters.
        """
        if not isinstance(self.content, str) or not 0 < len(self.content) <= most:
            raise self.fault(f"a text of up to {most} characters")
        return self.content

    def number(self, low: float = -LARGE, high: float = LARGE, above: bool = False) -> float:
        """A number from low to high, or `above` low.

        Raises:
            Unreadable: if it is none.
        """
        number = isinstance(self.content, int | float) and not isinstance(self.content, bool)
        if not number or not low <= self.content <= high or (above and self.content == low):
            asked = f"a number above {low:g}, up to {high:g}" if above else f"a finite number from {low:g} to {high:g}"
            raise self.fault(asked)
        return float(self.content)


# ---------------------------------------------------------------------------------------------------------- arrays


@dataclass(frozen=True)
class Stored:
    """An array in a file, not read yet."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    load: Callable[[], NDArray[Any]]

    @property
    def size(self) -> int:
        """Bytes that it takes in memory."""
        return math.prod(self.shape) * self.dtype.itemsize


def refuse_size(size: float, most: float, remedy: str) -> None:
    """Refuse what would take more memory than it may.

    Raises:
        Unreadable: if it would, with both.
    """
    if size > most:
        raise Unreadable(
            f"it holds {amount(size)} or more when unpacked, of which at most {amount(most)} are read: {remedy}"
        )


@contextmanager
def room_for(most: float) -> Iterator[None]:
    """Memory for `most` bytes beyond those in use, and files of as many: for a library that unpacks whatever comes.

    Beyond, there is a MemoryError or an OSError. All threads share it, so it is to be ample; Linux alone keeps to it.
    """
    if not sys.platform.startswith("linux"):
        yield
        return
    import resource

    with LIMITS:
        status = Path("/proc/self/status").read_text().split()
        used = 1024 * int(status[status.index("VmData:") + 1])
        before = {kind: resource.getrlimit(kind) for kind in (resource.RLIMIT_DATA, resource.RLIMIT_FSIZE)}
        try:
            for (kind, (soft, hard)), limit in zip(before.items(), (used + int(most), int(most)), strict=True):
                resource.setrlimit(kind, (limit if soft == resource.RLIM_INFINITY else min(soft, limit), hard))
            yield
        finally:
            for kind, limits in before.items():
                resource.setrlimit(kind, limits)


@contextmanager
def open_arrays(path: str | os.PathLike[str]) -> Iterator[list[Stored]]:
    """The arrays of an NPZ archive, of which only the headers are read yet; nothing is ever unpickled.

    Raises:
        Unreadable: if it is no such archive, or damaged; the message is without the file.
    """
    with _an_archive("NPZ"):
        _refuse_directory(path)
        with zipfile.ZipFile(path) as archive:
            yield [_stored(archive, info) for info in archive.infolist() if info.filename.endswith(".npy")]


@contextmanager
def _an_archive(kind: str) -> Iterator[None]:
    """Whatever fails within is told as a fault of an archive of a kind, but for mistakes, which tell themselves."""
    try:
        yield
    except Mistake:
        raise
    except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error, LookupError, SyntaxError) as error:
        raise Unreadable(f"is damaged, or no {kind} archive ({_told(error)})") from None
    except (NotImplementedError, RuntimeError, TypeError, AttributeError, OverflowError, MemoryError) as error:
        raise Unreadable(f"is packed in another way ({_told(error)})") from None


def _told(error: Exception) -> str:
    return " ".join(str(error).split())[:100] or type(error).__name__


def read_arrays(path: str | os.PathLike[str], hint: str, most: int = ARRAYS) -> dict[str, NDArray[Any]]:
    """All arrays of an NPZ file, by name; the hint says which file is meant, as in `read_json`.

    Raises:
        Unreadable: as `open_arrays` and `regular_size`, or if they take more than `most` bytes.
    """
    regular_size(path, most)
    try:
        with open_arrays(path) as stored:
            refuse_size(sum(array.size for array in stored), most, "it is another file")
            return {array.name: array.load() for array in stored}
    except Unreadable as error:
        raise Unreadable(f"{path}: {error}; {hint}") from None


def _stored(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Stored:
    with archive.open(info) as packed:
        file = io.BytesIO(packed.read(HEADER))
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    if any(length < 0 for length in shape) or math.prod(shape) >= 2**62:
        raise Unreadable(f"is damaged: array '{info.filename[:SHOWN]}' has the shape {shown(shape)}")

    def load() -> NDArray[Any]:
        with archive.open(info) as file:
            array = np.lib.format.read_array(file, allow_pickle=False)
            if file.read(1):  # its end is where the checksum is compared
                raise ValueError(f"'{info.filename[:SHOWN]}' is longer than it says")
        return np.asarray(array)

    return Stored(info.filename.removesuffix(".npy"), shape, dtype, load)


def _refuse_directory(path: str | os.PathLike[str]) -> None:
    """Refuse a ZIP archive whose list of contents would fill the memory by itself."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - (1 << 16) - 98))  # the longest comment, and the records before it
        tail = file.read()
    place = tail.rfind(b"PK\x05\x06")
    told = int.from_bytes(tail[place + 12 : place + 16], "little") if place >= 0 else 0
    wide = tail.rfind(b"PK\x06\x06")  # of archives beyond 4 GB
    if wide >= 0:
        told = max(told if told != 0xFFFFFFFF else 0, int.from_bytes(tail[wide + 40 : wide + 48], "little"))
    if told > DIRECTORY:
        raise Unreadable(f"lists {amount(told)} of contents, of which at most {amount(DIRECTORY)} are read")


def refuse_archive(path: str | os.PathLike[str], most: float, remedy: str) -> None:
    """Refuse a ZIP archive that unpacks to more than `most` bytes, whatever it says of itself; a spreadsheet is one.

    Raises:
        Unreadable: if it does; one that is damaged is left to its reader.
    """
    _refuse_directory(path)
    try:
        with zipfile.ZipFile(path) as archive, open(path, "rb") as file:
            size = sum(info.file_size for info in archive.infolist())
            refuse_size(size, most, remedy)
            for info in archive.infolist():
                if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise Unreadable(
                        f"{path}: '{shown(info.filename)}' in it is packed in a way whose size nobody can know before: "
                        "write it with deflation, or not packed"
                    )
                if info.compress_type == zipfile.ZIP_DEFLATED:
                    file.seek(info.header_offset + 26)
                    lengths = file.read(4)
                    skip = int.from_bytes(lengths[:2], "little") + int.from_bytes(lengths[2:], "little")
                    file.seek(skip, os.SEEK_CUR)
                    refuse_inflation(blocks(file, info.compress_size), -zlib.MAX_WBITS, most, remedy)
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        if isinstance(error, Unreadable):
            raise


def read_archive(path: str | os.PathLike[str], hint: str, most: int) -> dict[str, bytes]:
    """What is in the files of a ZIP archive, by name; the hint says which file is meant, as in `read_json`.

    Raises:
        Unreadable: as `regular_size` and `refuse_archive`, or if it is none, damaged, or names a file twice.
    """
    regular_size(path, most)
    try:
        with _an_archive("ZIP"):
            refuse_archive(path, most, "it is another file")
            with zipfile.ZipFile(path) as archive:
                names = archive.namelist()
                if len(set(names)) < len(names):
                    raise Unreadable("it names a file twice")
                return {name: archive.read(name) for name in names}
    except Unreadable as error:
        raise Unreadable(f"{path}: {str(error).removeprefix(f'{path}: ')}; {hint}") from None


def refuse_inflation(packed: Iterable[bytes], wbits: int, most: float, remedy: str) -> int:
    """Bytes that a stream of deflate unpacks to, counted without keeping them.

    Raises:
        Unreadable: if there are more than `most`; a damaged stream ends where it is damaged.
    """
    inflate, size = zlib.decompressobj(wbits), 0
    for block in packed:
        while block:
            try:
                size += len(inflate.decompress(block, BLOCK))
            except zlib.error:
                return size
            refuse_size(size, most, remedy)
            block = inflate.unconsumed_tail
    return size


def blocks(file: IO[bytes], size: int) -> Iterator[bytes]:
    """The next `size` bytes of a file, block by block."""
    while size > 0 and (block := file.read(min(size, BLOCK))):
        size -= len(block)
        yield block
