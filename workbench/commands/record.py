"""`record`: record a pendulum or an arm to a file."""

import argparse

import numpy as np

from agents.network import POLICY_NAMES as SHIPPED
from agents.observer import EPISODE
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.excitation import DEFAULT_SPEED, EXCITATIONS, LARGEST_TORQUE
from pendulum_env.reading import MAX_NUMBER
from pendulum_env.recording import write_recording
from pendulum_env.recording.checks import BOUNDS
from pendulum_env.recording.storage import WRITERS
from workbench import options
from workbench.arm_runs import record_arm
from workbench.errors import InputError
from workbench.outputs import check_outputs, report_files
from workbench.runs import LEARNT, RATE, SECONDS, SUGGESTED, Plan, describe_recording, record_rig, simulate
from workbench.terminal import Terminal

MOST = 5_000_000  # largest number of samples, some minutes of simulation
BACKENDS = (
    "simulated",  # the batched simulator
    "pymunk",  # rigid body in pymunk
    "mujoco",  # rigid body in MuJoCo
    "replay",  # replayed recording
    "dm1015b",  # the rig
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare plant, excitation, measurement and output."""
    parser.add_argument(
        "-o", "--output", metavar="FILE", required=True, help=f"recording to write: {', '.join(WRITERS)}"
    )
    parser.add_argument(
        "--seconds",
        type=options.convert_number(BOUNDS.shortest, MOST / BOUNDS.slowest),
        help=f"length [s] (default {SECONDS:g}, what the diagnosis suggests, or {EPISODE:g} with {LEARNT})",
    )
    parser.add_argument(
        "--rate",
        type=options.convert_number(BOUNDS.slowest, 1e5),
        help=f"samples per second (default {RATE:g}, or those of the rig or the replay)",
    )
    options.declare(parser, "--seed")
    group = parser.add_argument_group("excitation")
    group.add_argument(
        "--excitation",
        metavar="NAME",
        choices=(*EXCITATIONS, SUGGESTED, LEARNT),
        help=f"{', '.join(EXCITATIONS)} (default paper); {SUGGESTED}: the experiment of --diagnosis; "
        f"{LEARNT}: by a policy that sees the motion. The motion of an arm is designed within the limits of its "
        f"joints, with {LEARNT} by a policy for this arm",
    )
    group.add_argument(
        "--amplitude",
        type=options.convert_number(0.0, LARGEST_TORQUE),
        help="bound of the torque [N m]; each excitation has its own, an arm those of its file",
    )
    group.add_argument(
        "--policy",
        metavar="NAME",
        help=f"{', '.join(SHIPPED)}, or a file that `train` wrote, for --excitation {LEARNT} (default peak, or arm "
        "with --robot)",
    )
    group.add_argument(
        "--diagnosis", metavar="FILE", help=f"what `diagnose --json` wrote, for --excitation {SUGGESTED}"
    )
    group.add_argument(
        "--release",
        type=options.convert_number(-MAX_NUMBER, MAX_NUMBER),
        help="let the joint go at rest at this angle, without torque [rad]",
    )
    group = parser.add_argument_group("plant")
    group.add_argument(
        "--backend",
        metavar="NAME",
        choices=BACKENDS,
        help=f"{', '.join(BACKENDS)} (default simulated, which plays signals only; pymunk with {LEARNT})",
    )
    group.add_argument("--replay", metavar="FILE", help="recording that --backend replay plays")
    group.add_argument("--config", metavar="FILE", help="rig.toml of the rig, for --backend dm1015b")
    group.add_argument(
        "--counts",
        type=options.convert_number(0, 2**32),
        default=COUNTS,
        help=f"of the encoder per turn (default {COUNTS})",
    )
    options.declare(parser, *options.PLANT)
    options.add_robot(
        parser,
        arms=["max_angle", "max_speed"],
        pendulums=["diagnosis", "replay", "config", "release"],
        about="the plant is an arm with these links",
    )
    group = parser.add_argument_group("motion of an arm")
    group.add_argument(
        "--max-angle",
        type=options.convert_number(0.01),
        help="largest angle of each joint to either side [rad] (default the file's, or pi)",
    )
    group.add_argument(
        "--max-speed",
        type=options.convert_number(0.01),
        help=f"largest speed of each joint [rad/s] (default the file's, or {DEFAULT_SPEED:g})",
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Record a pendulum or an arm, and write the file."""
    inputs = (arguments.diagnosis, arguments.replay, arguments.robot)
    check_outputs([arguments.output], [path for path in inputs if path])
    if not arguments.output.lower().endswith(tuple(WRITERS)):
        raise InputError(f"{arguments.output}: the name should end in {', '.join(WRITERS)}")
    rng = np.random.default_rng(arguments.seed)
    if arguments.robot is not None:
        seconds, rate = arguments.seconds or SECONDS, arguments.rate or RATE
        record_arm(arguments, seconds, rate, _count_samples(seconds, rate), rng, terminal)
        return
    plan = Plan.from_arguments(arguments, rng)
    samples = _count_samples(plan.seconds, plan.rate)
    if plan.rig is not None:
        record_rig(plan, samples, terminal)
        return
    recording = simulate(plan, rng, terminal)
    if not (np.abs(recording.position) <= MAX_NUMBER).all():  # false for NaN, too
        raise InputError(f"the pendulum turns by more than {MAX_NUMBER:g} rad: lower the torque, or what drives it")
    if np.ptp(recording.position) == 0:
        count = f", or turn it by less than one of the {arguments.counts} --counts" if arguments.counts else ""
        if plan.release is not None:
            raise InputError(f"the pendulum never moves: let it go at another angle than {plan.release:g} rad{count}")
        raise InputError(
            f"the pendulum never moves: {plan.command.amplitude:g} N m do not overcome its friction{count}"
        )
    write_recording(recording, arguments.output)
    describe_recording(recording, terminal)
    if plan.plant.effects:
        terminal.print(f"hidden: {', '.join(plan.plant.effects)}")
    report_files([arguments.output], terminal)


def _count_samples(seconds: float, rate: float) -> int:
    """Return the number of samples for a duration [s] at a rate [Hz]; raises InputError outside the limits."""
    samples = seconds * rate
    if not BOUNDS.fewest <= samples <= MOST:
        raise InputError(f"{samples:.0f} samples are requested: between {BOUNDS.fewest} and {MOST} are possible")
    return round(samples)
