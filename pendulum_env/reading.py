"""Read JSON, TOML and NPZ, and check what stands in them.

What stands in a JSON file is taken by `Value`, which knows its key. Every fault is an `Unreadable`: one sentence with
the file and, where there is one, the key.
"""

from __future__ import annotations

import json
import os
import re
import reprlib
import stat
import tomllib
import zipfile
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pendulum_env.files import at_once
from pendulum_env.lookup import find
from pendulum_env.mistake import Mistake, one_line

LARGEST = 500_000_000  # bytes of a file: some 8 million rows of CSV
DIGITS = 18  # of a whole number: those fit into 64 bits
LARGE = 1e9  # of any number in a file: in SI units no pendulum has more of anything, and squares stay finite
SHOWN = 60  # characters of a value that a sentence quotes
LONGEST = 1000  # characters of a text in a record

T = TypeVar("T")


class Unreadable(Mistake):
    """A file that cannot be read, or a value in it that cannot be; the message is one sentence."""


def shown(value: object, most: int = SHOWN) -> str:
    """A value as a sentence quotes it, up to so many characters; what it holds in turn is left out."""
    brief = reprlib.Repr()
    brief.maxlevel, brief.maxlong, brief.maxstring, brief.maxother = 1, most, most, most
    text = brief.repr(value)
    return text if len(text) <= most else f"{text[: most - 3]}..."


def amount(size: float) -> str:
    """Bytes as a sentence tells them: `12 GB`."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size:.0f} bytes"


# ----------------------------------------------------------------------------------------------------------- files


def check_size(path: str | os.PathLike[str]) -> None:
    """Refuse what is no file, or a file too large to be what was meant.

    Raises:
        Unreadable: if there is none of that name, it is a folder, a device or a pipe, or of more than `LARGEST` bytes.
    """
    try:
        status = os.stat(path)
    except (OSError, ValueError) as error:
        raise Unreadable(f"{path}: cannot be read ({_reason(error)}): check the path") from None
    if not stat.S_ISREG(status.st_mode):
        raise Unreadable(f"{path}: cannot be read (it is a folder, a device or a pipe): name a file")
    if status.st_size > LARGEST:
        raise Unreadable(
            f"{path}: has {status.st_size / 1e6:.4g} MB, at most {LARGEST / 1e6:g} MB are read: shorten it"
        )


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Read a file.

    Raises:
        Unreadable: as `check_size`, or if it cannot be read.
    """
    check_size(path)
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise Unreadable(f"{path}: cannot be read ({_reason(error)}): check the path") from None


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
    """The text that somebody typed into a regular file, each line ended by a line feed.

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
        Unreadable: if it cannot be read, is no JSON, or holds what no one could have meant.
    """
    data = read_bytes(path)
    try:
        content = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        raise Unreadable(f"{path}: is not JSON; {hint}") from None
    _refuse_values(path, content)
    return content


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What a TOML file holds.

    Raises:
        Unreadable: as `read_json`.
    """
    text = read_text(path)
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of a whole number of 4,300 digits
        raise Unreadable(f"{path}: is not TOML ({one_line(error)}): correct it in an editor") from None
    _refuse_values(path, content)
    return content


def toml(table: Mapping[str, Any]) -> list[str]:
    """Lines of a table in TOML, tables in it on one line each: the counterpart of `read_toml`."""
    return [f"{name} = {_toml(value)}" for name, value in table.items()]


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(toml(value)) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float):
        return repr(float(value))  # of NumPy's, too
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # whole numbers, truth values and texts


def _refuse_values(path: str | os.PathLike[str], content: Any) -> None:
    """Refuse texts that cannot be printed or name a file, and whole numbers that no float could hold."""
    stack = [content]
    while stack:
        value = stack.pop()
        if isinstance(value, dict):
            stack += [*value, *value.values()]
        elif isinstance(value, list):
            stack += value
        elif isinstance(value, str) and re.search("[\0\ud800-\udfff]", value):
            raise Unreadable(f"{path}: holds {shown(value)}, which is no text: take out the characters that are none")
        elif isinstance(value, int) and abs(value) >= 10**DIGITS:
            raise Unreadable(f"{path}: holds a number of more than {DIGITS} digits: write a smaller one")


def within(low: float, high: float = LARGE, default: Any = MISSING, also: str | None = None) -> Any:
    """A field of a record: a number from low to high, or a word that stands for None."""
    return field(default=default, metadata={"range": (low, high), "also": also})


def one_of(*known: Any, default: Any = MISSING) -> Any:
    """A field of a record: one of the known values."""
    return field(default=default, metadata={"known": known})


def several(low: float, high: float, most: int, default: Any = MISSING) -> Any:
    """A field of a record: up to so many numbers from low to high."""
    return field(default=default, metadata={"range": (low, high), "also": None, "most": most})


@dataclass(frozen=True)
class Value:
    """A value of a document and the key that it stands under; every method takes it as what is asked for.

    Attributes:
        of: what the document is, as a sentence names it: `the model`; empty where the file's name says it.
        key: such as `theta.inertia.value`; empty for the whole document.
        content: as the parser gave it.

    Raises:
        Unreadable: by every method, if it is not what was asked for: the sentence has the key, the value and what it
            has to be.
    """

    of: str
    key: str
    content: Any

    def fault(self, asked: str) -> Unreadable:
        """The mistake that it is not what was asked for."""
        return Unreadable(f"{self._what} is {shown(self.content)}: it has to be {asked}")

    @property
    def _what(self) -> str:
        return " of ".join(filter(None, [self.key and f"'{self.key}'", self.of])) or "it"

    def __getitem__(self, name: str | int) -> Value:
        """What has to stand under a key of a table, or at a place in a list."""
        if isinstance(name, int):
            return Value(self.of, f"{self.key}[{name}]", self.content[name])
        found = self.get(name)
        if found is None:
            inside = f" under '{self.key}'" if self.key else ""
            raise Unreadable(f"{self.of or 'it'} lacks '{name}'{inside}")
        return found

    def get(self, name: str) -> Value | None:
        """What stands under a key of a table, None if nothing does, or null."""
        inner = self.table().get(name)
        return None if inner is None else Value(self.of, f"{self.key}.{name}".lstrip("."), inner)

    def table(self) -> dict[str, Any]:
        """A table."""
        if not isinstance(self.content, dict):
            raise self.fault("a table")
        return self.content

    def items(self, most: int = 10_000) -> list[Value]:
        """The values of a list, no longer than `most`."""
        if not isinstance(self.content, list | tuple):
            raise self.fault("a list")
        if len(self.content) > most:
            raise Unreadable(f"{self._what} is a list of {len(self.content)}: at most {most} are read")
        return [self[k] for k in range(len(self.content))]

    def text(self, most: int = 200) -> str:
        """A text, not empty, of up to `most` characters."""
        if not isinstance(self.content, str) or not self.content.strip() or len(self.content) > most:
            raise self.fault(f"a text of up to {most} characters")
        return self.content

    def number(self, low: float = -LARGE, high: float = LARGE, above: bool = False, whole: bool = False) -> float:
        """A number from low to high, or `above` low."""
        number = isinstance(self.content, int if whole else int | float) and not isinstance(self.content, bool)
        if not number or not low <= self.content <= high or (above and self.content == low):
            kind = "whole" if whole else "finite"
            asked = f"a number above {low:g}, up to {high:g}" if above else f"a {kind} number from {low:g} to {high:g}"
            raise self.fault(asked)
        return int(self.content) if whole else float(self.content)

    def record(self, kind: type[T]) -> T:
        """A record of a table, whose keys are its fields: of their types, and as they are bounded there.

        Raises:
            Mistake: if it has a key of another name.
        """
        known = {asked.name: asked for asked in fields(kind)}  # type: ignore[arg-type]
        for name in self.table():
            find(f"key in [{self.key}]" if self.key else "key", name, known)
        needed = {name for name, asked in known.items() if asked.default is MISSING} | set(self.table())
        return kind(**{name: self[name]._as(asked) for name, asked in known.items() if name in needed})

    def _as(self, asked: Field[Any]) -> Any:
        """What a field asks for."""
        if "known" in asked.metadata:
            if not any(self.content == one and type(self.content) is type(one) for one in asked.metadata["known"]):
                raise self.fault(f"one of {', '.join(map(str, asked.metadata['known']))}")
            return self.content
        kind = asked.type if isinstance(asked.type, str) else asked.type.__name__
        match kind.removesuffix(" | None"):
            case "bool":
                if not isinstance(self.content, bool):
                    raise self.fault("true or false")
                return self.content
            case "str":
                return self.text(LONGEST)
            case "Value":
                return self
        (low, high), also = asked.metadata["range"], asked.metadata["also"]
        if "most" in asked.metadata:
            return tuple(one.number(low, high, whole="int" in kind) for one in self.items(asked.metadata["most"]))
        if isinstance(self.content, str) and also is not None:
            if self.content != also:
                raise self.fault(f'a number, or "{also}"')
            return None
        return self.number(low, high, whole=kind.startswith("int"))


# -------------------------------------------------------------------------------------------------------- archives


def read_archive(path: str | os.PathLike[str], hint: str, most: int) -> dict[str, bytes]:
    """What is in the files of a ZIP archive, by name; the hint says which file is meant, as in `read_json`.

    Raises:
        Unreadable: as `check_size`, if it holds more than `most` bytes, is none, or damaged.
    """
    check_size(path)
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(info.file_size for info in archive.infolist())  # of each no more than this is unpacked
            if size > most:
                raise Unreadable(f"holds {amount(size)}, of which at most {amount(most)} are read")
            return {name: archive.read(name) for name in archive.namelist()}
    except Unreadable as error:
        raise Unreadable(f"{path}: {error}; {hint}") from None
    except Exception as error:  # a damaged file may fail anywhere in zipfile and zlib
        raise Unreadable(f"{path}: is damaged, or no ZIP archive ({one_line(error)}); {hint}") from None


def read_arrays(path: str | os.PathLike[str], hint: str) -> dict[str, NDArray[Any]]:
    """Read all arrays of an NPZ file by name; none is unpickled.

    Args:
        path: of the file.
        hint: which file is meant, as in `read_json`.

    Raises:
        Unreadable: as `check_size`, or if it is damaged, or no NPZ file.
    """
    check_size(path)
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            return dict(archive)
    except Exception as error:  # a damaged file may fail anywhere in zipfile, zlib and NumPy
        raise Unreadable(f"{path}: not a readable NPZ file ({one_line(error)}); {hint}") from None
