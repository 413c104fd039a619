"""Commands of an arm: what `record`, `identify`, `compare`, `diagnose` and `add` do where `--robot` names its links."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from estimators.arms.excitation import PERIOD, design_excitation
from estimators.arms.following import follow
from estimators.arms.gains import in_torque, without_loads
from estimators.arms.payload import Payload, find_payload
from estimators.arms.standard import nearest_body
from estimators.arms.transmission import find_transmissions
from estimators.comparison import compare as compare_models
from estimators.diagnosis.addition import add as add_effect
from estimators.diagnosis.arm import parted
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.run import diagnose as diagnose_model
from estimators.regression.equations import IdentificationError
from estimators.schemes.identification import Identification
from estimators.schemes.identification import identify as identify_terms
from estimators.selection.data import Errors, Step
from estimators.show.story import Part, judged
from pendulum_env.arms.body import Body, BodyError
from pendulum_env.arms.env import PlanarArm, SimulatedArm, SpatialArm
from pendulum_env.arms.joints import arm_base, kind_at
from pendulum_env.arms.model import ArmModel, Asked
from pendulum_env.arms.plane import planar_links
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.excitation import MOST_TORQUE
from pendulum_env.files import write_whole
from pendulum_env.reading import LARGE
from pendulum_env.recording import write_recording
from pendulum_env.recording.record import NEWTON_METRE, TorqueConstant
from pendulum_env.recording.study import Source, read_as
from pendulum_env.words import Table, listing, parameters_table, plus_minus
from workbench.export.joints import FORMATS
from workbench.export.request import Request
from workbench.inputs import check_outputs, given, read_all, sources_of, write_json, write_model, wrote
from workbench.mistakes import InputError
from workbench.robot import RobotFile, held_text, loaded_text, meaning, straying
from workbench.story import ALL, Story, parameters_line, tell
from workbench.terminal import Terminal

SAVED = "filtered_dynamic"  # whose model is written, or the base model
TIMES = "errors, times the least"  # a row that tells which schemes to trust
TRUST = f"{TIMES}: how large a scheme's standard errors are beside the smallest, trust those near 1"
STEP_RATE = 1000.0  # [Hz], of the simulator's steps at least


def record(
    arguments: argparse.Namespace, seconds: float, samples: int, rng: np.random.Generator, terminal: Terminal
) -> None:
    """Design a motion, let the simulated arm follow it, and write what it did."""
    _refuse(arguments)
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


def identify(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print base parameters and friction as each scheme finds them."""
    outputs = [arguments.json, arguments.output]
    asked = _given(arguments, outputs, terminal)
    body = asked.body
    with terminal.progress("identifying"):
        found = identify_terms(asked.recordings, arm_base(body), arguments.scheme)
    terminal.say(f"{body.name}: {len(body.joints)} joints, {len(body.base)} base parameters")
    for parameter in body.base:
        if len(parameter.parts) > 1:
            terminal.say(f"  {parameter.name} stands for {parameter.text}")
    chosen = found.schemes.get(SAVED, next(iter(found.schemes.values())))
    nearest = nearest_body(chosen.model)
    warnings = [f"warning: {doubt.text}" for doubt in found.doubts]
    trust = [TRUST] * (len(found.schemes) > 1)
    content: list[Table | str | tuple[str, ...]] = [
        schemes_table(found),
        *trust,
        *warnings,
        f"{chosen.scheme}: {nearest.text}",
    ]
    tell([Part("Estimates ± standard errors", content)], terminal)
    write_json(arguments.json, found.json() | {"nearest_body": nearest.json()})
    write_model(chosen.model, arguments.output, asked.fitted, terminal)
    wrote(outputs, terminal)


def compare(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print how far the torque of a model is from recordings, joint by joint."""
    if arguments.without and arguments.payload is None:
        raise InputError("--without is of the arm without its payload: say --payload, too")
    outputs = [arguments.json, arguments.report]
    asked = _given(arguments, outputs, terminal, arguments.model)
    recordings, model = [*asked.recordings, *asked.held], ArmModel.load(arguments.model, asked.body)
    without = [source for name in arguments.without for source in sources_of(name, arguments)]
    sources = [read_as(source, model.log_format, arguments.model) for source in without]
    empty = read_all(sources, terminal, asked.robot.read)
    with terminal.progress("comparing"):
        found, carried = compare_models(model, recordings), None
        try:
            carried = find_payload(model, recordings, empty, arguments.payload or None)
        except IdentificationError:
            if arguments.payload is not None:
                raise
    if arguments.report is not None:
        from workbench.report.arm import render_arm  # plotly takes a while to import

        with terminal.progress("writing the report"):
            write_whole(arguments.report, render_arm(recordings, [Step(None, model, {"holdout": found.joint.errors})]))
    content = found.json()
    table = errors_table([found.joint.errors], asked.body, ("torque error",))
    tell([Part("Torque errors, clear of stick and reversals", [table])], terminal)
    if carried is not None and arguments.payload is not None:
        tell(of_payload(carried, asked.body), terminal)
        content["payload"] = carried.json()
    elif carried is not None and carried.stands_out:
        mass = carried.estimates["m"].text
        terminal.say(f"\nA payload of {mass} kg behind {carried.joint} would explain most of it: see --payload")
    write_json(arguments.json, content)
    wrote(outputs, terminal)


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


def diagnose(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print which effects are missing at which joints."""
    outputs = [arguments.json, arguments.report, arguments.output]
    asked = _given(arguments, outputs, terminal, arguments.model)
    body, recordings, held = asked.body, asked.recordings, asked.held
    terms = ArmModel.load(arguments.model, body).terms if arguments.model else arm_base(body)
    with terminal.progress("diagnosing") as progress:
        found = diagnose_model(recordings, held, terms, progress, only=arguments.only, without=arguments.without)
        between = find_transmissions(recordings, body.sliding)
    more = {"transmissions": [one.json() for one in between]} if between else {}
    write_json(arguments.json, found.json() | more)
    write_model(found.model, arguments.output, asked.fitted, terminal)
    if arguments.report is not None:
        from workbench.report.arm import render_arm  # plotly takes a while to import

        with terminal.progress("writing the report"):
            write_whole(arguments.report, render_arm(parted(recordings, held)[0], found.steps, found))
    for one in between:
        terminal.say(one.text)
    story(found, arguments.all).tell(terminal, arguments.verbose or arguments.all, more=arguments.report is None)
    wrote(outputs, terminal)


def add(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Refit a model without and with one more effect at a joint."""
    outputs = [arguments.output]
    asked = _given(arguments, outputs, terminal, arguments.model)
    model = ArmModel.load(arguments.model, asked.body)
    kind_at(arguments.effect, asked.body)
    with terminal.progress(f"adding {arguments.effect}") as progress:
        added = add_effect(model, arguments.effect, asked.recordings, asked.held, progress)
    after = added.after.model
    write_model(after, arguments.output, asked.fitted, terminal)
    fitted, unseen = (
        errors_table([step.errors[part] for step in (added.before, added.after)], asked.body)
        for part in ("train", "holdout")
    )
    where = "Torque errors on {} data, the model refitted without and with the effect".format
    remarks = [text for text in (added.text, added.looks_like) if text is not None]
    parts = [Part(where("fitted"), [fitted]), Part(where("held-out"), [unseen, *remarks])]
    tell([*parts, Part("Parameters", [parameters_table(after)])], terminal)
    wrote(outputs, terminal)


def export(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Write a model as MuJoCo's XML or as a robot description."""
    _refuse(arguments)
    if arguments.to not in FORMATS:
        raise InputError(f"an arm is exported to {listing(list(FORMATS))}, not to {arguments.to}")
    check_outputs([arguments.output], [arguments.model, arguments.robot])
    made = Asked.of_model(arguments.model)
    body = _robot(arguments, replace(made, joints=arguments.joints or made.joints)).body(made.held)
    found = FORMATS[arguments.to](ArmModel.load(arguments.model, body), Request(arguments.approximate, arguments.step))
    if arguments.output is None:
        sys.stdout.write(found.content)
        return
    write_whole(arguments.output, found.content)
    for note in found.notes:
        terminal.say(note, style="yellow")
    wrote([arguments.output], terminal)


def schemes_table(found: Identification) -> Table:
    """A row a parameter, a column a scheme."""
    models = [one.model.estimates for one in found.schemes.values()]
    rows = [(name, *(own[name].text for own in models), one.unit) for name, one in models[0].items()]
    rows.append(("condition", *(f"{one.condition:.3g}" for one in found.schemes.values()), ""))
    if len(models) > 1:
        errors = np.array([[one.std for one in own.values()] for own in models])
        times = np.median(errors / np.maximum(errors.min(axis=0), 1e-300), axis=1)
        rows.append((TIMES, *(f"{own:.2g}" for own in times.tolist()), ""))
    return Table(("parameter", *found.schemes, "unit"), rows, left=("unit",))


def errors_table(columns: Sequence[Errors], body: Body, headers: Sequence[str] = ("before", "after")) -> Table:
    """A row a joint: torque errors of one or more models, and the share of the torque that the last one leaves."""
    rows = [
        (
            at,
            *(f"{errors.joints[at]:.4g}" for errors in columns),
            body.worded(at, NEWTON_METRE),
            "" if share is None else f"{100 * share:.2g} %",
        )
        for at, share in columns[-1].shares.items()
    ]
    return Table(("joint", *headers, "unit", "of its torque"), rows, left=("unit",))


def story(found: Diagnosis, every: bool = False) -> Story:
    """A diagnosis of an arm, with the candidates that matter or every one."""
    errors, body = [found.steps[k].errors["holdout"] for k in (0, -1)], found.body
    assert body is not None
    before, after, in_units = errors[0].joints, errors[1].joints, body.worded
    falls = ", ".join(
        f"{at} {f'{before[at]:.4g} -> ' if found.selected else ''}{after[at]:.4g} {in_units(at, NEWTON_METRE)}"
        for at in after
    )
    lines = [f"{own.id}: {own.law}" for own in found.model.terms if own.id in found.selected]
    parameters = {name: own for id in found.selected for name, own in found.model.of(id).items()}
    lines += [f"error held out: {falls}", *parameters_line(parameters, bool(found.unexplained))]
    for region in found.unexplained:
        where = f"; {in_units(region.at, region.text)}" if region.text else ""
        lines.append(f"left: {found.left[region.at]:.2g} {in_units(region.at, NEWTON_METRE)} at {region.at}{where}")
    parts = [
        Part("Torque errors on held-out data, clear of stick and reversals", [errors_table(errors, body)]),
        Part("Parameters", [parameters_table(found.model)]),
        judged(found.candidates, every, ALL),
    ]
    return Story(found.headline, [*lines, *found.remarks], found.next_step, parts)


@dataclass(frozen=True)
class _Given:
    """The arm that a command was given, with recordings to fit and to hold out."""

    robot: RobotFile
    body: Body
    recordings: list[ArmRecording]
    held: list[ArmRecording]
    fitted: tuple[Source, ...]


def _given(
    arguments: argparse.Namespace, outputs: Sequence[str | None], terminal: Terminal, model: str | None = None
) -> _Given:
    _refuse(arguments)
    asked = given(arguments)
    check_outputs(outputs, [*asked.files, arguments.robot])
    made = Asked.of_model(model) if model else Asked()
    asked = asked.read_as(made.log_format, model or "")
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
    return _Given(robot, body, fitted, held_out, tuple(_with_gains(source, torques.gains) for source in asked.fitted))


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


def _refuse(arguments: argparse.Namespace) -> None:
    """Refuse options that say nothing of an arm."""
    for option in arguments.of_pendulums:
        if getattr(arguments, option) not in (None, False, {}):
            name = {"fixed": "fix", "bounds": "bound"}.get(option, option.replace("_", "-"))
            raise InputError(f"--{name} is for pendulums: leave it out with --robot")
