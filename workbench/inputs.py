"""Input and output of commands, for a pendulum or an arm (`--robot`)."""

import argparse
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from estimators.arguments import check_model
from estimators.data.fit_data import FitData
from estimators.free_swings import find_known_values
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Links, arm_base
from pendulum_env.arms.model import ArmModel, ModelOptions, load_model
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.formatting import join_words
from pendulum_env.physics import Mechanism, Model, ModelError, Term
from pendulum_env.physics.limits import collect_limits
from pendulum_env.physics.mechanism import PENDULUM
from pendulum_env.plant import hide, paper_plant
from pendulum_env.recording import Recording, Source
from pendulum_env.recording.study import apply_log_format, find_duplicate, read_sources
from workbench.errors import InputError
from workbench.narrator.findings import describe_late
from workbench.narrator.notes import WARNING, describe_note
from workbench.outputs import check_outputs
from workbench.robot import RobotFile, describe_held, find_straying
from workbench.terminal import Terminal

Logged = TypeVar("Logged", bound=Recording)


def make_plant(arguments: argparse.Namespace) -> Model:
    """Make the plant that was asked for, with what is hidden in it; raises ModelError if an effect is hidden twice."""
    plant: Model = arguments.theta or paper_plant()
    for text in arguments.effects:
        plant = hide(plant, text)
    return plant


def list_sources(arguments: argparse.Namespace, outputs: Sequence[str | None] = ()) -> tuple[Source, ...]:
    """List the recordings that the arguments name, alone or in studies, still unread: first those that are fitted.

    Raises InputError if one is named twice, or none is to be fitted, StudyError if a study makes no sense, and as
    `check_outputs`, of outputs that would destroy what is read.
    """
    names, held = list(arguments.recordings), list(getattr(arguments, "holdout", []))
    sources = [source for name in names for source in read_source_names(name, arguments)]
    sources += [replace(source, role="holdout") for name in held for source in read_source_names(name, arguments)]
    if (twice := find_duplicate(sources)) is not None:
        raise InputError(f"{twice.file}: is named twice: a recording that is held out must not be fitted as well")
    sources.sort(key=lambda source: source.role == "holdout")
    if names and sources[0].role == "holdout":
        raise InputError(f'{names[0]}: holds every recording out: give one of them role = "fit"')
    check_outputs(outputs, [*names, *held, *filter(None, [arguments.robot]), *(str(source.file) for source in sources)])
    return tuple(sources)


def read_source_names(name: str, arguments: argparse.Namespace) -> tuple[Source, ...]:
    """Read the recordings of a study, or the one in a file, read as the arguments ask for.

    Raises InputError if arguments say what a study says itself, and StudyError if a study makes no sense.
    """
    drive = getattr(arguments, "drive", None)  # not every command takes one
    if not name.lower().endswith(".toml"):
        return (Source(Path(name), columns=arguments.columns or {}, unwrap=arguments.unwrap, drive=drive),)
    if arguments.columns or arguments.unwrap or drive:
        raise InputError(f"{name}: says itself how its recordings are read: write columns, unwrap and drive there")
    return read_sources(name)


def read_all(sources: Sequence[Source], terminal: Terminal, read: Callable[[Source], Logged]) -> list[Logged]:
    """Read recordings, of one joint or of several, and say what they are and what was changed at reading."""
    recordings = []
    for source in sources:
        with terminal.progress(f"reading {source.file.name}"):
            recordings.append(read(source))
    counts = Counter(note for recording in recordings for note in set(_collect_notes(recording)))
    for source, recording in zip(sources, recordings, strict=True):
        terminal.say(f"{source.file}: {recording.summary}")
        if source.said_by:
            columns = [f"{quantity}={text}" for quantity, text in source.columns.items()]
            others = (f"with its {key}" for key in source.format if key != "columns")
            terminal.say(f"  read as {source.said_by} says: {join_words([*columns, *others])}")
        for note in _collect_notes(recording):
            if counts[note] == 1:
                _print_note(note, terminal)
    for note, count in counts.items():
        if count > 1:
            _print_note(f"{note} ({count} of {len(recordings)} recordings)", terminal)
    return recordings


def _collect_notes(recording: Recording) -> list[str]:
    """Collect the notes of a recording, and one on the units of an axis that slides."""
    sliding = ["the joint slides: position is in metres"] if recording.units.slides else []
    return [*map(describe_note, recording.notes), *sliding]


def _print_note(note: str, terminal: Terminal) -> None:
    terminal.say(f"  {note}", style="yellow" if note.startswith(WARNING) else None)


def read_model(path: str, body: Mechanism = PENDULUM) -> Model:
    """Read a model that can be compared with recordings of a body: one with inertia.

    Raises ModelError if there is none in the file.
    """
    model = load_model(path, body)
    try:
        return check_model(model)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


def read_terms(path: str, body: Mechanism) -> tuple[Term, ...]:
    """Read the terms at the joints of a model, without the links of an arm."""
    return tuple(term for term in read_model(path, body).terms if not isinstance(term, Links))


@dataclass(frozen=True)
class Inputs:
    """Input of a command after reading."""

    model: Model  # that is named, or else one without parameters to start from
    fitted: tuple[Source, ...]  # sources of what is fitted
    recordings: list[Recording]  # to fit
    holdout: list[Recording]  # to hold out
    read: Callable[[Source], Recording] = Source.read  # how another recording is read

    @property
    def body(self) -> Mechanism:
        """Return the links of an arm; None of a pendulum."""
        return self.model.body

    def calibrate(
        self, terminal: Terminal, align: bool | None = None, fixed: Mapping[str, float] | None = None
    ) -> FitData:
        """Calibrate torque by known loads or known values, and report its timing."""
        known = find_known_values(self.model.terms) | dict(fixed or {})
        given = FitData.of(self.recordings, self.holdout, self.model.terms, known=known)
        if not self.body.can_simulate:
            align = align or None  # looking takes long, so none is warned unasked
        return report_timing(given, align, terminal)


def open_sources(
    arguments: argparse.Namespace, sources: Sequence[Source], terminal: Terminal, holdout: bool = True
) -> Inputs:
    """Read the model, if one is named, and recordings in the format it knows.

    Raises:
        InputError, ModelError, RecordingError; of an arm also BodyError, IdentificationError.
    """
    path = getattr(arguments, "model", None) or ""
    if arguments.robot is not None:
        return _open_arm(arguments, sources, path, terminal)
    model = read_model(path) if path else Model()
    sources = tuple(apply_log_format(source, model.log_format, path) for source in sources)
    for source in sources:  # also those that are not read
        if not os.path.exists(source.file):
            raise InputError(f"{source.file}: there is no such file: check the path")
    recordings = read_all([own for own in sources if holdout or own.role == "fit"], terminal, Source.read)
    fitted = tuple(own for own in sources if own.role == "fit")
    print_limits(model, path, terminal)
    return Inputs(model, fitted, recordings[: len(fitted)], recordings[len(fitted) :])


def print_limits(model: Model, path: str, terminal: Terminal) -> None:
    """Print which parameters of a model file are fixed or bounded."""
    for name, (low, high) in collect_limits(model.terms).items():
        range_text = f"is fixed at {low:g}" if low == high else f"lies from {low:g} to {high:g}"
        terminal.say(f"{path}: {name} {range_text}, as given when the model was fitted")


def report_timing(given: FitData, align: bool | None, terminal: Terminal) -> FitData:
    """Say the torque constant if it is known, else we speak of currents; say what is logged late, and correct it.

    With `align`, torque that is logged late or filtered is corrected, else only said; with None, or where a controller
    asked for it, it is not tested.
    """
    if given.constant is not None:
        terminal.say(given.constant.text)
    align = align if all(own.has_logged_torque for own in given.recordings) else None
    timed = given if align is None else given.with_timing()
    if align and not timed.has_moved:
        terminal.say("no torque shows to be logged late: taken as it was logged")
    for finding in timed.find_timing(True):
        text = describe_late(finding, "It is corrected." if align else "Correct it with --align.")
        terminal.say(text if align else f"warning: {text}", style="yellow")
    return timed if align else given


def _open_arm(arguments: argparse.Namespace, sources: Sequence[Source], path: str, terminal: Terminal) -> Inputs:
    """Read the input of a command on an arm."""
    made = ModelOptions.read_from_model(path) if path else ModelOptions()
    sources = [apply_log_format(source, made.log_format, path) for source in sources]
    asked = make_robot(arguments, sources, made)
    robot = asked.keep_logged_joints(sources)
    robot.body()  # what is wrong with it comes first
    recordings = read_all(sources, terminal, robot.read)
    body = robot.body(made.held) if made.held else robot.hold_joints(recordings)
    if robot is not asked:
        terminal.say("joints without columns of torque in the log are held; --joints names those that move")
    report_held(body, recordings, terminal)
    model = ArmModel.load(path, body) if path else ArmModel(arm_base(body))
    fitted = tuple(source for source in sources if source.role == "fit")
    return Inputs(model, fitted, [*recordings[: len(fitted)]], [*recordings[len(fitted) :]], robot.read)


def make_body(arguments: argparse.Namespace) -> Mechanism:
    """Make the robot that the arguments name, its joints as in their model, or else the pendulum.

    Raises:
        ModelError, BodyError: as `RobotFile.body`.
    """
    if arguments.robot is None:
        return PENDULUM
    made = ModelOptions.read_from_model(arguments.model) if arguments.model else ModelOptions()
    return make_robot(arguments, made=made).body(made.held)


def make_robot(
    arguments: argparse.Namespace, sources: Sequence[Source] = (), made: ModelOptions | None = None
) -> RobotFile:
    """Make the robot as the arguments, or else a study or the model that was `made` of it, ask for it."""
    made = made or ModelOptions()  # of a robot, where no model says what it was made of
    named = {arguments.joints, *(source.joints for source in sources)} - {None}
    if len(named) > 1:
        raise InputError("which joints move is told in two ways: say it in one study, or by --joints alone")
    joints, rotors = named.pop() if named else made.joints, True if arguments.rotors else made.rotors
    light = arguments.no_gravity or made.weightless
    return RobotFile(Path(arguments.robot), joints, rotors, light)


def report_held(body: Body, recordings: Sequence[ArmRecording], terminal: Terminal) -> None:
    """Say which joints are held, and where recordings have them elsewhere."""
    if text := describe_held(body):
        terminal.say(text)
    if body.impossible_text:
        terminal.say(f"warning: {body.impossible_text}: only the kinematics of the file are used", style="yellow")
    for text in find_straying(body, recordings):
        terminal.say(f"warning: {text}", style="yellow")
