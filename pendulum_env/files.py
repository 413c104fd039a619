"""Check output paths, and write files completely or not at all."""

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO


def check_output(path: str | Path) -> Path:
    """Return the path if a file can be written at it.

    Raises:
        OSError: if the folder is missing or not writable, or the path is a folder.
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
    """Write a file in one step: readers see the old or the new content, never a part.

    Raises:
        OSError: as `replace_file`.
    """
    with replace_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def format_json(content: Any) -> str:
    """Format data as strict JSON, with null for each number that is not finite."""
    finite = json.loads(json.dumps(content), parse_constant=lambda _: None)
    return json.dumps(finite, indent=1) + "\n"


@contextmanager
def replace_file(path: str | Path) -> Iterator[BinaryIO]:
    """Open a hidden temporary file that replaces `path` when all content is on the disk.

    Links are followed, and permissions of a replaced file are kept. A device, such as /dev/null, is written directly.

    Raises:
        OSError: if the file cannot be written; the error names it.
    """
    place = Path(os.path.realpath(path))
    is_device = place.exists() and not place.is_file()
    target = place if is_device else place.with_name(f".{place.name}.{os.getpid()}.part")
    try:
        if not is_device:
            target.unlink(missing_ok=True)  # left by a killed program, or a link by another user
        with target.open("wb" if is_device else "xb") as file:
            if place.is_file():
                shutil.copymode(place, target)
            yield file
            file.flush()
            sync_file(file)
        if not is_device:
            target.replace(place)
    except OSError as error:
        raise OSError(error.errno, error.strerror or " ".join(str(error).split()), str(path)) from error
    finally:
        if not is_device:
            with suppress(OSError):  # already renamed, or never created
                target.unlink(missing_ok=True)


def sync_file(file: BinaryIO | FileIO) -> None:
    """Wait until the content is on the disk; some disks report only then that they are full.

    Raises:
        OSError: if the content cannot be written.
    """
    try:
        os.fsync(file.fileno())
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # a pipe or a device has no disk
            raise
