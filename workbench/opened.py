"""What a command was given, read: a model, and recordings of a pendulum or of an arm, whose links `--robot` names."""

import argparse
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from estimators.preprocessing import Preprocessed
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import arm_base, body_of
from pendulum_env.arms.model import ArmModel, Asked
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from pendulum_env.recording.record import TorqueConstant
from pendulum_env.recording.study import Source, read_as
from workbench.inputs import given, read_all, read_model
from workbench.mistakes import InputError
from workbench.robot import Logs, RobotFile, held_text, meaning, straying
from workbench.terminal import Terminal

NOTHING = Asked()  # of a robot, where no model says what it was made of


@dataclass(frozen=True)
class Opened:
    """What a command was given, read."""

    model: Model  # that is named, or else one without parameters to start from
    fitted: tuple[Source, ...]  # sources of what is fitted
    recordings: list[Recording]  # to fit
    holdout: list[Recording]  # to hold out
    read: Callable[[Source], Recording] = Source.read  # how another recording is read

    @property
    def body(self) -> Body | None:
        """The links of an arm; None of a pendulum."""
        return body_of(self.model.terms)

    def preprocessed(self, terminal: Terminal, align: bool | None = None) -> Preprocessed:
        """Recordings in torque where known loads tell the torque constant, see `tell_preprocessed`."""
        if self.body is not None:  # those of an arm are by now
            return Preprocessed(tuple(self.recordings), tuple(self.holdout))
        return tell_preprocessed(Preprocessed.of(self.recordings, self.holdout), align, terminal)


def opened(
    arguments: argparse.Namespace, outputs: Sequence[str | None], terminal: Terminal, holdout: bool = True
) -> Opened:
    """Refuse what could not be written; read the model, if one is named, and recordings in the format it knows.

    Raises:
        InputError, ModelError, RecordingError, StudyError; of an arm also BodyError, IdentificationError.
    """
    sources, path = given(arguments, outputs), getattr(arguments, "model", None) or ""
    if arguments.robot is not None:
        return _opened_arm(arguments, sources, path, terminal)
    model = read_model(path) if path else Model()
    sources = tuple(read_as(source, model.log_format, path) for source in sources)
    for source in sources:  # also those that are not read
        if not os.path.exists(source.file):
            raise InputError(f"{source.file}: there is no such file: check the path")
    recordings = read_all([own for own in sources if holdout or own.role == "fit"], terminal, Source.read)
    fitted = tuple(own for own in sources if own.role == "fit")
    return Opened(model, fitted, recordings[: len(fitted)], recordings[len(fitted) :])


def tell_preprocessed(given: Preprocessed, align: bool | None, terminal: Terminal) -> Preprocessed:
    """Say the torque constant if it is known, else we speak of currents; say what is logged late, and correct it.

    With `align`, torque that is logged late or filtered is corrected, else only said; with None, or where a controller
    asked for it, nobody looks.
    """
    if given.constant is not None:
        terminal.say(given.constant.text)
    terminal.torque_unit = given.unit
    align = align if all(own.has_logged_torque for own in given.recordings) else None
    timed = given if align is None else given.timed()
    for text in timed.timing_texts(True):
        terminal.say(f"{text}: corrected" if align else f"warning: {text}: correct it with --align", style="yellow")
    return timed if align else given


def _opened_arm(arguments: argparse.Namespace, sources: Sequence[Source], path: str, terminal: Terminal) -> Opened:
    """What a command was given of an arm, read: in N m, and without known loads, which tell gains of currents."""
    made = Asked.of_model(path) if path else Asked()
    sources = [read_as(source, made.log_format, path) for source in sources]
    robot = robot_of(arguments, sources, made)
    robot.body()  # what is wrong with it comes first
    recordings = read_all(sources, terminal, robot.read)
    body = robot.body(made.held) if made.held else robot.holding(recordings)
    tell_held(body, recordings, terminal)
    model = ArmModel.load(path, body) if path else ArmModel(arm_base(body))
    held_out = [source.role == "holdout" for source in sources]
    logs = Logs.of(recordings, held_out, body, model.torque_unit if path else None)
    for text in logs.texts:
        terminal.say(text)
    terminal.torque_unit = logs.torques.unit
    for text in meaning(logs.torques.recordings, body):
        terminal.say(f"warning: {text}", style="yellow")
    fitted = tuple(_with_gains(source, logs.torques.gains) for source in sources if source.role == "fit")
    train, unseen = logs.bare
    return Opened(model, fitted, [*train], [*unseen], robot.read)


def read_arm_model(arguments: argparse.Namespace) -> ArmModel:
    """The model of a robot that the arguments name; raises ModelError, BodyError as `RobotFile.body`."""
    made = Asked.of_model(arguments.model)
    return ArmModel.load(arguments.model, robot_of(arguments, made=made).body(made.held))


def _with_gains(source: Source, gains: Mapping[str, TorqueConstant]) -> Source:
    """A source read with the gains of currents that known weights gave, as the next log of the arm has to be."""
    found = {f"torque_{joint}": f"{gain.value:.6g}" for joint, gain in gains.items()}
    columns = {name: text.replace("?", found.get(name, "?")) for name, text in source.columns.items()}
    return replace(source, columns=columns)


def robot_of(arguments: argparse.Namespace, sources: Sequence[Source] = (), made: Asked = NOTHING) -> RobotFile:
    """The robot as the arguments, or else a study or the model that was `made` of it, ask for it."""
    named = {arguments.joints, *(source.joints for source in sources)} - {None}
    if len(named) > 1:
        raise InputError("which joints move is told in two ways: say it in one study, or by --joints alone")
    joints, rotors = named.pop() if named else made.joints, True if arguments.rotors else made.rotors
    light = arguments.no_gravity or made.weightless
    return RobotFile(Path(arguments.robot), joints, arguments.base is not None, rotors, light)


def tell_held(body: Body, recordings: Sequence[ArmRecording], terminal: Terminal) -> None:
    """Say which joints are held, and where recordings have them elsewhere."""
    if text := held_text(body):
        terminal.say(text)
    for text in straying(body, recordings):
        terminal.say(f"warning: {text}", style="yellow")
