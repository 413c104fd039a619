"""Writing files: refused before the work that fills them starts, and never left half written."""

from __future__ import annotations

import os
from pathlib import Path


def check_output(path: str | Path) -> Path:
    """The path, if a file can be written there.

    Raises:
        OSError: if its folder is missing or not writable, or if it is a folder itself; the message says which.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder: name a file in it")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.parent}: create it first")
    if not os.access(path.parent, os.W_OK):
        raise PermissionError(f"{path}: the folder {path.parent} cannot be written to: choose another place")
    return path


def write_whole(path: str | Path, content: str | bytes) -> None:
    """Write a file so that a reader sees the old one or the new one, never half of it.

    Links are followed; a device or pipe, such as /dev/null, is written to rather than replaced.

    Raises:
        OSError: if it cannot be written; it names the file.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        if Path(path).exists() and not Path(path).is_file():
            Path(path).write_bytes(data)
        else:
            _replace(Path(path).resolve(), data)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def _replace(path: Path, data: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
