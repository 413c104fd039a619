"""Read and check JSON, TOML and NPZ files.

`convert` makes a struct or a dataclass of the content. Each error is one sentence with the file and the key.
"""

from __future__ import annotations

import json
import os
import reprlib
import stat
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, inspect
from numpy.typing import NDArray

from pendulum_env.errors import FileError, UserError, shorten_error
from pendulum_env.lookup import find

MAX_BYTES = 500_000_000  # [bytes] of a file, about 8 million rows of CSV
MAX_NUMBER = 1e9  # largest magnitude of a number in a file [SI units]
MAX_QUOTED = 60  # characters of a quoted value in a message
MAX_TEXT = 1000  # characters of a text field

T = TypeVar("T")


def quote_value(value: object, max_length: int = MAX_QUOTED) -> str:
    """Quote a value for a message in up to `max_length` characters, without nested values."""
    if type(value).__module__ != "builtins" and "\n" in repr(value):  # arrays and results
        return f"<{type(value).__name__}>"
    brief = reprlib.Repr()
    brief.maxlevel, brief.maxlong, brief.maxstring, brief.maxother = 1, max_length, max_length, max_length
    text = " ".join(brief.repr(value).split())
    return text if len(text) <= max_length else f"{text[: max_length - 3]}..."


# ----------------------------------------------------------------------------------------------------------- files


def check_size(path: str | os.PathLike[str]) -> None:
    """Refuse a path that is not a regular file, or a file of more than `MAX_BYTES` bytes."""
    try:
        status = os.stat(path)
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read ({_get_reason(error)}): check the path") from None
    if not stat.S_ISREG(status.st_mode):
        raise FileError(f"{path}: cannot be read (it is a folder, a device or a pipe): name a file")
    if status.st_size > MAX_BYTES:
        raise FileError(
            f"{path}: has {status.st_size / 1e6:.4g} MB, at most {MAX_BYTES / 1e6:g} MB are read: shorten it"
        )


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Read a file."""
    check_size(path)
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({_get_reason(error)}): check the path") from None


def read_text(path: str | os.PathLike[str]) -> str:
    """Read a UTF-8 text file; line ends become line feeds."""
    try:
        return read_bytes(path).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise FileError(f"{path}: is no text: save it as UTF-8") from None


def _get_reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


# ------------------------------------------------------------------------------------------------------- documents


def read_json(path: str | os.PathLike[str], hint: str) -> Any:
    """Read a JSON file.

    Args:
        path: path of the file.
        hint: expected file, for messages: `a model is what identify -o writes`.
    """
    data = read_bytes(path)
    try:
        return json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        raise FileError(f"{path}: is not JSON; {hint}") from None


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file."""
    text = read_text(path)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: is not TOML ({shorten_error(error)}): correct it in an editor") from None


def format_toml(table: Mapping[str, Any]) -> list[str]:
    """Format a table as lines of TOML, with nested tables inline: the inverse of `read_toml`."""
    return [f"{name} = {_format_value(value)}" for name, value in table.items()]


def _format_value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(format_toml(value)) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_format_value, value)) + "]"
    if isinstance(value, float):
        return repr(float(value))  # also of NumPy floats
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # integers, booleans and strings


# ---------------------------------------------------------------------------------------------------------- values


Number = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]  # types of fields for `convert`
NonNegative = Annotated[float, Meta(ge=0.0, le=MAX_NUMBER)]
Text = Annotated[str, Meta(min_length=1, max_length=MAX_TEXT)]


def convert(content: Any, kind: type[T], key: str = "") -> T:
    """Convert the content of JSON or TOML to a type of msgspec, for example a struct or a dataclass.

    Args:
        content: output of the parser.
        kind: target type. Unknown keys of a dataclass or of a struct with `forbid_unknown_fields` are refused.
        key: key of the content in its file; empty for the whole file.

    Raises:
        UserError: if a value has another type or is out of range; the message has its key: `recording[2].load.gravity`.
    """
    _refuse_unknown(content, inspect.type_info(kind), key)
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        message, _, place = str(error).replace("`", "").partition(" - at $")
        place = (key + place).lstrip(".")
        raise FileError(f"'{place}': {message}" if place else message) from None


def _refuse_unknown(content: Any, kind: inspect.Type, key: str) -> None:
    """Refuse unknown keys and literals; the message lists the known ones."""
    kinds = kind.types if isinstance(kind, inspect.UnionType) else (kind,)
    choices = [word for member in kinds if isinstance(member, inspect.LiteralType) for word in member.values]
    if choices and isinstance(content, str | int) and content not in choices:
        raise FileError(f"'{key}' is {quote_value(content)}: expected one of {', '.join(map(str, choices))}")
    for member in kinds:
        if isinstance(content, list) and isinstance(member, inspect.ListType | inspect.VarTupleType):
            for k, inner in enumerate(content):
                _refuse_unknown(inner, member.item_type, f"{key}[{k}]")
        if isinstance(content, dict) and isinstance(member, inspect.StructType | inspect.DataclassType):
            fields = {field.encode_name: field.type for field in member.fields}
            for name, inner in content.items():
                if name in fields:
                    _refuse_unknown(inner, fields[name], f"{key}.{name}".lstrip("."))
                elif isinstance(member, inspect.DataclassType) or member.forbid_unknown_fields:
                    try:
                        find("key", name, fields)
                    except UserError as error:
                        raise FileError(f"'{key}': {error}" if key else str(error)) from None


# --------------------------------------------------------------------------------------------------------- arrays


def read_arrays(path: str | os.PathLike[str], hint: str) -> dict[str, NDArray[Any]]:
    """Read the arrays of an NPZ file by name, without unpickling.

    Args:
        path: path of the file.
        hint: expected file, as in `read_json`.
    """
    check_size(path)
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            return dict(archive)
    except Exception as error:  # a damaged file may fail anywhere in zipfile, zlib and NumPy
        raise FileError(f"{path}: not a readable NPZ file ({shorten_error(error)}); {hint}") from None
