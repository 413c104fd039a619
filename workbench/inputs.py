"""Models and recordings that the arguments of a command name, for a pendulum or an arm (`--robot`)."""

import argparse
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from estimators.arguments import check_model
from estimators.data.calibration import convert_to_model_unit
from estimators.data.fit_data import FitData
from estimators.data.preparation import find_preparation
from estimators.decisions.criterion import Criterion
from estimators.free_swings import find_known_values
from pendulum_env.errors import MotionlessError
from pendulum_env.formatting import join_words
from pendulum_env.physics import PENDULUM, Mechanism, Model, ModelError
from pendulum_env.physics.joints import list_base_terms
from pendulum_env.physics.limits import collect_limits
from pendulum_env.physics.model import complete_model, load_model
from pendulum_env.recording import Recording, Source
from pendulum_env.recording.formats import is_there
from pendulum_env.recording.study import apply_log_format, find_duplicate, read_sources
from pendulum_env.robot_file import RobotOptions
from workbench.errors import InputError
from workbench.narrator import describe
from workbench.narrator.findings import describe_timing
from workbench.narrator.notes import WARNING, describe_note
from workbench.outputs import check_outputs
from workbench.robot import make_robot, report_held
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
        if not is_there(source.file):
            raise InputError(f"{source.file}: there is no such file: check the path")
    if getattr(arguments, "fixed", {}).get("gravity") == 0.0:
        sources = [replace(source, has_gravity=False) for source in sources]
    sources.sort(key=lambda source: source.role == "holdout")
    if names and sources[0].role == "holdout":
        raise InputError(f'{names[0]}: holds every recording out: give one of them role = "fit"')
    files = [str(source.file) for source in sources]
    check_outputs(outputs, [*names, *holdout, *filter(None, [arguments.robot]), *files])
    return tuple(sources)


def read_source_names(name: str, arguments: argparse.Namespace) -> tuple[Source, ...]:
    """Return the sources of a study or dataset, or of a single file, with the columns of the arguments.

    Raises InputError if the arguments set columns, unwrap or drive for a study, and StudyError if it is invalid.
    """
    drive = getattr(arguments, "drive", None)  # not an option of every command
    if not name.lower().endswith(".toml"):
        return Source(Path(name), columns=arguments.columns or {}, unwrap=arguments.unwrap, drive=drive).expand()
    if arguments.columns or arguments.unwrap or drive:
        raise InputError(f"{name}: is a study with reading options of its own: write columns, unwrap and drive there")
    return read_sources(name)


def read_all(
    sources: Sequence[Source], terminal: Terminal, read: Callable[[Source], Logged]
) -> list[tuple[Source, Logged]]:
    """Read recordings, and print their summaries and notes; return each with its source.

    A recording of a joint at rest is left out, with a warning, if another one has motion, and is fitted if any is.
    """
    pairs, motionless = [], []
    for source in sources:
        with terminal.progress(f"reading {source.file.name}"):
            try:
                pairs.append((source, read(source)))
            except MotionlessError as error:
                motionless.append(error)
    is_fit = any(source.role == "fit" for source in sources)
    if motionless and not any(source.role == "fit" or not is_fit for source, _ in pairs):
        raise motionless[0]
    for refusal in motionless:
        terminal.print(f"{WARNING}{refusal}; the recording is left out", style="yellow")
    counts = Counter(note for _, recording in pairs for note in dict.fromkeys(_collect_notes(recording)))
    for source, recording in pairs:
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
            _print_note(f"{note} ({count} of {len(pairs)} recordings)", terminal)
    return pairs


def _collect_notes(recording: Recording) -> list[str]:
    """Collect the notes of a recording, and a note on the units of a linear axis."""
    sliding = ["the joint slides: position is in metres"] if recording.units.is_prismatic else []
    return [*map(describe_note, recording.notes), *sliding]


def _print_note(note: str, terminal: Terminal) -> None:
    terminal.print(f"  {note}", style="yellow" if note.startswith(WARNING) else None)


def read_model(path: str, body: Mechanism = PENDULUM) -> Model:
    """Read a model of a body; raises ModelError if the file has no model with inertia."""
    model = load_model(body, path)
    try:
        return check_model(model)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


@dataclass(frozen=True)
class Inputs:
    """Input of a command after reading."""

    model: Model  # from --model, else a model without parameters
    recordings: list[Recording]  # fitted
    holdout: list[Recording]  # held out
    read: Callable[[Source], Recording] = Source.read  # reads further recordings of the same machine

    @property
    def body(self) -> Mechanism:
        """Return the links of an arm, or the pendulum."""
        return self.model.mechanism

    def read_more(self, names: Sequence[str], arguments: argparse.Namespace, terminal: Terminal) -> list[Recording]:
        """Read further recordings or studies in the log format of the model."""
        sources = [source for name in names for source in read_source_names(name, arguments)]
        formatted_sources = [apply_log_format(source, self.model.log_format, arguments.model) for source in sources]
        return [recording for _, recording in read_all(formatted_sources, terminal, self.read)]

    def convert(self, terminal: Terminal, align: bool) -> FitData:
        """Convert torque to the unit of the model, and report its timing."""
        if not self.body.can_simulate:
            return self.calibrate(terminal, align)
        recordings = convert_to_model_unit(self.model, [*self.recordings, *self.holdout])
        return report_timing(FitData(recordings), align, terminal)

    def calibrate(
        self,
        terminal: Terminal,
        align: bool | None = None,
        fixed: Mapping[str, float] | None = None,
        criterion: Criterion = Criterion(),
    ) -> FitData:
        """Calibrate torque by known loads or known values, and report its timing."""
        known_values = find_known_values(self.model.terms) | dict(fixed or {})
        own = self.recordings, self.holdout, self.model.terms
        data = FitData.from_recordings(*own, known=known_values, criterion=criterion)
        for finding in find_preparation(data.all_recordings).list_decisions(data.treatments):
            terminal.print(describe(finding))
        if not self.body.can_simulate:
            align = align or None  # the test is slow for arms: only with --align
        return report_timing(data, align, terminal)


def open_sources(
    arguments: argparse.Namespace, sources: Sequence[Source], terminal: Terminal, holdout: bool = True
) -> Inputs:
    """Read the model, if given, and the recordings in its log format.

    Raises:
        InputError, ModelError, RecordingError; for an arm also BodyError, IdentificationError.
    """
    path = getattr(arguments, "model", None) or ""
    if arguments.robot is not None:
        return _open_arm(arguments, sources, path, terminal)
    model = read_model(path) if path else Model()
    sources = tuple(apply_log_format(source, model.log_format, path) for source in sources)
    pairs = read_all([source for source in sources if holdout or source.role == "fit"], terminal, Source.read)
    for name, (low, high) in collect_limits(model.terms).items():
        range_text = f"is fixed at {low:g}" if low == high else f"lies from {low:g} to {high:g}"
        terminal.print(f"{path}: {name} {range_text}, as given when the model was fitted")
    return Inputs(model, _select_role(pairs, "fit"), _select_role(pairs, "holdout"))


def _select_role(pairs: Sequence[tuple[Source, Logged]], role: str) -> list[Logged]:
    """Return the recordings whose sources have a role."""
    return [recording for source, recording in pairs if source.role == role]


def report_timing(data: FitData, align: bool | None, terminal: Terminal) -> FitData:
    """Print the torque constant and the timing of the torque; return the data, corrected if `align` is true.

    With `align` false, torque that is logged late or filtered is a warning. With None, or without logged torque,
    its timing is not tested.
    """
    if (constant := data.recordings[0].torque_constant) is not None:
        terminal.print(constant.text)
    align = align if all(recording.has_logged_torque for recording in data.recordings) else None
    timed = data if align is None else data.with_timing()
    if align and not timed.timing.has_moved:
        terminal.print("no torque shows to be logged late: taken as it was logged")
    for finding in timed.timing.find(is_late=True):
        text = describe_timing(finding, "It is corrected." if align else "Correct it with --align.")
        terminal.print(text if align else f"warning: {text}", style="yellow")
    return timed if align else data


def _open_arm(arguments: argparse.Namespace, sources: Sequence[Source], path: str, terminal: Terminal) -> Inputs:
    """Read the model, if given, and the recordings of an arm."""
    saved = RobotOptions.read_from_model(path)
    sources = [apply_log_format(source, saved.log_format, path) for source in sources]
    requested = make_robot(arguments, sources, saved)
    robot = requested.keep_logged_joints(sources)
    robot.body()  # report errors in the robot file first
    pairs = read_all(sources, terminal, robot.read)
    recordings = [recording for _, recording in pairs]
    body = robot.body(saved.held) if saved.held else robot.hold_joints(recordings)
    if robot is not requested:
        terminal.print("joints without columns of torque in the log are held; --joints names those that move")
    report_held(robot, body, recordings, terminal)
    model = load_model(body, path) if path else complete_model(body, Model(list_base_terms(body)))
    return Inputs(model, [*_select_role(pairs, "fit")], [*_select_role(pairs, "holdout")], robot.read)


def make_body(arguments: argparse.Namespace) -> Mechanism:
    """Return the robot of the arguments with the joints of their model, or the pendulum without `--robot`.

    Raises ModelError, or BodyError as `RobotFile.body`.
    """
    if arguments.robot is None:
        return PENDULUM
    saved = RobotOptions.read_from_model(arguments.model)
    return make_robot(arguments, saved=saved).body(saved.held)
