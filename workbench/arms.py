"""What commands do of an arm alone, where `--robot` names its links: read and record it, tell a payload, export it."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from estimators.arms.excitation import PERIOD, design_excitation
from estimators.arms.following import follow
from estimators.arms.gains import in_torque, without_loads
from estimators.arms.payload import Payload, find_payload
from estimators.regression.equations import IdentificationError
from estimators.show.story import Part
from pendulum_env.arms.body import Body, BodyError
from pendulum_env.arms.env import PlanarArm, SimulatedArm, SpatialArm
from pendulum_env.arms.joints import arm_base
from pendulum_env.arms.model import ArmModel, Asked
from pendulum_env.arms.plane import planar_links
from pendulum_env.arms.recording import ArmRecording, of_arms
from pendulum_env.excitation import MOST_TORQUE
from pendulum_env.reading import LARGE
from pendulum_env.recording import Recording, write_recording
from pendulum_env.recording.record import NEWTON_METRE, TorqueConstant
from pendulum_env.recording.study import Source, read_as
from pendulum_env.words import Table, listing, plus_minus
from workbench.inputs import Opened, check_outputs, given, read_all, sources_of, wrote
from workbench.mistakes import InputError
from workbench.robot import RobotFile, held_text, loaded_text, meaning, straying
from workbench.terminal import Terminal

STEP_RATE = 1000.0  # [Hz], of the simulator's steps at least


def record(
    arguments: argparse.Namespace, seconds: float, samples: int, rng: np.random.Generator, terminal: Terminal
) -> None:
    """Design a motion, let the simulated arm follow it, and write what it did."""
    refuse(arguments)
    for name, own in (("excitation", ("multisine",)), ("backend", ("pymunk", "mujoco"))):
        if (asked := getattr(arguments, name)) not in (None, *own):
            raise InputError(f"--{name} {asked} is for pendulums: arms know {' and '.join(own)} alone")
    body = _robot(arguments, Asked(arguments.joints)).body()
    _tell_held(body, [], terminal)
    arm = _simulated(arguments, body)
    motion = design_excitation(
        body,
        min(PERIOD, seconds),
        max_angle=arguments.max_angle,
        max_speed=arguments.max_speed,
        max_torque=arguments.amplitude,
        rng=rng,
    )
    with terminal.progress("simulating") as tell:
        recording = follow(arm, motion, samples, arguments.amplitude, rng=rng, name=arguments.output, progress=tell)
    if not (np.abs(recording.position) <= LARGE).all():  # nor NaN
        raise InputError(f"the joints turn by more than {LARGE:g} rad: hide less, or allow less torque")
    write_recording(recording, arguments.output)
    terminal.say(recording.summary)
    terminal.say(
        f"the joints follow a multisine of {motion.period:g} s, condition of the base regressor {motion.condition:.3g}"
    )
    off = np.sqrt(np.mean((motion(recording.time)[0] - recording.position) ** 2, axis=0))
    rows = [
        (
            name,
            f"{joint.position.min():.2f} to {joint.position.max():.2f}{' m' * slides}",
            f"{rms:.2g}{' m' * slides}",
            f"{np.abs(joint.torque).max():.3g}{' N' * slides}",
        )
        for name, joint, rms, slides in zip(recording.names, recording.joints, off.tolist(), body.slides, strict=True)
    ]
    terminal.table(("joint", "angle [rad]", "off its reference [rad]", "largest torque [N m]"), rows)
    if arguments.effects:
        terminal.say(f"hidden: {listing([re.split('[=:]', text)[0] for text in arguments.effects])}")
    wrote([arguments.output], terminal)


def _simulated(arguments: argparse.Namespace, body: Body) -> SimulatedArm:
    """The arm in pymunk if all joints turn in a vertical plane, else, or where that is asked for, in MuJoCo."""
    seen = {"rate": arguments.rate, "counts": arguments.counts, "torque_noise": arguments.noise}
    seen |= {"effects": arguments.effects, "max_torque": MOST_TORQUE}
    if arguments.backend != "mujoco":
        try:
            links = planar_links(body)
            steps = max(1, round(STEP_RATE / arguments.rate))
            # velocities as the controller sees them
            return PlanarArm(links, joints=body.joints, substeps=steps, velocity="ideal", **seen)
        except BodyError:
            if arguments.backend is not None:
                raise
    return SpatialArm(body, **seen)


def carried(
    arguments: argparse.Namespace, asked: Opened, recordings: Sequence[Recording], terminal: Terminal
) -> Payload | None:
    """What the arm carries in recordings beside a model; None where they do not tell and nobody asked."""
    sources = [source for name in arguments.without for source in sources_of(name, arguments)]
    sources = [read_as(own, asked.model.log_format, arguments.model) for own in sources]
    without = of_arms(read_all(sources, terminal, asked.read))
    try:
        return find_payload(asked.model, of_arms(recordings), without, arguments.payload or None)
    except IdentificationError:
        if arguments.payload is not None:
            raise
        return None


def of_payload(found: Payload, body: Body) -> list[Part]:
    """What an arm carries, and what it explains."""
    rows = [(name, one.text, one.unit) for name, one in found.estimates.items()]
    rows += [(f"centre {axis}", one.text, one.unit) for axis, one in zip("xyz", found.center or (), strict=False)]
    content: list[Table | str] = [Table(("parameter", "estimate", "unit"), rows, left=("unit",))]
    if found.hidden:
        content.append(f"{listing(found.hidden)}: no motion of the joints shows them")
    if found.exists is False:
        content.append("no body has these moments: something else changed as well, or the motion says too little")
    left = [(at, f"{old:.4g}", f"{new:.4g}", body.worded(at, NEWTON_METRE)) for at, (old, new) in found.left.items()]
    explained = Table(("joint", "without payload", "with it", "unit"), left, left=("unit",))
    return [
        Part(f"Payload at the link behind {found.joint}, in that joint's frame", content),
        Part("Torque left, friction fitted anew", [explained]),
    ]


def read_arm_model(arguments: argparse.Namespace) -> ArmModel:
    """The model of a robot that the arguments name; raises ModelError, and BodyError as `RobotFile.body`."""
    refuse(arguments)
    made = Asked.of_model(arguments.model)
    body = _robot(arguments, replace(made, joints=arguments.joints or made.joints)).body(made.held)
    return ArmModel.load(arguments.model, body)


def opened_arm(arguments: argparse.Namespace, outputs: Sequence[str | None], terminal: Terminal) -> Opened:
    """What a command was given of an arm, read: in N m, and without known loads, which tell gains of currents.

    Raises:
        BodyError, IdentificationError, InputError, ModelError, RecordingError, StudyError: if something cannot be used.
    """
    refuse(arguments)
    asked, path = given(arguments), getattr(arguments, "model", None) or ""
    check_outputs(outputs, [*asked.files, arguments.robot])
    made = Asked.of_model(path) if path else Asked()
    asked = asked.read_as(made.log_format, path)
    sources = (*asked.fitted, *asked.held_out)
    named = {arguments.joints, *(source.joints for source in sources)} - {None}
    if len(named) > 1:
        raise InputError("which joints move is told in two ways: say it in one study, or by --joints alone")
    robot = _robot(arguments, replace(made, joints=named.pop() if named else made.joints))
    robot.body()  # what is wrong with it comes first
    recordings = read_all(sources, terminal, robot.read)
    body = robot.body(made.held) if made.held else robot.holding(recordings)
    _tell_held(body, recordings, terminal)
    torques = in_torque(recordings, body)
    for joint, gain in torques.gains.items():
        size = f"{plus_minus(gain.value, gain.std)} {body.worded(joint, gain.unit)}"
        terminal.say(f"torque gain of {joint}: {size}, as known loads tell it")
    for text in meaning(torques.recordings, body):
        terminal.say(f"warning: {text}", style="yellow")
    count = len(asked.fitted)
    fitted, held_out = without_loads(torques.recordings[:count], torques.recordings[count:])
    if text := loaded_text(torques.recordings, [*fitted, *held_out]):
        terminal.say(text)
    model = ArmModel.load(path, body) if path else ArmModel(arm_base(body))
    sources = tuple(_with_gains(source, torques.gains) for source in asked.fitted)
    return Opened(model, sources, list(fitted), list(held_out), robot.read)


def _with_gains(source: Source, gains: Mapping[str, TorqueConstant]) -> Source:
    """A source read with the gains of currents that known weights gave, as the next log of the arm has to be."""
    found = {f"torque_{joint}": f"{gain.value:.6g}" for joint, gain in gains.items()}
    columns = {name: text.replace("?", found.get(name, "?")) for name, text in source.columns.items()}
    return replace(source, columns=columns)


def _robot(arguments: argparse.Namespace, made: Asked) -> RobotFile:
    """The robot as the arguments, or else a model or a study, ask for it."""
    rotors = True if arguments.rotors else made.rotors
    light = arguments.no_gravity or made.weightless
    return RobotFile(Path(arguments.robot), made.joints, arguments.base is not None, rotors, light)


def _tell_held(body: Body, recordings: Sequence[ArmRecording], terminal: Terminal) -> None:
    """Say which joints are held, and where recordings have them elsewhere."""
    if text := held_text(body):
        terminal.say(text)
    for text in straying(body, recordings):
        terminal.say(f"warning: {text}", style="yellow")


def refuse(arguments: argparse.Namespace) -> None:
    """Refuse options that say nothing of an arm."""
    for option in arguments.of_pendulums:
        if getattr(arguments, option) not in (None, False, {}):
            name = {"fixed": "fix", "bounds": "bound"}.get(option, option.replace("_", "-"))
            raise InputError(f"--{name} is for pendulums: leave it out with --robot")
