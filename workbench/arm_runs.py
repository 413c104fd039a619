"""Recording of a simulated arm that follows a designed motion."""

import argparse

import numpy as np

from agents.network import load
from agents.observer import ARM
from pendulum_env.reading import MAX_NUMBER
from pendulum_env.recording import write_recording
from pendulum_env.simulated_robot import simulate_robot
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
    robot = make_robot(arguments)
    body = robot.body()
    report_held(robot, body, [], terminal)
    simulated = simulate_robot(body, rate, arguments.counts, arguments.effects, arguments.backend)
    limits = {"max_angle": arguments.max_angle, "max_speed": arguments.max_speed, "max_torque": arguments.amplitude}
    with terminal.progress("choosing the motion"):
        policy = load(arguments.policy or ARM) if arguments.excitation == LEARNT else None
        run = simulated.plan_run(seconds, rng, policy, **limits)
    with terminal.progress("simulating") as progress:
        recording = run.record(samples, arguments.amplitude, rng, arguments.output, progress)
    if not (np.abs(recording.position) <= MAX_NUMBER).all():  # false for NaN, too
        raise InputError(f"the joints turn by more than {MAX_NUMBER:g} rad: hide less, or allow less torque")
    write_recording(recording, arguments.output)
    terminal.print(recording.summary)
    terminal.print(f"the joints follow {run}, condition of the regressor {run.condition:.3g}")
    deviation = np.sqrt(np.mean((run.compute_positions(recording.time) - recording.position) ** 2, axis=0))
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
