"""Arguments that several commands share, and the files behind them."""

from __future__ import annotations

import argparse
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from estimators.arguments import model_that_moves
from estimators.diagnosis.result import SCHEMA
from estimators.diagnosis.suggestion import Suggestion
from pendulum_env._typing import JSON
from pendulum_env.files import check_output, write_whole
from pendulum_env.lookup import find
from pendulum_env.physics import Model, ModelError, Term, nameable
from pendulum_env.plant import hide, paper_plant, read_parameters
from pendulum_env.reading import DIGITS, LARGE, LARGEST, Unreadable, Value, read_json, shown
from pendulum_env.recording import Recording, Source
from pendulum_env.recording.columns import refuse_unknown_quantity
from pendulum_env.recording.record import WARNING
from pendulum_env.recording.study import format_of, named_twice, read_as, read_sources
from pendulum_env.recording.vocabulary import TOLD
from pendulum_env.servo.drive import KEYS, Drive
from pendulum_env.words import listing, plus_minus
from workbench.mistakes import InputError
from workbench.terminal import Terminal

T = TypeVar("T")
Number = TypeVar("Number", int, float)
Logged = TypeVar("Logged", bound=Recording)
COUPLING = "coupling"  # of two joints: no effect of a pendulum
FORMATS = "CSV, Parquet, NPZ, MATLAB, HDF5, Excel, MCAP or ROS bag"
KINDS = f"{FORMATS}, or a study.toml (several recordings, known loads)"
DRIVEN = f"as preset=xl330,kp=200 or output=duty,kp=0.6,supply=12: {', '.join(KEYS)}"


def argument(convert: Callable[[str], T]) -> Callable[[str], T]:
    """Converter for argparse that hands on the message of a ValueError; argparse itself would drop it."""

    def converted(text: str) -> T:
        try:
            return convert(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return converted


def number(low: float, high: float = LARGE) -> Callable[[str], float]:
    """Converter for argparse: a number from low to high."""
    return _within(float, low, high, f"a number from {low:g} to {high:g}")


def whole(low: int, high: int = 10**DIGITS) -> Callable[[str], int]:
    """Converter for argparse: a whole number from low to high."""
    return _within(int, low, high, f"a whole number from {low} to {high}")


def _within(kind: Callable[[str], Number], low: Number, high: Number, asked: str) -> Callable[[str], Number]:
    def converted(text: str) -> Number:
        with suppress(ValueError):
            if low <= (value := kind(text)) <= high:
                return value
        raise argparse.ArgumentTypeError(f"{shown(text)} should be {asked}")

    return converted


def one_of(kind: str, known: Iterable[str]) -> Callable[[str], str]:
    """Converter for argparse: one of the names that are known."""
    names = dict.fromkeys(known)

    def converted(text: str) -> str:
        find(kind, text, names)
        return text

    return argument(converted)


def take(parser: argparse.ArgumentParser, *options: str, **other: Any) -> None:
    """Declare options that several commands have, see `OPTIONS`, with what is other than there."""
    for name in options:
        parser.add_argument(*(["-v", name] if name == "--verbose" else [name]), **(OPTIONS[name] | other))


def plant_of(arguments: argparse.Namespace) -> Model:
    """The plant that was asked for, with what is hidden in it; raises ModelError if an effect is hidden twice."""
    plant: Model = arguments.theta or paper_plant()
    for text in arguments.effects:
        plant = hide(plant, text)
    return plant


def _effect(text: str) -> str:
    hide(paper_plant(), re.sub("@[^=:]*", "", text, count=1))  # at whatever joint
    return text


def _page(text: str) -> str:
    """Name of a report's file; raises ValueError if it asks for another format than HTML."""
    suffix = Path(text).suffix.lower()
    if suffix not in ("", ".html", ".htm"):
        name = Path(text).with_suffix(".html")
        raise ValueError(f"a report is one HTML page, not {suffix}: name it {name}, a browser prints it to PDF")
    return text


def take_robot(parser: argparse.ArgumentParser, arms: Sequence[str] = (), pendulums: Sequence[str] = ()) -> None:
    """Declare, once all options are, which of them are of an arm, beside those of `ROBOT`, or say nothing of one.

    `cli.parse` refuses these where they do not belong.
    """
    of_arms = [one for one in parser._actions if one.dest in arms or {*one.option_strings} & {*ROBOT[1:]}]
    of_pendulums = [one for one in parser._actions if one.dest in pendulums]
    for action in of_pendulums:
        action.help = f"{action.help} [not with --robot]"
    parser.set_defaults(of_arms=of_arms, of_pendulums=of_pendulums)


def _names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise InputError(f"{shown(text)} should be names of joints with commas between them")
    return names


class Gather(argparse.Action):
    """Option that may be repeated and names several things: all are gathered in one dictionary."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Add to what was named before."""
        setattr(namespace, self.dest, {**getattr(namespace, self.dest), **values})


def ids(text: str) -> list[str]:
    """Ids of effects in a list with commas, perhaps at joints (`stribeck@elbow`); raises ValueError if one is unknown.

    What follows `coupling@elbow,` is its second joint, as long as it is no effect.
    """
    found: list[str] = []
    for id in filter(None, (word.strip() for word in text.split(","))):
        if found and found[-1].startswith(f"{COUPLING}@") and "," not in found[-1] and "@" not in id:
            found[-1] += f",{id}"
        else:
            found.append(known_effect(id.partition("@")[0]) + "".join(id.partition("@")[1:]))
    return found


def known_effect(id: str, known: Callable[[str], type[Term]] | None = None) -> str:
    """Id of an effect, by default of those that may be named, or of the one that only arms have.

    Raises ValueError if there is none; the message names the nearest.
    """
    return id if id == COUPLING else (find("effect", id, nameable()) if known is None else known(id)).id


def known(text: str) -> dict[str, float]:
    """Values by parameter, of `gravity=2.01,...`; raises ValueError if it is something else."""
    return {name: _bound(value) for name, value in _pairs(text, "NAME=VALUE, such as gravity=2.01")}


def ranges(text: str) -> dict[str, tuple[float, float]]:
    """Bounds by parameter, of `viscous=0:0.5,...`; raises ValueError if it is something else."""
    bounds, asked = {}, "NAME=LOW:HIGH, such as viscous=0:0.5"
    for name, both in _pairs(text, asked):
        low, colon, high = (word.strip() for word in both.partition(":"))
        if not colon:
            raise InputError(f"{shown(f'{name}={both}')} should be {asked}")
        bounds[name] = (_bound(low or "-inf"), _bound(high or "inf"))
    return bounds


def _pairs(text: str, asked: str) -> Iterator[tuple[str, str]]:
    """Names and what is said of each, of `NAME=VALUE,...`; raises InputError, which says what was asked for."""
    for part in text.split(","):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not (name and equals):
            raise InputError(f"{shown(part)} should be {asked}")
        yield name, value


def _bound(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (abs(value) <= LARGE or math.isinf(value)):
        raise InputError(f"{shown(text)} should be a number from {-LARGE:g} to {LARGE:g}, or left out")
    return value


def _drive(text: str) -> Drive:
    """A drive, of `preset=xl330,kp=200`; raises ValueError if it is none."""
    pairs = _pairs(text, "KEY=VALUE, such as kp=200")
    words = ("preset", "control", "output")
    return Drive.of({name: value if name in words else _bound(value) for name, value in pairs})


def _columns(text: str) -> dict[str, str]:
    """What is said of columns, by quantity; a comma is part of a name unless another `QUANTITY=` follows."""
    columns: dict[str, str] = {}
    for part in re.split(r",(?=\s*\w+\s*=)", text):
        quantity, equals, name = (word.strip() for word in part.partition("="))
        if not (quantity and equals and name):
            raise ValueError(
                f"'{part}' should be QUANTITY=NAME:UNIT*GAIN, such as position=ANGLE:deg or torque=current:A*0.091"
            )
        refuse_unknown_quantity(quantity, of_arm=True)
        if quantity in columns:
            raise ValueError(f"{quantity} is named twice in '{text}'")
        columns[quantity] = name
    return columns


# Options that several commands have, as `add_argument` takes them.
OPTIONS: dict[str, dict[str, Any]] = {
    "model": {"metavar": "MODEL.json", "help": "what identify, diagnose or add wrote with -o"},
    "recordings": {"metavar": "RECORDING", "nargs": "+", "help": f"{KINDS}; fitted jointly"},
    "--effect": {
        "dest": "effects",
        "action": "append",
        "type": argument(_effect),
        "default": [],
        "metavar": "ID[=VALUE,...]",
        "help": "hide an effect: ID alone, ID=VALUE,... in the order of `effects`, or ID:name=value,... "
        "(may be repeated)",
    },
    "--theta": {
        "type": argument(lambda text: paper_plant(read_parameters(text))),
        "metavar": "NAME=VALUE,...",
        "help": "inertia, gravity, viscous, coulomb of the plant, where they differ from the paper's",
    },
    "--holdout": {
        "metavar": "RECORDING",
        "action": "append",
        "default": [],
        "help": "recording to confirm the result on (may be repeated; default: the last 30 %% of each recording)",
    },
    "--columns": {
        "type": argument(_columns),
        "metavar": "QUANTITY=NAME[:UNIT][*GAIN]...,...",
        "help": "columns of time, position, torque, velocity, reference, segment, supply, enabled, temperature and "
        "link_position whose names are not known, with unit and conversion, e.g. time=clock:ms,"
        "position=-motor:deg/6+90,torque=current:A*0.091,velocity=unused; "
        f"units: {'; '.join(TOLD[quantity] for quantity in ('time', 'position', 'velocity', 'torque'))} (default: SI)",
    },
    "--unwrap": {"action": "store_true", "help": "undo jumps of 2 pi in position"},
    "--max-size": {
        "type": number(1.0, 1e6),
        "default": LARGEST / 1e6,
        "metavar": "MB",
        "help": f"largest recording that is read, unpacked (default {LARGEST / 1e6:g} MB)",
    },
    "--drive": {
        "type": argument(_drive),
        "metavar": "KEY=VALUE,...",
        "help": f"the controller that followed the reference, {DRIVEN}; "
        "diagnose, add and compare then simulate the closed loop",
    },
    "--robot": {
        "metavar": "ARM.urdf",
        "help": "recordings are of an arm with these links, URDF or MJCF (needs the extra arms), with columns time, "
        "position_JOINT and torque_JOINT, or numbered",
    },
    "--rotors": {
        "action": "store_true",
        "help": "with --robot: identify the motors' own inertia (default: if the MJCF has any)",
    },
    "--joints": {
        "type": argument(_names),
        "metavar": "A,B,...",
        "help": "with --robot: joints that move (default: all); others, such as a gripper's, are held where the "
        "recording has them, or at zero",
    },
    "--base": {"choices": ("fixed",), "help": "with --robot: fix the floating base of the file"},
    "--no-gravity": {
        "action": "store_true",
        "help": "with --robot: the logged torque is without gravity compensation, which the driver subtracts",
    },
    "--only": {"type": argument(ids), "metavar": "ID,...", "help": "look for these effects only"},
    "--without": {"type": argument(ids), "default": [], "metavar": "ID,...", "help": "do not look for these effects"},
    "--fix": {
        "dest": "fixed",
        "type": argument(known),
        "action": Gather,
        "default": {},
        "metavar": "NAME=VALUE,...",
        "help": "known values of parameters, as gravity=2.01 (may be repeated)",
    },
    "--bound": {
        "dest": "bounds",
        "type": argument(ranges),
        "action": Gather,
        "default": {},
        "metavar": "NAME=LOW:HIGH,...",
        "help": "bounds of parameters, as viscous=0:0.5 or cogging.order=10:14 (may be repeated)",
    },
    "--align": {
        "action": "store_true",
        "help": "correct torque that is logged late or through a low-pass filter",
    },
    "--instruments": {
        "choices": ("reference",),
        "help": "fit the base model with instrumental variables made of the controller's reference: removes the bias "
        "from feedback",
    },
    "--report": {
        "type": argument(_page),
        "metavar": "FILE.html",
        "help": "write a report with plots, one file to share",
    },
    "--verbose": {
        "action": "store_true",
        "help": "print errors, parameters and candidates as tables, and all remarks",
    },
}
READING = ("--columns", "--unwrap", "--max-size")  # how recordings are to be read
ROBOT = ("--robot", "--rotors", "--joints", "--base", "--no-gravity")
LIMITS = ("--fix", "--bound")  # parameters that are known or bounded


@dataclass(frozen=True)
class Given:
    """The recordings that a command was given, still unread."""

    fitted: tuple[Source, ...]
    held_out: tuple[Source, ...]
    files: tuple[str, ...]  # all that must not be written to

    def read_as(self, log_format: Mapping[str, Any], path: str) -> Given:
        """The same, of which a model file says what nobody else did."""

        def known(part: tuple[Source, ...]) -> tuple[Source, ...]:
            return tuple(read_as(source, log_format, path) for source in part)

        return replace(self, fitted=known(self.fitted), held_out=known(self.held_out))


def given(arguments: argparse.Namespace) -> Given:
    """The recordings that the arguments name, alone or in studies.

    Raises InputError if one is named twice, or none is to be fitted, and StudyError if a study makes no sense.
    """
    names, held = list(arguments.recordings), list(getattr(arguments, "holdout", []))
    sources = [source for name in names for source in sources_of(name, arguments)]
    sources += [replace(source, role="holdout") for name in held for source in sources_of(name, arguments)]
    if (twice := named_twice(sources)) is not None:
        raise InputError(f"{twice.file}: is named twice: a recording that is held out must not be fitted as well")
    fitted = tuple(source for source in sources if source.role == "fit")
    if names and not fitted:
        raise InputError(f'{names[0]}: holds every recording out: give one of them role = "fit"')
    held_out = tuple(source for source in sources if source.role == "holdout")
    return Given(fitted, held_out, (*names, *held, *(str(source.file) for source in sources)))


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
