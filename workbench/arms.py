"""What commands do of an arm alone, where `--robot` names its links: read and record it, tell a payload, export it."""

import argparse
import re
from collections.abc import Sequence

import numpy as np

from estimators.arms.excitation import design_excitation
from estimators.arms.following import follow
from estimators.arms.limits import limits_of
from estimators.arms.payload import Payload, find_payload
from estimators.arms.reference import Reference
from estimators.regression.equations import IdentificationError
from estimators.show.story import Part
from pendulum_env.arms.body import Body, BodyError
from pendulum_env.arms.env import PlanarArm, SimulatedArm, SpatialArm
from pendulum_env.arms.plane import planar_links
from pendulum_env.arms.recording import of_arms
from pendulum_env.excitation import MOST_TORQUE
from pendulum_env.reading import LARGE
from pendulum_env.recording import Recording, write_recording
from pendulum_env.recording.record import NEWTON_METRE
from pendulum_env.recording.study import read_as
from pendulum_env.words import Table, listing
from workbench.inputs import read_all, sources_of, wrote
from workbench.mistakes import InputError
from workbench.opened import Opened, robot_of, tell_held
from workbench.terminal import Terminal

STEP_RATE = 1000.0  # [Hz], of the simulator's steps at least


def record(
    arguments: argparse.Namespace, seconds: float, samples: int, rng: np.random.Generator, terminal: Terminal
) -> None:
    """Design a motion, let the simulated arm follow it, and write what it did."""
    from workbench.runs import LEARNT  # brings agents and rigs, which who compares does not wait for

    for name, own in (("excitation", (LEARNT,)), ("backend", ("pymunk", "mujoco"))):
        if (asked := getattr(arguments, name)) not in (None, *own):
            raise InputError(f"--{name} {asked} is for pendulums: arms know {' and '.join(own)} alone")
    if arguments.policy is not None and arguments.excitation != LEARNT:
        raise InputError(f"--policy goes with --excitation {LEARNT} only")
    body = robot_of(arguments).body()
    tell_held(body, [], terminal)
    arm = _simulated(arguments, body)
    with terminal.progress("choosing the motion"):
        motion = _motion(arguments, arguments.excitation == LEARNT, body, seconds, rng)
    with terminal.progress("simulating") as tell:
        recording = follow(arm, motion, samples, arguments.amplitude, rng=rng, name=arguments.output, progress=tell)
    if not (np.abs(recording.position) <= LARGE).all():  # nor NaN
        raise InputError(f"the joints turn by more than {LARGE:g} rad: hide less, or allow less torque")
    write_recording(recording, arguments.output)
    terminal.say(recording.summary)
    terminal.say(f"the joints follow {motion}, condition of the regressor {motion.condition:.3g}")
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


def _motion(
    arguments: argparse.Namespace, learnt: bool, body: Body, seconds: float, rng: np.random.Generator
) -> Reference:
    """The reference that is asked for, within the limits; raises InputError if a policy is none for this arm."""
    limits = {"max_angle": arguments.max_angle, "max_speed": arguments.max_speed, "max_torque": arguments.amplitude}
    limits["max_acceleration"] = arguments.max_acceleration
    if learnt:
        from agents.arm_env import plan
        from agents.network import load
        from agents.observer import ARM

        return plan(load(arguments.policy or ARM), body, limits_of(body, **limits), seconds)
    return design_excitation(body, seconds, **limits, rng=rng)


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
