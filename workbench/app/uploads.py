"""Uploaded files; their names are untrusted."""

import base64
import binascii
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pendulum_env.recording import Source
from pendulum_env.recording.formats import READERS
from pendulum_env.recording.study import Role, read_sources
from pendulum_env.robot_file import ENDINGS as ROBOT_ENDINGS
from workbench.errors import USER_ERRORS, InputError, format_mistake

STUDY, MODEL = "study.toml", "model.json"  # file names of the stage Export
ENDINGS = sorted((*READERS, *ROBOT_ENDINGS, ".json", ".toml"), key=len)[::-1]
LARGEST = 48_000_000  # largest upload [bytes], about 15 min at 1 kHz
LONGEST = 80  # largest length of a file name [characters]
HELD_OUT = re.compile(r"(?<![a-z])(holdout|test|valid)")  # in the name of a recording to check on
FITTED = re.compile(r"(?<![a-z])train")


def clean_name(name: str) -> str:
    """Return a safe file name: without folders and special characters, shortened, with a known ending kept."""
    last = re.split(r"[/\\]", name)[-1]
    plain = re.sub(r"[^\w .()+-]", "_", last).strip(" .")
    ending = next((ending for ending in ENDINGS if plain.lower().endswith(ending)), "")
    stem = plain[: len(plain) - len(ending)].lstrip("-")
    return f"{stem[: LONGEST - len(ending)] or 'recording'}{ending}"


def guess_role(name: str) -> Role:
    """Guess from its name whether a recording is fitted or held out."""
    return "holdout" if HELD_OUT.search(name.lower()) and not FITTED.search(name.lower()) else "fit"


@dataclass(frozen=True)
class UploadedFiles:
    """Uploaded files of one request, by kind."""

    robots: list[Path] = field(default_factory=list)
    models: list[Path] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)  # recordings of a study in its order, then others
    refused: list[str] = field(default_factory=list)  # error messages of unusable files


def sort_files(place: Path, contents: Sequence[tuple[str, str]], unwrap: bool) -> UploadedFiles:
    """Write uploads (pairs of name and data URL) to a folder and sort them by kind and name.

    Without a study, `unwrap` applies, and the name of a recording decides on its role.
    """
    files, of_study, uploaded = list[Path](), list[Source](), UploadedFiles()
    for name, content in sorted(contents):  # a browser has no fixed order
        try:
            file = unpack(place, name, content)
            if file.suffix == ".toml":
                of_study += [replace(s, file=place / clean_name(s.file.name)) for s in read_sources(file)]
            else:
                files.append(file)
        except USER_ERRORS as mistake:
            uploaded.refused.append(format_mistake(mistake))
    study_files = {s.file for s in of_study}
    for file in study_files.difference(files):
        uploaded.refused.append(f"{STUDY}: names {file.name}: drop both here together")
    uploaded.sources.extend(s for s in of_study if s.file in files)
    for file in files:
        if file.suffix.lower() in ROBOT_ENDINGS:
            uploaded.robots.append(file)
        elif file.suffix.lower() == ".json":
            uploaded.models.append(file)
        elif file not in study_files:
            uploaded.sources.append(Source(file, guess_role(file.name), unwrap=unwrap))
    return uploaded


def unpack(folder: Path, name: str, content: str) -> Path:
    """Decode a data URL into a file of a folder, and return its path; raises InputError if it is incomplete."""
    file = folder / clean_name(name)
    head, _, body = content.partition(",")
    try:
        if not head.startswith("data:"):
            raise ValueError("no data URL")
        file.write_bytes(base64.b64decode(body, validate=True))
    except (binascii.Error, ValueError):
        raise InputError(f"{file.name}: did not arrive whole: upload it again") from None
    return file
