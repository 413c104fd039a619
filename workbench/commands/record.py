"""`record`: a run of a pendulum, written to a file."""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium as gym
import numpy as np

from pendulum_env.backends.hardware.config import ConfigError, RigConfig, load
from pendulum_env.backends.hardware.drive import DriveError
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE, record
from pendulum_env.excitation import EXCITATIONS, Excitation, excitation
from pendulum_env.interface import MAX_TORQUE
from pendulum_env.lookup import find
from pendulum_env.physics import Model
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.recording import Recording, RecordingError, write_recording
from pendulum_env.recording.checks import FEWEST, SHORTEST, SLOWEST
from pendulum_env.recording.storage import WRITERS
from pendulum_env.registration import PENDULUM
from pendulum_env.wrappers import RecordMeasurements
from workbench.command import Command
from workbench.inputs import (
    InputError,
    argument,
    check_outputs,
    number,
    plant_of,
    read_suggestion,
    take_plant,
    whole,
    wrote,
)
from workbench.terminal import Terminal

MOST = 5_000_000  # samples; simulating them takes some minutes
BACKENDS = (
    "simulated",  # the batched simulator
    "pymunk",  # a rigid body in the environment
    "replay",  # a recording again
    "dm1015b",  # the rig
)
SECONDS = 30.0  # length of a recording
SUGGESTED = "suggested"  # excitation that a diagnosis holds


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare plant, excitation, measurement and output."""
    parser.add_argument(
        "--seconds", type=number(SHORTEST), help=f"length (default {SECONDS:g}, or what the diagnosis suggests)"
    )
    parser.add_argument(
        "--excitation",
        type=argument(_excitation),
        default="paper",
        metavar="NAME",
        help=f"{', '.join(EXCITATIONS)} (default paper), or {SUGGESTED}: the experiment that --diagnosis suggests",
    )
    parser.add_argument(
        "--diagnosis", metavar="FILE", help=f"what `diagnose --json` wrote, for --excitation {SUGGESTED}"
    )
    parser.add_argument("--amplitude", type=number(0.0), help="bound of the torque [N m]; each excitation has its own")
    parser.add_argument(
        "--backend", type=argument(_backend), default="simulated", metavar="NAME", help=", ".join(BACKENDS)
    )
    parser.add_argument("--replay", metavar="FILE", help="recording that --backend replay plays")
    parser.add_argument("--config", metavar="FILE", help="rig.toml of the rig, for --backend dm1015b")
    take_plant(parser)
    parser.add_argument("--rate", type=number(SLOWEST, 1e5), default=1000.0, help="samples per second (default 1000)")
    parser.add_argument("--counts", type=whole(0), default=COUNTS, help=f"of the encoder per turn (default {COUNTS})")
    parser.add_argument(
        "--noise", type=number(0.0), default=TORQUE_NOISE, help=f"of the torque [N m] (default {TORQUE_NOISE:g})"
    )
    parser.add_argument("--seed", type=whole(0), default=0, help="of all random numbers (default 0)")
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help=", ".join(WRITERS))


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Run a pendulum and write what it did."""
    check_outputs([arguments.output], [path for path in (arguments.diagnosis, arguments.replay) if path])
    if not arguments.output.lower().endswith(tuple(WRITERS)):
        raise InputError(f"{arguments.output}: the name should end in {', '.join(WRITERS)}")
    rng = np.random.default_rng(arguments.seed)
    command, seconds = experiment(arguments, rng)
    rig = _rig(arguments)
    samples = seconds * (arguments.rate if rig is None else rig.rate)
    if not FEWEST <= samples <= MOST:
        raise InputError(f"{samples:.0f} samples are asked for, between {FEWEST} and {MOST} are possible")
    plant = plant_of(arguments)
    if rig is not None:
        _run_rig(arguments, rig, command, round(samples), terminal)
        return
    recording = _run(arguments, plant, command, seconds, rng, terminal)
    if np.ptp(recording.position) == 0:
        raise InputError(f"the arm never moves: {command.amplitude:g} N m do not overcome its friction")
    write_recording(recording, arguments.output)
    _told(recording, terminal)
    if plant.effects:
        terminal.say(f"hidden: {', '.join(plant.effects)}")
    wrote([arguments.output], terminal)


def _told(recording: Recording, terminal: Terminal) -> None:
    """Say what was recorded."""
    turns, peak = np.ptp(recording.position) / (2 * np.pi), np.abs(recording.torque).max()
    terminal.say(f"{len(recording) / recording.rate:.4g} s at {recording.rate:.4g} Hz, {len(recording)} samples")
    terminal.say(f"the arm covers {turns:.2g} turns under up to {peak:.2g} N m")


def experiment(arguments: argparse.Namespace, rng: np.random.Generator) -> tuple[Excitation, float]:
    """Torque command and length [s]: drawn, or as a diagnosis suggests.

    Raises:
        InputError: if the arguments do not go together, or the diagnosis suggests nothing.
    """
    if arguments.excitation == SUGGESTED:
        if arguments.diagnosis is None:
            raise InputError(f"--excitation {SUGGESTED} needs --diagnosis FILE, which `diagnose --json FILE` writes")
        if arguments.amplitude is not None:
            raise InputError(
                f"--amplitude does not go with --excitation {SUGGESTED}: `diagnose --max-torque` bounds its torque"
            )
        suggestion = read_suggestion(arguments.diagnosis)
        return suggestion.signal, arguments.seconds or suggestion.seconds
    if arguments.diagnosis is not None:
        raise InputError(f"--diagnosis goes with --excitation {SUGGESTED} only")
    seconds = arguments.seconds or SECONDS
    try:
        return excitation(arguments.excitation, rng, seconds, arguments.amplitude), seconds
    except ValueError as error:
        raise InputError(str(error)) from None


def _run(
    arguments: argparse.Namespace,
    plant: Model,
    command: Excitation,
    seconds: float,
    rng: np.random.Generator,
    terminal: Terminal,
) -> Recording:
    """Record with the backend that was asked for."""
    if (arguments.backend == "replay") != (arguments.replay is not None):
        raise InputError("--backend replay and --replay FILE belong together: give both or neither")
    if arguments.replay is not None and plant.effects:
        raise InputError("--effect does not go with a replay: it plays the plant that was recorded")
    if arguments.backend == "simulated":
        with terminal.progress("simulating"):
            return record(plant, command, seconds, arguments.rate, arguments.counts, arguments.noise, rng=rng)
    env = gym.make(
        PENDULUM,
        max_episode_steps=-1,
        backend=arguments.backend,
        model=None if arguments.replay is not None else plant,
        rate=arguments.rate,
        counts=arguments.counts,
        torque_noise=arguments.noise,
        max_torque=max(MAX_TORQUE, command.amplitude),
        recording=arguments.replay,
    )
    rate = env.unwrapped.rate  # type: ignore[attr-defined]
    steps = round(seconds * rate)
    with terminal.progress("running") as tell:
        return rollout(
            env,
            OpenLoop(command, rate),
            steps,
            seed=int(rng.integers(2**31)),
            watch=lambda info: tell(f"{info['time']:.0f} s", info["time"] / seconds),
        )


def _rig(arguments: argparse.Namespace) -> RigConfig | None:
    """Configuration of the rig, if one is to be recorded.

    Raises:
        InputError: if the arguments do not go together, or the configuration cannot be used.
    """
    if (arguments.backend == "dm1015b") != (arguments.config is not None):
        raise InputError("--backend dm1015b and --config FILE belong together: give both or neither")
    if arguments.config is None:
        return None
    if arguments.effects or arguments.theta is not None:
        raise InputError("--effect and --theta do not go with a rig: it has the plant that it has")
    if not arguments.output.lower().endswith(".csv"):
        raise InputError(f"{arguments.output}: a rig is recorded row by row as it runs: let the name end in .csv")
    try:
        return load(arguments.config)
    except ConfigError as error:
        raise InputError(str(error)) from None


def _run_rig(
    arguments: argparse.Namespace, rig: RigConfig, command: Excitation, steps: int, terminal: Terminal
) -> None:
    """Record the rig, row by row: what was measured up to a fault or an interrupt is kept.

    Raises:
        InputError: if there is a fault.
    """
    last: dict[str, Any] = {}
    late: list[float] = []

    def watch(info: dict[str, Any]) -> None:
        last.update(info)
        late.append(info["jitter"])
        if len(late) % rig.rate < 1:
            tell(f"{info['time']:.0f} s", len(late) / steps)

    try:
        env = gym.make(PENDULUM, max_episode_steps=-1, backend="dm1015b", config=str(rig.path))
    except (DriveError, ModuleNotFoundError) as error:
        raise InputError(str(error)) from None
    env = RecordMeasurements(env, arguments.output, overwrite=True)
    try:
        if command.amplitude > rig.max_torque:
            until = "limits.torque" if rig.checked else "until `hardware check` has passed"
            terminal.say(f"torque is cut at {rig.max_torque:g} N m ({until}), {command.amplitude:g} were asked for")
        with terminal.progress("running") as tell:
            recording = rollout(env, OpenLoop(command, rig.rate), steps, watch=watch)
    except (DriveError, RecordingError) as error:
        raise InputError(last.get("fault") or str(error)) from None
    finally:
        env.close()
    jitter = 1e3 * np.percentile(late, (50, 99))
    terminal.say(
        f"samples {jitter[0]:.2g} ms after their tick, 99 % within {jitter[1]:.2g} ms; {last['overruns']} ticks missed"
    )
    _told(recording, terminal)
    if "fault" in last:
        raise InputError(f"{last['fault']}; what was measured until then is in {arguments.output}")
    wrote([arguments.output], terminal)


def _excitation(text: str) -> str:
    if text != SUGGESTED:
        find("excitation", text, EXCITATIONS)
    return text


def _backend(text: str) -> str:
    find("backend", text, dict.fromkeys(BACKENDS))
    return text


COMMAND = Command(
    "record a pendulum: the rig, or a simulated one with effects hidden in it if asked for", configure, run
)
