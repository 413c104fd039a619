"""Arguments that several commands share, and the files behind them."""

from __future__ import annotations

import argparse
import json
import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

from estimators.diagnosis import SCHEMA
from estimators.equations import IdentificationError
from estimators.inputs import model_that_moves
from estimators.suggestion import Suggestion
from pendulum_env.files import check_output
from pendulum_env.physics import Model, ModelError
from pendulum_env.plant import hide, paper_plant, read_parameters
from pendulum_env.recording import Recording, RecordingError, read_recording
from pendulum_env.recording.columns import TOLD, refuse_unknown_quantity
from workbench.terminal import Terminal
from workbench.words import enumerate_words

T = TypeVar("T")
Read = Callable[[str | Path], Recording]  # how a file becomes a recording


class InputError(ValueError):
    """A command was asked for something that cannot be; the message is one sentence that says what and why."""


MISTAKES = (InputError, RecordingError, IdentificationError, ModelError, OSError)  # of a user, not of the program


def sentence(mistake: Exception) -> str:
    """A user's mistake in one line."""
    if isinstance(mistake, OSError) and mistake.strerror is not None:
        where = f"{mistake.filename}: " if mistake.filename is not None else ""
        return f"{where}{mistake.strerror}"
    return " ".join(str(mistake).split())


def argument(convert: Callable[[str], T]) -> Callable[[str], T]:
    """Converter for argparse that hands on the message of a ValueError; argparse itself would drop it."""

    def converted(text: str) -> T:
        try:
            return convert(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return converted


def number(low: float, high: float = math.inf) -> Callable[[str], float]:
    """Converter for argparse: a number from low to high."""

    def converted(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high or math.isinf(value):
            allowed = f"a number from {low:g} to {high:g}" if math.isfinite(high) else f"a number, {low:g} or more"
            raise argparse.ArgumentTypeError(f"'{text}' should be {allowed}")
        return value

    return converted


def whole(low: int) -> Callable[[str], int]:
    """Converter for argparse: a whole number, low or more."""

    def converted(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if value < low:
            raise argparse.ArgumentTypeError(f"'{text}' should be a whole number, {low} or more")
        return value

    return converted


def take_plant(parser: argparse.ArgumentParser) -> None:
    """Declare the plant of a simulation: see `plant_of`."""
    parser.add_argument(
        "--effect",
        dest="effects",
        action="append",
        type=argument(_effect),
        default=[],
        metavar="ID[=VALUE,...]",
        help="hide an effect: ID alone, ID=VALUE,... in the order that `effects` lists, or ID:name=value,... "
        "(may be repeated)",
    )
    parser.add_argument(
        "--theta",
        type=argument(_theta),
        metavar="NAME=VALUE,...",
        help="inertia, gravity, viscous, coulomb of the plant, where they differ from the paper's",
    )


def plant_of(arguments: argparse.Namespace) -> Model:
    """The plant that was asked for, with what is hidden in it.

    Raises:
        ModelError: if an effect is hidden twice.
    """
    plant: Model = arguments.theta or paper_plant()
    for text in arguments.effects:
        plant = hide(plant, text)
    return plant


def _effect(text: str) -> str:
    hide(paper_plant(), text)
    return text


def _theta(text: str) -> Model:
    return paper_plant(read_parameters(text))


def take_recordings(parser: argparse.ArgumentParser, *, holdout: bool = False) -> None:
    """Declare recordings to read, and perhaps recordings to hold out."""
    parser.add_argument(
        "recordings", metavar="RECORDING", nargs="+", help="CSV, CSV.GZ, Parquet or NPZ; fitted jointly"
    )
    if holdout:
        parser.add_argument(
            "--holdout",
            metavar="RECORDING",
            action="append",
            default=[],
            help="confirm on this one (may be repeated); without it, the last 30 %% of each recording are held out",
        )
    take_reading(parser)


def take_reading(parser: argparse.ArgumentParser) -> None:
    """Declare how recordings are to be read: see `reader`."""
    parser.add_argument(
        "--columns",
        type=argument(_columns),
        metavar="QUANTITY=NAME[:UNIT],...",
        help="which columns are time, position, torque and velocity where their names do not tell, e.g. "
        f"time=clock:ms,position=ANGLE:deg,torque=TAU; units: {'; '.join(TOLD.values())} (default: SI)",
    )
    parser.add_argument("--unwrap", action="store_true", help="undo jumps of 2 pi in position")


def reader(arguments: argparse.Namespace) -> Read:
    """How the arguments ask for recordings to be read."""
    return partial(read_recording, unwrap=arguments.unwrap, columns=arguments.columns)


def _columns(text: str) -> dict[str, str]:
    """Names of columns by quantity; a comma is part of a name unless another `QUANTITY=` follows."""
    columns: dict[str, str] = {}
    for part in re.split(r",(?=\s*\w+\s*=)", text):
        quantity, equals, name = (word.strip() for word in part.partition("="))
        if not (quantity and equals and name):
            raise ValueError(f"'{part}' should be QUANTITY=NAME or QUANTITY=NAME:UNIT, such as position=ANGLE:deg")
        refuse_unknown_quantity(quantity)
        if quantity in columns:
            raise ValueError(f"{quantity} is named twice in '{text}'")
        columns[quantity] = name
    return columns


def read_recordings(paths: Sequence[str], read: Read, terminal: Terminal) -> list[Recording]:
    """Read recordings and say what they are and what was changed at reading."""
    recordings = []
    for path in paths:
        recording = read(path)
        terminal.say(f"{path}: {recording.summary}")
        for note in recording.notes:
            terminal.say(f"  {note}")
        recordings.append(recording)
    return recordings


def keep_apart(recordings: Sequence[str], holdout: Sequence[str]) -> None:
    """Refuse recordings that are named twice: what is held out must not be fitted.

    Raises:
        InputError: if a file is named twice.
    """
    places = [Path(name).resolve() for name in (*recordings, *holdout)]
    for name, place in zip((*recordings, *holdout), places, strict=True):
        if places.count(place) > 1:
            raise InputError(f"{name}: is named twice: a recording that is held out must not be fitted as well")


def read_model(path: str) -> Model:
    """Read a model that can be compared with recordings: one with inertia.

    Raises:
        ModelError: if there is none in the file.
    """
    model = Model.load(path)
    try:
        return model_that_moves(model)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


def read_suggestion(path: str) -> Suggestion:
    """Read the experiment that a diagnosis suggests.

    Raises:
        InputError: if the file is missing or no diagnosis, or nothing is open that an experiment would settle.
    """
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError:
        data = None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise InputError(f"{path}: is not a diagnosis, which is what `diagnose --json` writes")
    if data.get("suggestion") is None:
        if data.get("forbidden"):
            raise InputError(f"{path}: {data['forbidden']}")
        pairs = data.get("inseparable") or []
        why = f", and no torque tells {' from '.join(map(str, pairs[0]))}" if pairs else ""
        raise InputError(f"{path}: this diagnosis leaves nothing open that an experiment would settle{why}")
    try:
        return Suggestion.from_json(data["suggestion"])
    except ValueError as error:
        raise InputError(f"{path}: its suggestion cannot be played: {error}") from None


def check_outputs(outputs: Sequence[str | None], inputs: Sequence[str] = ()) -> None:
    """Refuse, before any work is done, what could not be written in the end, or would destroy data.

    Raises:
        InputError: if two outputs are the same file, or one of them is a recording that is read.
        OSError: if a file cannot be written there.
    """
    given = [check_output(path) for path in outputs if path is not None]
    resolved = [path.resolve() for path in given]
    for path, place in zip(given, resolved, strict=True):
        if place in {Path(name).resolve() for name in inputs}:
            raise InputError(f"{path}: is one of the inputs: name another file to write to")
        if resolved.count(place) > 1:
            raise InputError(f"{path}: is named for two outputs: name two files")


def wrote(paths: Sequence[str | Path | None], terminal: Terminal) -> None:
    """Say what was written."""
    written = [str(path) for path in paths if path is not None]
    if written:
        terminal.say(f"\nwrote {enumerate_words(written)}")
