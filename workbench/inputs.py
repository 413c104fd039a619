"""Input and output of commands, for a pendulum or an arm (`--robot`)."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from estimators.arguments import check_model
from estimators.data.calibration import convert_to_model_unit
from estimators.data.fit_data import FitData
from estimators.free_swings import find_known_values
from pendulum_env.arms.joints import arm_base
from pendulum_env.arms.model import ArmModel, ModelOptions, load_model
from pendulum_env.physics import PENDULUM, Mechanism, Model, ModelError
from pendulum_env.physics.limits import collect_limits
from pendulum_env.recording import Recording, Source
from pendulum_env.recording.study import apply_log_format
from workbench.narrator import describe
from workbench.narrator.findings import describe_late
from workbench.reading import read_all, read_source_names
from workbench.robot import make_robot, report_held
from workbench.terminal import Terminal


def read_model(path: str, body: Mechanism = PENDULUM) -> Model:
    """Read a model that can be compared with recordings of a body: one with inertia.

    Raises ModelError if there is none in the file.
    """
    model = load_model(path, body)
    try:
        return check_model(model)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


@dataclass(frozen=True)
class Inputs:
    """Input of a command after reading."""

    model: Model  # that is named, or else one without parameters to start from
    recordings: list[Recording]  # to fit
    holdout: list[Recording]  # to hold out
    read: Callable[[Source], Recording] = Source.read  # how another recording is read

    @property
    def body(self) -> Mechanism:
        """Return the links of an arm; None of a pendulum."""
        return self.model.body

    def read_more(self, names: Sequence[str], arguments: argparse.Namespace, terminal: Terminal) -> list[Recording]:
        """Read other recordings, or studies of them, in the format that the model knows."""
        sources = [source for name in names for source in read_source_names(name, arguments)]
        known = [apply_log_format(source, self.model.log_format, arguments.model) for source in sources]
        return read_all(known, terminal, self.read)

    def convert(self, terminal: Terminal, align: bool) -> FitData:
        """Convert torque into the unit of the model that is named, and report its timing."""
        if not self.body.can_simulate:
            return self.calibrate(terminal, align)
        converted = convert_to_model_unit(self.model, [*self.recordings, *self.holdout])
        return report_timing(FitData(converted), align, terminal)

    def calibrate(
        self, terminal: Terminal, align: bool | None = None, fixed: Mapping[str, float] | None = None
    ) -> FitData:
        """Calibrate torque by known loads or known values, and report its timing."""
        known = find_known_values(self.model.terms) | dict(fixed or {})
        given = FitData.from_recordings(self.recordings, self.holdout, self.model.terms, known=known)
        for finding in given.conventions:
            terminal.say(describe(finding))
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
    recordings = read_all([source for source in sources if holdout or source.role == "fit"], terminal, Source.read)
    n_fitted = sum(source.role == "fit" for source in sources)
    for name, (low, high) in collect_limits(model.terms).items():
        range_text = f"is fixed at {low:g}" if low == high else f"lies from {low:g} to {high:g}"
        terminal.say(f"{path}: {name} {range_text}, as given when the model was fitted")
    return Inputs(model, recordings[:n_fitted], recordings[n_fitted:])


def report_timing(given: FitData, align: bool | None, terminal: Terminal) -> FitData:
    """Say the torque constant if it is known, else we speak of currents; say what is logged late, and correct it.

    With `align`, torque that is logged late or filtered is corrected, else only said; with None, or where a controller
    asked for it, it is not tested.
    """
    if given.constant is not None:
        terminal.say(given.constant.text)
    align = align if all(recording.has_logged_torque for recording in given.recordings) else None
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
    n_fitted = sum(source.role == "fit" for source in sources)
    return Inputs(model, [*recordings[:n_fitted]], [*recordings[n_fitted:]], robot.read)


def make_body(arguments: argparse.Namespace) -> Mechanism:
    """Make the robot that the arguments name, its joints as in their model, or else the pendulum.

    Raises:
        ModelError, BodyError: as `RobotFile.body`.
    """
    if arguments.robot is None:
        return PENDULUM
    made = ModelOptions.read_from_model(arguments.model) if arguments.model else ModelOptions()
    return make_robot(arguments, made=made).body(made.held)
