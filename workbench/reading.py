"""Sources of the recordings in the arguments of a command, and how they are read."""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from pendulum_env.formatting import join_words
from pendulum_env.recording import Recording, Source
from pendulum_env.recording.study import find_duplicate, read_sources
from workbench.errors import InputError
from workbench.narrator.notes import WARNING, describe_note
from workbench.outputs import check_outputs
from workbench.terminal import Terminal

Logged = TypeVar("Logged", bound=Recording)


def list_sources(arguments: argparse.Namespace, outputs: Sequence[str | None] = ()) -> tuple[Source, ...]:
    """List the sources of all recordings and studies in the arguments, fitted ones first, without reading them.

    Raises InputError if one is named twice or none is fitted, StudyError if a study is invalid, and as
    `check_outputs` for outputs that would overwrite inputs.
    """
    names, holdout = list(arguments.recordings), list(getattr(arguments, "holdout", []))
    sources = [source for name in names for source in read_source_names(name, arguments)]
    sources += [replace(source, role="holdout") for name in holdout for source in read_source_names(name, arguments)]
    if (duplicate := find_duplicate(sources)) is not None:
        raise InputError(f"{duplicate.file}: is named twice: name each recording once, to fit or to hold out")
    for source in sources:  # held-out sources, too
        if not source.file.exists():
            raise InputError(f"{source.file}: there is no such file: check the path")
    sources.sort(key=lambda source: source.role == "holdout")
    if names and sources[0].role == "holdout":
        raise InputError(f'{names[0]}: holds every recording out: give one of them role = "fit"')
    files = [str(source.file) for source in sources]
    check_outputs(outputs, [*names, *holdout, *filter(None, [arguments.robot]), *files])
    return tuple(sources)


def read_source_names(name: str, arguments: argparse.Namespace) -> tuple[Source, ...]:
    """Return the sources of a study, or of a single file with the columns of the arguments.

    Raises InputError if the arguments set columns, unwrap or drive for a study, and StudyError if it is invalid.
    """
    drive = getattr(arguments, "drive", None)  # not an option of every command
    if not name.lower().endswith(".toml"):
        return (Source(Path(name), columns=arguments.columns or {}, unwrap=arguments.unwrap, drive=drive),)
    if arguments.columns or arguments.unwrap or drive:
        raise InputError(f"{name}: is a study with reading options of its own: write columns, unwrap and drive there")
    return read_sources(name)


def read_all(sources: Sequence[Source], terminal: Terminal, read: Callable[[Source], Logged]) -> list[Logged]:
    """Read recordings, and print their summaries and notes."""
    recordings = []
    for source in sources:
        with terminal.progress(f"reading {source.file.name}"):
            recordings.append(read(source))
    counts = Counter(note for recording in recordings for note in set(_collect_notes(recording)))
    for source, recording in zip(sources, recordings, strict=True):
        terminal.print(f"{source.file}: {recording.summary}")
        if source.format_source:
            columns = [f"{quantity}={text}" for quantity, text in source.columns.items()]
            options = (f"with its {key}" for key in source.format if key != "columns")
            terminal.print(f"  read as {source.format_source} says: {join_words([*columns, *options])}")
        for note in _collect_notes(recording):
            if counts[note] == 1:
                _print_note(note, terminal)
    for note, count in counts.items():
        if count > 1:
            _print_note(f"{note} ({count} of {len(recordings)} recordings)", terminal)
    return recordings


def _collect_notes(recording: Recording) -> list[str]:
    """Collect the notes of a recording, and a note on the units of a linear axis."""
    sliding = ["the joint slides: position is in metres"] if recording.units.is_prismatic else []
    return [*map(describe_note, recording.notes), *sliding]


def _print_note(note: str, terminal: Terminal) -> None:
    terminal.print(f"  {note}", style="yellow" if note.startswith(WARNING) else None)
