"""Robot file with its settings: moving joints, held joints, and their positions in recordings."""

import argparse
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np

from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.recording import Recording, Source
from robots.arms.body import Body, read_body
from robots.arms.model import ModelOptions
from robots.arms.reading import HELD_RANGE, find_logged_joints, read_arm_source
from robots.arms.recording import ArmRecording
from robots.arms.robot import find_movable_joints, import_pinocchio
from workbench.errors import InputError
from workbench.terminal import Terminal

FORMATS = (".urdf", ".xml", ".mjcf")
NOTHING_SAVED = ModelOptions()


@dataclass(frozen=True)
class RobotFile:
    """Robot file and its settings."""

    file: Path  # URDF or MJCF
    joints: tuple[str, ...] | None = None  # moving joints; None: all movable ones
    rotors: bool | None = None  # whether rotor inertia is identified; None: if the file has it
    weightless: bool = False  # whether the driver subtracts gravity from the logged torque

    @classmethod
    def from_model_file(cls, file: Path, model: Path | None, joints: tuple[str, ...] | None) -> "RobotFile":
        """Return a robot with the settings in a model file, if given; `joints` has priority."""
        saved = ModelOptions.read_from_model(model)
        return cls(file, joints or saved.joints, saved.rotors, saved.weightless)

    def body(self, held: Mapping[str, float] | None = None) -> Body:
        """Return the links, with other joints held at the given positions or zero; raises BodyError as `read_body`."""
        import_pinocchio()
        status = self.file.stat() if self.file.exists() else None
        changed = (status.st_mtime_ns, status.st_size) if status else None
        return _read_body(self, tuple((held or {}).items()), changed)

    def keep_logged_joints(self, sources: Sequence[Source]) -> "RobotFile":
        """Return a copy that holds joints without columns in the sources, unless `joints` is set."""
        if self.joints is not None or not sources:
            return self
        all_joints = find_movable_joints(self.file, bolted=True)
        logged = [find_logged_joints(source.file, all_joints, source.columns) for source in sources]
        moving = tuple(joint for joint in all_joints if all(joint in joints for joints in logged))
        return replace(self, joints=moving) if moving and moving != all_joints else self

    def read(self, source: Source) -> ArmRecording:
        """Read a recording of the robot; raises RecordingError as `read_arm_source`."""
        body = self.body()
        return read_arm_source(source, body.joints, [at for at in (*body.held, *body.links) if at not in body.joints])

    def hold_joints(self, recordings: Sequence[Recording]) -> Body:
        """Return the links, with other joints held at their mean position in the recordings."""
        body, arms = self.body(), [recording for recording in recordings if isinstance(recording, ArmRecording)]
        positions = {joint: [np.mean(one.still[joint]) for one in arms if joint in one.still] for joint in body.held}
        return self.body({joint: float(np.mean(places)) for joint, places in positions.items() if places})


@lru_cache(maxsize=8)
def _read_body(robot: RobotFile, held: tuple[tuple[str, float], ...], changed: Hashable) -> Body:
    """Read the links of a file, cached; `changed` holds the time and size of the file."""
    body = read_body(robot.file, joints=robot.joints, held=dict(held), bolted=True, rotors=robot.rotors)
    return body.weightless if robot.weightless else body


def describe_links(body: Mechanism) -> list[str]:
    """Count the joints and base parameters of an arm, and define the combined ones; empty for a pendulum."""
    if not isinstance(body, Body):
        return []
    combined = [f"  {name} stands for {text}" for name, text in body.combinations.items()]
    return [f"{body.name}: {len(body.joints)} joints, {len(body.base)} base parameters", *combined]


def describe_held(body: Body) -> str:
    """List the held joints with their positions; empty if all move."""
    units = {joint: body.units(joint).unit("rad") for joint in body.held}
    places = [f"{joint} at {f'{q:.4g} {units[joint]}' if q else 'zero'}" for joint, q in body.held.items()]
    return f"held: {', '.join(places)}" if places else ""


def find_moving_held_joints(body: Body, recordings: Sequence[Recording]) -> list[str]:
    """Describe held joints that leave their position in recordings, a sentence each."""
    sentences = []
    for recording, (joint, q) in product(recordings, body.held.items()):
        places = recording.still.get(joint, q) if isinstance(recording, ArmRecording) else q
        if (off := np.max(np.abs(places - q))) > HELD_RANGE:
            away = f"{joint} gets {off:.2g} {body.units(joint).unit('rad')} away from there in {recording.name}"
            sentences.append(f"{away}: name it in --joints if it moves")
    return sentences


def make_robot(
    arguments: argparse.Namespace, sources: Sequence[Source] = (), saved: ModelOptions = NOTHING_SAVED
) -> RobotFile:
    """Make the robot from the arguments, else from the study or from the options `saved` of its model."""
    named = {arguments.joints, *(source.joints for source in sources)} - {None}
    if len(named) > 1:
        raise InputError("the moving joints are given twice: name them in one study, or by --joints alone")
    joints, rotors = named.pop() if named else saved.joints, True if arguments.rotors else saved.rotors
    light = arguments.no_gravity or saved.weightless
    return RobotFile(Path(arguments.robot), joints, rotors, light)


def report_held(body: Body, recordings: Sequence[Recording], terminal: Terminal) -> None:
    """Print the held joints, and warn if they leave their position in recordings."""
    if text := describe_held(body):
        terminal.print(text)
    if body.impossible_text:
        terminal.print(f"warning: {body.impossible_text}: only the kinematics of the file are used", style="yellow")
    for text in find_moving_held_joints(body, recordings):
        terminal.print(f"warning: {text}", style="yellow")
