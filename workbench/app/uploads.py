"""Files from the page: their names, their sizes, and nothing else of them is believed."""

import base64
import binascii
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pendulum_env.recording import Source
from pendulum_env.recording.storage import READERS
from pendulum_env.recording.study import read_sources
from workbench.mistakes import MISTAKES, InputError, sentence
from workbench.robot import FORMATS

STUDY = "study.toml"
ENDINGS = sorted((*READERS, *FORMATS, ".json", ".toml", ".zip"), key=len)[::-1]


@dataclass(frozen=True)
class Limits:
    """What a page may take of this computer, see SECURITY.md."""

    upload: int = 48_000_000  # bytes of one file, a quarter of an hour at 1 kHz
    space: int = 300_000_000  # bytes of a session's files
    samples: int = 20_000_000  # of all recordings of a state, and of all past states
    undone: int = 20  # changes that can be taken back
    sessions: int = 16  # the one that was used least recently gives way
    idle: float = 12 * 3600.0  # [s] after which a session that nobody has asked for ends
    name: int = 80  # characters of a file's name


LIMITS = Limits()


def safe_name(name: str) -> str:
    """File name without folders and without letters that mean something to a system, its ending kept."""
    last = re.split(r"[/\\]", name)[-1]
    plain = re.sub(r"[^\w .()+-]", "_", last).strip(" .")
    ending = next((ending for ending in ENDINGS if plain.lower().endswith(ending)), "")
    stem = plain[: len(plain) - len(ending)].lstrip("-")
    return f"{stem[: LIMITS.name - len(ending)] or 'recording'}{ending}"


def size(coming: Sequence[tuple[str, str]]) -> int:
    """Bytes of files, each a name and a data URL."""
    return sum(len(content) * 3 // 4 for _, content in coming)


def sorted_out(
    place: Path, coming: Sequence[tuple[str, str]], unwrap: bool
) -> tuple[list[Path], list[Source], list[str]]:
    """Robots and recordings among files that are unpacked to a folder, read as a study among them asks for.

    Returns what is wrong with others as well, a sentence each.
    """
    files, told, refused = list[Path](), list[Source](), list[str]()
    for name, content in coming:
        try:
            file = unpack(place, name, content)
            if file.suffix == ".toml":
                told += [replace(one, file=place / safe_name(one.file.name)) for one in read_sources(file)]
            else:
                files.append(file)
        except MISTAKES as mistake:
            refused.append(sentence(mistake))
    for name in {one.file.name for one in told if one.file not in files}:
        refused.append(f"{STUDY}: names {name}: drop both here together")
    robots = [file for file in files if file.suffix.lower() in FORMATS]
    sources = list[Source]()
    for file in (file for file in files if file not in robots):
        sources += [one for one in told if one.file == file] or [Source(file, unwrap=unwrap)]
    return robots, sources, refused


def unpack(folder: Path, name: str, content: str) -> Path:
    """Write what the page sent as a data URL to a folder; returns the file.

    Raises InputError if it is too large, or did not arrive whole.
    """
    file = folder / safe_name(name)
    head, _, body = content.partition(",")
    if len(body) * 3 // 4 > LIMITS.upload:
        raise InputError(
            f"{file.name}: is larger than {LIMITS.upload / 1e6:.0f} MB: shorten it, or use the command line"
        )
    try:
        if not head.startswith("data:"):
            raise ValueError("no data URL")
        file.write_bytes(base64.b64decode(body, validate=True))
    except (binascii.Error, ValueError):
        raise InputError(f"{file.name}: did not arrive whole: upload it again") from None
    return file
