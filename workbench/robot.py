"""Robot file of the arguments, and texts on its links."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from pendulum_env.physics.mechanism import LinkedMechanism, Mechanism
from pendulum_env.recording import Recording, Source
from pendulum_env.robot_file import RobotFile, RobotOptions, find_link_reader
from workbench.errors import InputError
from workbench.terminal import Terminal

NOTHING_SAVED = RobotOptions()


def open_robot_file(file: Path, model: Path | None, joints: tuple[str, ...] | None) -> RobotFile:
    """Return a robot with the settings in a model file, if given; `joints` has priority."""
    saved = RobotOptions.read_from_model(model)
    return find_link_reader().open(file, joints or saved.joints, saved.rotors, saved.weightless)


def make_robot(
    arguments: argparse.Namespace, sources: Sequence[Source] = (), saved: RobotOptions = NOTHING_SAVED
) -> RobotFile:
    """Make the robot from the arguments, else from the study or from the options `saved` of its model."""
    named = {arguments.joints, *(source.joints for source in sources)} - {None}
    if len(named) > 1:
        raise InputError("the moving joints are given twice: name them in one study, or by --joints alone")
    joints, rotors = named.pop() if named else saved.joints, True if arguments.rotors else saved.rotors
    light = arguments.no_gravity or saved.weightless
    return find_link_reader().open(Path(arguments.robot), joints, rotors, light)


def describe_links(body: Mechanism) -> list[str]:
    """Count the joints and base parameters of an arm, and define the combined ones; empty for a pendulum."""
    if not isinstance(body, LinkedMechanism):
        return []
    combined = [f"  {name} stands for {text}" for name, text in body.combinations.items()]
    return [f"{body.name}: {len(body.joints)} joints, {len(body.base)} base parameters", *combined]


def describe_held(body: LinkedMechanism) -> str:
    """List the held joints with their positions; empty if all move."""
    units = {joint: body.units(joint).unit("rad") for joint in body.held}
    places = [f"{joint} at {f'{q:.4g} {units[joint]}' if q else 'zero'}" for joint, q in body.held.items()]
    return f"held: {', '.join(places)}" if places else ""


def describe_held_joint_motion(robot: RobotFile, body: LinkedMechanism, recordings: Sequence[Recording]) -> list[str]:
    """Describe held joints that leave their position in recordings, a sentence each."""
    return [
        f"{joint} gets {deviation:.2g} {body.units(joint).unit('rad')} away from there in {recording}: name it in "
        "--joints if it moves"
        for joint, deviation, recording in robot.find_held_joint_motion(body, recordings)
    ]


def report_held(robot: RobotFile, body: LinkedMechanism, recordings: Sequence[Recording], terminal: Terminal) -> None:
    """Print the held joints, and warn if they leave their position in recordings."""
    if text := describe_held(body):
        terminal.print(text)
    if body.impossible_text:
        terminal.print(f"warning: {body.impossible_text}: only the kinematics of the file are used", style="yellow")
    for text in describe_held_joint_motion(robot, body, recordings):
        terminal.print(f"warning: {text}", style="yellow")
