"""Recording of a simulated arm that follows a designed motion."""

import argparse

import numpy as np

from agents.network import load
from agents.observer import ARM
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.excitation import LARGEST_TORQUE
from pendulum_env.reading import MAX_NUMBER
from pendulum_env.recording import write_recording
from robots.arms import Body, BodyError, design_excitation, find_planar_links, follow
from robots.arms.design_env import plan_motion
from robots.arms.env import PlanarArm, SimulatedArm, SpatialArm
from robots.arms.limits import find_limits
from workbench.errors import InputError
from workbench.outputs import report_files
from workbench.robot import make_robot, report_held
from workbench.runs import LEARNT
from workbench.terminal import Terminal


def record_arm(
    arguments: argparse.Namespace,
    seconds: float,
    rate: float,
    samples: int,
    rng: np.random.Generator,
    terminal: Terminal,
) -> None:
    """Design a motion, simulate the arm that follows it, and write and print the recording."""
    for option, allowed in (("excitation", (LEARNT,)), ("backend", ("pymunk", "mujoco"))):
        if (value := getattr(arguments, option)) not in (None, *allowed):
            raise InputError(f"--{option} {value} is for pendulums: arms know {' and '.join(allowed)} alone")
    if arguments.policy is not None and arguments.excitation != LEARNT:
        raise InputError(f"--policy goes with --excitation {LEARNT} only")
    body = make_robot(arguments).body()
    report_held(body, [], terminal)
    arm = _make_arm(arguments, body, rate)
    limits = {"max_angle": arguments.max_angle, "max_speed": arguments.max_speed, "max_torque": arguments.amplitude}
    with terminal.progress("choosing the motion"):
        if arguments.excitation == LEARNT:
            motion = plan_motion(load(arguments.policy or ARM), body, find_limits(body, **limits), seconds)
        else:
            motion = design_excitation(body, seconds, **limits, rng=rng)
    with terminal.progress("simulating") as progress:
        recording = follow(arm, motion, samples, arguments.amplitude, rng=rng, name=arguments.output, progress=progress)
    if not (np.abs(recording.position) <= MAX_NUMBER).all():  # false for NaN, too
        raise InputError(f"the joints turn by more than {MAX_NUMBER:g} rad: hide less, or allow less torque")
    write_recording(recording, arguments.output)
    terminal.print(recording.summary)
    terminal.print(f"the joints follow {motion}, condition of the regressor {motion.condition:.3g}")
    deviation = np.sqrt(np.mean((motion(recording.time)[0] - recording.position) ** 2, axis=0))
    rows = [
        (
            name,
            f"{joint.position.min():.2f} to {joint.position.max():.2f}{' m' * is_prismatic}",
            f"{rms:.2g}{' m' * is_prismatic}",
            f"{np.abs(joint.torque).max():.3g}{' N' * is_prismatic}",
        )
        for name, joint, rms, is_prismatic in zip(
            recording.names, recording.joints, deviation.tolist(), body.is_prismatic, strict=True
        )
    ]
    terminal.print_table(("joint", "angle [rad]", "off its reference [rad]", "largest torque [N m]"), rows)
    if arguments.effects:
        terminal.print(f"hidden: {', '.join(text.partition('=')[0].partition(':')[0] for text in arguments.effects)}")
    report_files([arguments.output], terminal)


def _make_arm(arguments: argparse.Namespace, body: Body, rate: float) -> SimulatedArm:
    """Create the arm in pymunk if all joints turn in one vertical plane, else or on request in MuJoCo."""
    sensors = {"rate": rate, "counts": arguments.counts, "torque_noise": TORQUE_NOISE}
    sensors |= {"effects": arguments.effects, "max_torque": LARGEST_TORQUE}
    if arguments.backend != "mujoco":
        try:
            links = find_planar_links(body)
            steps = max(1, round(1000.0 / rate))  # simulate at 1000 Hz or more
            # the controller gets exact velocities
            return PlanarArm(links, joints=body.joints, substeps=steps, velocity="ideal", **sensors)
        except BodyError:
            if arguments.backend is not None:
                raise
    return SpatialArm(body, **sensors)
