"""What commands read and write, and what they say of it."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from estimators.arguments import model_that_moves
from estimators.diagnosis.result import SCHEMA
from estimators.diagnosis.suggestion import Suggestion
from pendulum_env._typing import JSON
from pendulum_env.files import check_output, write_whole
from pendulum_env.physics import Model, ModelError
from pendulum_env.plant import hide, paper_plant
from pendulum_env.reading import Unreadable, Value, read_json
from pendulum_env.recording import Recording, Source
from pendulum_env.recording.record import WARNING
from pendulum_env.recording.study import format_of, named_twice, read_sources
from pendulum_env.words import listing, plus_minus
from workbench.mistakes import InputError
from workbench.terminal import Terminal

Logged = TypeVar("Logged", bound=Recording)


def plant_of(arguments: argparse.Namespace) -> Model:
    """The plant that was asked for, with what is hidden in it; raises ModelError if an effect is hidden twice."""
    plant: Model = arguments.theta or paper_plant()
    for text in arguments.effects:
        plant = hide(plant, text)
    return plant


def given(arguments: argparse.Namespace, outputs: Sequence[str | None] = ()) -> tuple[Source, ...]:
    """The recordings that the arguments name, alone or in studies, still unread: first those that are fitted.

    Raises InputError if one is named twice, or none is to be fitted, StudyError if a study makes no sense, and as
    `check_outputs`, of outputs that would destroy what is read.
    """
    names, held = list(arguments.recordings), list(getattr(arguments, "holdout", []))
    sources = [source for name in names for source in sources_of(name, arguments)]
    sources += [replace(source, role="holdout") for name in held for source in sources_of(name, arguments)]
    if (twice := named_twice(sources)) is not None:
        raise InputError(f"{twice.file}: is named twice: a recording that is held out must not be fitted as well")
    sources.sort(key=lambda source: source.role == "holdout")
    if names and sources[0].role == "holdout":
        raise InputError(f'{names[0]}: holds every recording out: give one of them role = "fit"')
    check_outputs(outputs, [*names, *held, *filter(None, [arguments.robot]), *(str(source.file) for source in sources)])
    return tuple(sources)


def sources_of(name: str, arguments: argparse.Namespace) -> tuple[Source, ...]:
    """The recordings of a study, or the one in a file, read as the arguments ask for.

    Raises InputError if arguments say what a study says itself, and StudyError if a study makes no sense.
    """
    largest, drive = 1e6 * arguments.max_size, getattr(arguments, "drive", None)  # not every command takes one
    if not name.lower().endswith(".toml"):
        return (
            Source(Path(name), columns=arguments.columns or {}, unwrap=arguments.unwrap, drive=drive, largest=largest),
        )
    if arguments.columns or arguments.unwrap or drive:
        raise InputError(f"{name}: says itself how its recordings are read: write columns, unwrap and drive there")
    return tuple(replace(source, largest=largest) for source in read_sources(name))


def read_all(sources: Sequence[Source], terminal: Terminal, read: Callable[[Source], Logged]) -> list[Logged]:
    """Read recordings, of one joint or of several, and say what they are and what was changed at reading."""
    recordings = []
    for source in sources:
        with terminal.progress(f"reading {source.file.name}"):
            recording = read(source)
        terminal.say(f"{source.file}: {recording.summary}")
        if source.said_by:
            terminal.say(f"  read as {source.said_by} says: {format_told(source)}")
        for note in recording.notes:
            terminal.say(f"  {note}", style="yellow" if note.startswith(WARNING) else None)
        if recording.origin is not None and recording.origin.slides:
            terminal.say(
                "  an axis that slides: read kg for kg m^2, N for N m and m for rad; --robot tells it so itself"
            )
        recordings.append(recording)
    return recordings


def format_told(source: Source) -> str:
    """How a source is read, in a line."""
    columns = [f"{quantity}={text}" for quantity, text in source.columns.items()]
    return listing([*columns, *(f"with its {key}" for key in source.format if key != "columns")])


def read_model(path: str) -> Model:
    """Read a model that can be compared with recordings: one with inertia.

    Raises ModelError if there is none in the file.
    """
    model = Model.load(path)
    try:
        return model_that_moves(model)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


def read_suggestion(path: str) -> Suggestion:
    """Read the experiment that a diagnosis suggests.

    Raises InputError if the file is missing or no diagnosis, or nothing is open that an experiment would settle.
    """
    hint = "a diagnosis is what `diagnose --json` writes"
    content = read_json(path, hint)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError(f"{path}: is not a diagnosis; {hint}")
    data = Value("the diagnosis", "", content)
    try:
        suggestion, forbidden, pairs = (data.get(key) for key in ("suggestion", "forbidden", "inseparable"))
        if suggestion is None:
            if forbidden is not None:
                raise InputError(f"{path}: {forbidden.text(1000)}")
            groups = [[effect.text() for effect in group.items(100)] for group in (pairs.items() if pairs else [])]
            why = f", and no torque tells {' from '.join(groups[0])}" if groups else ""
            raise InputError(f"{path}: this diagnosis leaves nothing open that an experiment would settle{why}")
    except Unreadable as error:
        raise InputError(f"{path}: {error}") from None
    try:
        return Suggestion.of(suggestion)
    except Unreadable as error:
        raise InputError(f"{path}: its suggestion cannot be played: {error}") from None


def check_outputs(outputs: Sequence[str | None], inputs: Sequence[str] = ()) -> None:
    """Refuse, before any work is done, what could not be written in the end, or would destroy data.

    Raises InputError if two outputs are the same file, or one of them is a recording that is read, and OSError if a
    file cannot be written there.
    """
    given = [check_output(path) for path in outputs if path is not None]
    resolved = [os.path.realpath(path) for path in given]  # unlike Path.resolve, also of links that go round
    for path, place in zip(given, resolved, strict=True):
        if place in map(os.path.realpath, inputs):
            raise InputError(f"{path}: is one of the inputs: name another file to write to")
        if resolved.count(place) > 1:
            raise InputError(f"{path}: is named for two outputs: name two files")


def write_model(model: Model, path: str | None, fitted: Sequence[Source], terminal: Terminal) -> str | None:
    """Write a model if that was asked for, and give its path; one that no command could read again is not written.

    How the recordings were read that it was fitted to stands in it.

    No body is without inertia, but where a motion hardly tells it, a fit may come out so.
    """
    inertia = model.estimates.get("inertia")
    if path is not None and inertia is not None and inertia.value <= 0:
        old = ", what is there is that of before" if Path(path).is_file() else ""
        terminal.say(
            f"warning: {path} is not written{old}: inertia came out as {plus_minus(inertia.value, inertia.std)} "
            f"{inertia.unit}, and no body has that: record a livelier motion, or say --fix inertia=VALUE",
            style="yellow",
        )
        return None
    if path is not None:
        replace(model, log_format=format_of(fitted)).save(path)
    return path


def write_json(path: str | None, content: JSON) -> None:
    """Write plain data for programs, if that was asked for."""
    if path is not None:
        write_whole(path, json.dumps(content, indent=1) + "\n")


def wrote(paths: Sequence[str | Path | None], terminal: Terminal) -> None:
    """Say what was written."""
    written = [str(path) for path in paths if path is not None]
    if written:
        terminal.say(f"\nwrote {listing(written)}")
