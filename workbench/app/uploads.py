"""Files from the page: their names, their sizes, and nothing else of them is believed."""

from __future__ import annotations

import base64
import binascii
import gzip
import re
import zipfile
from collections.abc import Collection
from pathlib import Path

import pyarrow.parquet as pq

from pendulum_env.recording.storage import READERS
from workbench.inputs import InputError

UPLOAD = 48_000_000  # bytes of one file, a quarter of an hour at 1 kHz
UNPACKED = 400_000_000  # bytes of what a packed file holds
LONGEST_NAME = 80  # characters
MODELS = (".json",)
UNWRAP = "undo jumps of 2π in position"  # what the page calls the reader's `unwrap`
BLOCK = 1 << 20  # bytes


def safe_name(name: str, endings: Collection[str] = READERS) -> str:
    """File name without folders and without letters that mean something to a system, its ending kept."""
    last = re.split(r"[/\\]", name)[-1]
    plain = re.sub(r"[^\w .()+-]", "_", last).strip(" .")
    ending = next((ending for ending in sorted(endings, key=len)[::-1] if plain.lower().endswith(ending)), "")
    stem = plain[: len(plain) - len(ending)].lstrip("-")
    return f"{stem[: LONGEST_NAME - len(ending)] or 'recording'}{ending}"


def unpack(file: Path, content: str) -> None:
    """Write what the page sent as a data URL.

    Raises:
        InputError: if it is too large, or did not arrive whole.
    """
    head, _, body = content.partition(",")
    if len(body) * 3 // 4 > UPLOAD:
        raise InputError(f"{file.name}: is larger than {UPLOAD / 1e6:.0f} MB: shorten it, or use the command line")
    try:
        if not head.startswith("data:"):
            raise ValueError("no data URL")
        file.write_bytes(base64.b64decode(body, validate=True))
    except (binascii.Error, ValueError):
        raise InputError(f"{file.name}: did not arrive whole: upload it again") from None


def refuse_too_much(file: Path) -> None:
    """Refuse a packed file that would fill the memory; one that is damaged is left to the reader, who says how.

    Raises:
        InputError: if it holds too much.
    """
    name = file.name.lower()
    try:
        if name.endswith(".npz"):
            with zipfile.ZipFile(file) as archive:
                size = sum(part.file_size for part in archive.infolist())
        elif name.endswith(".gz"):
            size = 0
            with gzip.open(file) as packed:
                while size <= UNPACKED and (block := packed.read(BLOCK)):
                    size += len(block)
        elif name.endswith(".parquet"):
            about = pq.read_metadata(file)
            size = 8 * about.num_rows * about.num_columns
        else:
            return
    except Exception:  # whatever zlib, zipfile or arrow find wrong
        return
    if size > UNPACKED:
        raise InputError(f"{file.name}: holds more than {UNPACKED / 1e6:.0f} MB: shorten it, or use the command line")
