"""Commands of an arm: what `record`, `identify`, `compare`, `diagnose` and `add` do where `--robot` names its links."""

from __future__ import annotations

import argparse
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.arguments import chosen_effects
from estimators.arms.addition import add_arm
from estimators.arms.diagnosis import ArmDiagnosis, diagnose_arm
from estimators.arms.excitation import PERIOD, design_excitation
from estimators.arms.following import follow
from estimators.arms.identification import ArmIdentification, JointError, compare_arm, for_arms, identify_arm
from estimators.show.tables import candidates_table
from pendulum_env.arms.body import Body, read_body
from pendulum_env.arms.env import PlanarArm
from pendulum_env.arms.joints import joint_effects, kind_at
from pendulum_env.arms.model import ArmModel, has_rotors
from pendulum_env.arms.planar import Link
from pendulum_env.arms.plane import planar_links
from pendulum_env.arms.recording import ArmRecording, read_arm_source, write_arm_recording
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.excitation import MOST_TORQUE
from pendulum_env.files import write_whole
from pendulum_env.reading import LARGE
from pendulum_env.recording.study import Source
from pendulum_env.words import Table
from workbench.inputs import check_outputs, given, wrote
from workbench.mistakes import InputError
from workbench.terminal import Terminal
from workbench.words import enumerate_words

SAVED = "filtered_dynamic"  # whose model is written, if it was asked for
STEP_RATE = 1000.0  # [Hz], of the simulator's steps at least


def record(
    arguments: argparse.Namespace, seconds: float, samples: int, rng: np.random.Generator, terminal: Terminal
) -> None:
    """Design a motion, let the simulated arm follow it, and write what it did."""
    _refuse(arguments, "policy", "until", "diagnosis", "replay", "config", "theta")
    for name, own in (("excitation", "multisine"), ("backend", "pymunk")):
        if (asked := getattr(arguments, name)) not in (None, own):
            raise InputError(f"--{name} {asked} is for pendulums: arms know {own} alone, leave it out with --robot")
    body = read_body(arguments.robot, rotors=True if arguments.rotors else None)
    try:
        arm = simulated(
            planar_links(body), body.joints, arguments.effects, arguments.rate, arguments.counts, arguments.noise
        )
    except ValueError as error:  # an effect that cannot be there
        raise InputError(str(error)) from None
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
    write_arm_recording(recording, arguments.output)
    terminal.say(recording.summary)
    terminal.say(
        f"the joints follow a multisine of {motion.period:g} s, condition of the base regressor {motion.condition:.3g}"
    )
    off = np.sqrt(np.mean((motion(recording.time)[0] - recording.position) ** 2, axis=0))
    rows = [
        (
            name,
            f"{joint.position.min():.2f} to {joint.position.max():.2f}",
            f"{rms:.2g}",
            f"{np.abs(joint.torque).max():.3g}",
        )
        for name, joint, rms in zip(recording.names, recording.joints, off.tolist(), strict=True)
    ]
    terminal.table(("joint", "angle [rad]", "off its reference [rad]", "largest torque [N m]"), rows)
    if arguments.effects:
        terminal.say(f"hidden: {enumerate_words([re.split('[=:]', text)[0] for text in arguments.effects])}")
    wrote([arguments.output], terminal)


def simulated(
    links: Sequence[Link],
    joints: Sequence[str],
    effects: Sequence[str],
    rate: float,
    counts: int = COUNTS,
    noise: float = TORQUE_NOISE,
) -> PlanarArm:
    """Links as pymunk simulates them, with effects hidden at their joints; a controller sees velocities as they are.

    Raises:
        ValueError: if an effect cannot be there.
    """
    return PlanarArm(
        links,
        joints=joints,
        effects=effects,
        rate=rate,
        substeps=max(1, round(STEP_RATE / rate)),
        max_torque=MOST_TORQUE,
        counts=counts,
        torque_noise=noise,
        velocity="ideal",
    )


def identify(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print base parameters and friction as each scheme finds them."""
    _refuse(arguments, "align", "instruments", "fixed", "bounds")
    outputs = [arguments.json, arguments.output]
    asked = _given(arguments, outputs, terminal)
    body, recordings = asked.body, asked.recordings
    with terminal.progress("identifying"):
        found = identify_arm(recordings, body, schemes=for_arms(arguments.scheme))
    _tell_body(body, terminal)
    terminal.heading("Estimates ± standard errors")
    terminal.table(*schemes_table(found))
    for one in found.schemes.values():
        if one.hardly:
            terminal.say(
                f"warning: {one.scheme} hardly tells {enumerate_words(one.hardly)} apart: move all joints faster, "
                "wider and together",
                style="yellow",
            )
    if arguments.json is not None:
        write_whole(arguments.json, json.dumps(found.json(), indent=1) + "\n")
    if arguments.output is not None:
        chosen = found.schemes.get(SAVED, next(iter(found.schemes.values())))
        chosen.model.save(arguments.output)
    wrote(outputs, terminal)


def compare(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print how far the torque of a model is from recordings, joint by joint."""
    _refuse(arguments, "align")
    outputs = [arguments.json, arguments.report]
    asked = _given(arguments, outputs, terminal, arguments.model)
    body, recordings = asked.body, [*asked.recordings, *asked.held]
    model = ArmModel.load(arguments.model, body)
    with terminal.progress("comparing"):
        errors = compare_arm(model, recordings)
    if arguments.report is not None:
        from workbench.report.arm import write_arm_comparison_report  # plotly takes a while to import

        with terminal.progress("writing the report"):
            write_arm_comparison_report(arguments.report, recordings, model, errors)
    terminal.heading("Torque errors, clear of stick and reversals")
    terminal.table(*errors_table([errors], ("torque error [N m]",)))
    if arguments.json is not None:
        content = {"schema": "pendulum-ident/arm-comparison@1", "joints": [error.json() for error in errors]}
        write_whole(arguments.json, json.dumps(content, indent=1) + "\n")
    wrote(outputs, terminal)


def diagnose(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print which effects are missing at which joints."""
    limits = "max_torque", "max_angle", "max_speed", "experiment"
    _refuse(arguments, "model", *limits, "fixed", "bounds", "instruments")
    try:
        library = chosen_effects(joint_effects(), arguments.only, arguments.without)
    except ValueError as error:
        raise InputError(f"{error} (effects that can sit at a joint)") from None
    outputs = [arguments.json, arguments.report, arguments.output]
    asked = _given(arguments, outputs, terminal)
    body, recordings, held = asked.body, asked.recordings, asked.held
    with terminal.progress("diagnosing") as progress:
        found = diagnose_arm(recordings, body, held, progress, library=library)
    if arguments.json is not None:
        write_whole(arguments.json, json.dumps(found.json(), indent=1) + "\n")
    if arguments.output is not None:
        found.model.save(arguments.output)
    if arguments.report is not None:
        from workbench.report.arm import write_arm_report  # plotly takes a while to import

        with terminal.progress("writing the report"):
            write_arm_report(arguments.report, recordings, held, found)
    tell_diagnosis(found, terminal, arguments.all)
    wrote(outputs, terminal)


def add(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Refit a model without and with one more effect at a joint."""
    _refuse(arguments, "align", "fixed", "bounds")
    outputs = [arguments.output]
    asked = _given(arguments, outputs, terminal, arguments.model)
    body, recordings, held = asked.body, asked.recordings, asked.held
    model = ArmModel.load(arguments.model, body)
    try:
        kind_at(arguments.effect, body)
    except ValueError as error:
        raise InputError(str(error)) from None
    with terminal.progress(f"adding {arguments.effect}") as progress:
        added = add_arm(model, arguments.effect, recordings, held, progress)
    if arguments.output is not None:
        added.after.model.save(arguments.output)
    for part, what in (("train", "fitted"), ("holdout", "held-out")):
        terminal.heading(f"Torque errors on {what} data, the model refitted without and with the effect")
        errors = [getattr(side, part) for side in (added.before, added.after)]
        terminal.table(*errors_table(errors, ("before [N m]", "after [N m]")))
    terminal.say(added.text)
    terminal.heading("Parameters")
    rows = [(name, e.text, e.unit) for name, e in added.after.model.estimates.items()]
    terminal.table(("parameter", "estimate", "unit"), rows, left=("unit",))
    wrote(outputs, terminal)


def schemes_table(found: ArmIdentification) -> Table:
    """A row a parameter, a column a scheme."""
    first = next(iter(found.schemes.values())).model
    rows = [
        (name, *(one.model.estimates[name].text for one in found.schemes.values()), own.unit)
        for name, own in first.estimates.items()
    ]
    rows.append(("condition", *(f"{one.condition:.3g}" for one in found.schemes.values()), ""))
    return Table(("parameter", *found.schemes, "unit"), rows, left=("unit",))


def errors_table(columns: Sequence[Sequence[JointError]], headers: Sequence[str]) -> Table:
    """A row a joint: torque errors of one or more models, and the share of the torque that the last one leaves."""
    rows = [
        (
            errors[0].joint,
            *(f"{error.torque_rms:.4g}" for error in errors),
            "" if errors[-1].share is None else f"{100 * errors[-1].share:.2g} %",
        )
        for errors in zip(*columns, strict=True)
    ]
    return Table(("joint", *headers, "of its torque"), rows)


def _tell_body(body: Body, terminal: Terminal) -> None:
    terminal.say(f"{body.name}: {len(body.joints)} joints, {len(body.base)} base parameters")
    for parameter in body.base:
        if len(parameter.parts) > 1:
            terminal.say(f"  {parameter.name} stands for {parameter.text}")


def tell_diagnosis(found: ArmDiagnosis, terminal: Terminal, every: bool = False) -> None:
    """Print what is missing at which joints, errors before and after, and candidates (or every one)."""
    terminal.say(f"\n{found.headline}{'' if found.selected else '.'}", style="bold")
    for group in found.ambiguous:
        terminal.say(f"{enumerate_words(group)} look the same in these data")
    terminal.heading("Torque errors on held-out data, clear of stick and reversals")
    terminal.table(*errors_table([found.before, found.after], ("before [N m]", "after [N m]")))
    found_parameters = [(name, one.text, one.unit) for name, one in found.parameters.items()]
    if found_parameters:
        terminal.heading("Parameters of what was found")
        terminal.table(("parameter", "value", "unit"), found_parameters, left=("unit",))
    terminal.heading("Candidates")
    ranking, more = candidates_table(found.candidates, every)
    terminal.table(*ranking)
    if more:
        terminal.say(f"and {more}: --all shows them")
    for joint, size in found.unexplained.items():
        terminal.say(f"{joint}: {size:.2g} N m are left that nothing in the library explains", style="yellow")


@dataclass(frozen=True)
class _Given:
    """The arm that a command was given, with recordings to fit and to hold out."""

    body: Body
    recordings: list[ArmRecording]
    held: list[ArmRecording]


def _given(
    arguments: argparse.Namespace, outputs: Sequence[str | None], terminal: Terminal, model: str | None = None
) -> _Given:
    asked = given(arguments)
    check_outputs(outputs, [*asked.files, *([model] if model else []), arguments.robot])
    told = has_rotors(model) if model else None
    body = read_body(arguments.robot, rotors=True if arguments.rotors else told)
    return _Given(
        body, *([_read(source, body, terminal) for source in part] for part in (asked.fitted, asked.held_out))
    )


def _read(source: Source, body: Body, terminal: Terminal) -> ArmRecording:
    recording = read_arm_source(source, body.joints)
    terminal.say(f"{source.file}: {recording.summary}")
    for note in dict.fromkeys(note for joint in recording.joints for note in joint.notes):
        terminal.say(f"  {note}")
    return recording


def _refuse(arguments: argparse.Namespace, *options: str) -> None:
    """Refuse options that say nothing of an arm."""
    for option in options:
        if getattr(arguments, option) not in (None, False, {}, math.inf):
            name = {"fixed": "fix", "bounds": "bound"}.get(option, option.replace("_", "-"))
            raise InputError(f"--{name} is for pendulums: leave it out with --robot")
