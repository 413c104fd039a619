"""Recording of a pendulum, simulated, replayed or on the rig, by a plan of torque command, duration, plant and rig."""

import argparse
from dataclasses import dataclass
from typing import Any, Self

import gymnasium as gym
import numpy as np
from msgspec import Struct

from agents.network import load
from agents.observer import CONSTRAINTS, EPISODE, Pilot
from estimators.diagnosis.result import SCHEMA
from estimators.diagnosis.suggestion import Suggestion
from pendulum_env.backends.hardware import DriveError, config
from pendulum_env.backends.simulated import TORQUE_NOISE, record
from pendulum_env.errors import FileError
from pendulum_env.excitation import STILL, Excitation, excitation
from pendulum_env.physics import Model
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.reading import Text, convert, read_json
from pendulum_env.recording import Recording, RecordingError
from pendulum_env.registration import PENDULUM
from pendulum_env.spaces import MAX_TORQUE
from pendulum_env.wrappers import RecordMeasurements
from workbench.errors import InputError, Interrupted
from workbench.options import make_plant
from workbench.outputs import report_files
from workbench.terminal import Terminal

SECONDS = 30.0  # default length of a recording [s]
RATE = 1000.0  # default sample rate [Hz]
SUGGESTED = "suggested"  # excitation suggested by a diagnosis
LEARNT = "rl"  # excitation by a policy in closed loop


@dataclass(frozen=True)
class Plan:
    """Torque command, duration, and plant or rig of a recording."""

    arguments: argparse.Namespace  # of `record`
    rig: config.RigConfig | None  # None: simulation or replay
    plant: Model  # simulated plant
    rate: float  # sample rate [Hz]
    command: Excitation | Pilot  # torque over time, or a policy
    seconds: float  # length [s]
    release: float | None = None  # initial angle of a free swing from rest [rad]

    @classmethod
    def from_arguments(cls, arguments: argparse.Namespace, rng: np.random.Generator) -> Self:
        """Create the plan from arguments.

        Raises InputError if arguments exclude each other, a configuration or policy is invalid, or the diagnosis
        has no suggestion, and ModelError if an effect is hidden twice.
        """
        for backend, option in (("dm1015b", "config"), ("replay", "replay")):
            if (arguments.backend == backend) != (getattr(arguments, option) is not None):
                raise InputError(f"--backend {backend} and --{option} FILE belong together: give both or neither")
        if arguments.replay is not None or arguments.config is not None:
            source = "a replay" if arguments.config is None else "a rig"
            for option, value in (("effect", arguments.effects), ("theta", arguments.theta), ("rate", arguments.rate)):
                if value not in (None, []):
                    raise InputError(f"--{option} does not go with {source}, which has its own plant and rate")
        if arguments.config is not None and not arguments.output.lower().endswith(".csv"):
            raise InputError(f"{arguments.output}: a rig is recorded row by row as it runs: let the name end in .csv")
        rig = config.load(arguments.config) if arguments.config is not None else None
        rate = arguments.rate or RATE if rig is None else rig.rate
        command, seconds, release = _choose_experiment(arguments, rng, rate)
        if release is not None and arguments.backend not in (None, "simulated"):
            raise InputError("a free swing is simulated as a whole: leave out --backend")
        return cls(arguments, rig, make_plant(arguments), rate, command, seconds, release)

    @property
    def remark(self) -> str:
        """Describe the reduction of the torque by the limits of the rig; empty if it is not reduced."""
        rig, amplitude = self.rig, self.command.amplitude
        if rig is None or amplitude <= rig.max_torque:
            return ""
        limit_text = "limits.torque" if rig.checked else "until `hardware check` has passed"
        return f"torque is limited to {rig.max_torque:g} N m ({limit_text}); {amplitude:g} N m were requested"


def _choose_experiment(
    arguments: argparse.Namespace, rng: np.random.Generator, rate: float
) -> tuple[Excitation | Pilot, float, float | None]:
    """Return the torque command (random, suggested, or a policy), length [s] and angle of release [rad] or None.

    Raises as `Plan.from_arguments`.
    """
    kind = arguments.excitation
    if arguments.release is not None:
        if kind is not None or arguments.amplitude is not None:
            raise InputError("--release lets the joint go without torque: leave out --excitation and --amplitude")
        return STILL, arguments.seconds or SECONDS, arguments.release
    for option, only in (("policy", LEARNT), ("diagnosis", SUGGESTED)):
        if getattr(arguments, option) is not None and kind != only:
            raise InputError(f"--{option} goes with --excitation {only} only")
    if kind in (LEARNT, SUGGESTED) and arguments.amplitude is not None:
        bound = (
            "the policy decides as the pendulum moves"
            if kind == LEARNT
            else "`diagnose --max-torque` bounds its torque"
        )
        raise InputError(f"--amplitude does not go with --excitation {kind}: {bound}")
    if kind == LEARNT:
        if arguments.replay is not None or arguments.backend == "simulated":
            raise InputError(f"--excitation {LEARNT} needs a backend that answers step by step: use --backend pymunk")
        seconds = arguments.seconds or EPISODE
        network = load(arguments.policy or "peak")
        if network.constraint not in CONSTRAINTS:
            raise InputError(f"policy {arguments.policy} chooses the motion of an arm: give its --robot FILE")
        return Pilot(network, network.constraint, seconds, rate), seconds, None
    if kind == SUGGESTED:
        if arguments.diagnosis is None:
            raise InputError(f"--excitation {SUGGESTED} needs --diagnosis FILE, which `diagnose --json FILE` writes")
        suggestion = read_suggestion(arguments.diagnosis)
        return suggestion.signal or STILL, arguments.seconds or suggestion.seconds, suggestion.release
    seconds = arguments.seconds or SECONDS
    return excitation(kind or "paper", rng, seconds, arguments.amplitude), seconds, None


EARLIER = ("pendulum-ident/diagnosis@1", "pendulum-ident/diagnosis@2")  # readable schemas of a suggestion


class _Diagnosis(Struct):
    """Fields of a diagnosis file on the next experiment."""

    suggestion: dict[str, Any] | None = None
    no_experiment: dict[str, Any] | None = None
    forbidden: Text | None = None  # its text, up to @2
    inseparable: list[list[Text]] | None = None


def read_suggestion(path: str) -> Suggestion:
    """Read the suggested experiment of a diagnosis file.

    Raises InputError if the file is missing, is not a diagnosis, or has no suggestion.
    """
    hint = "a diagnosis is what `diagnose --json` writes"
    content = read_json(path, hint)
    if not isinstance(content, dict) or content.get("schema") not in (SCHEMA, *EARLIER):
        raise InputError(f"{path}: is not a diagnosis; {hint}")
    try:
        data = convert(content, _Diagnosis)
        if data.suggestion is not None:
            return Suggestion.from_json(data.suggestion, "suggestion")
    except FileError as error:
        raise InputError(f"{path}: {error}") from None
    forbidden = data.forbidden or (data.no_experiment or {}).get("text")
    if forbidden is not None:
        raise InputError(f"{path}: {forbidden}")
    reason = f", and no torque tells {' from '.join(data.inseparable[0])}" if data.inseparable else ""
    raise InputError(f"{path}: this diagnosis suggests no further experiment{reason}")


def simulate(plan: Plan, rng: np.random.Generator, terminal: Terminal) -> Recording:
    """Record a simulated or replayed pendulum with the requested backend."""
    arguments, command, seconds = plan.arguments, plan.command, plan.seconds
    if not isinstance(command, Pilot) and arguments.backend in (None, "simulated"):
        with terminal.progress("simulating"):
            sensor = plan.rate, arguments.counts, TORQUE_NOISE
            return record(plan.plant, command, seconds, *sensor, rng=rng, release=plan.release)
    env = make_environment(plan)
    rate = env.unwrapped.rate  # type: ignore[attr-defined]
    steps = round(seconds * rate)
    with terminal.progress("running") as progress:
        return rollout(
            env,
            _make_controller(plan, rate),
            steps,
            seed=int(rng.integers(2**31)),
            watch=lambda info: progress(f"{info['time']:.0f} s", info["time"] / seconds),
        )


def record_rig(plan: Plan, steps: int, terminal: Terminal) -> None:
    """Record the rig row by row; rows up to a fault or an interrupt are kept.

    Raises InputError after a fault, Interrupted after an interrupt, and OSError if the disk is full.
    """
    output, rate, last = plan.arguments.output, plan.rate, dict[str, Any]()
    late: list[float] = []

    def watch(info: dict[str, Any]) -> None:
        last.update(info)
        late.append(info["jitter"])
        if len(late) % rate < 1:
            show(f"{info['time']:.0f} s", len(late) / steps)

    env = RecordMeasurements(make_environment(plan), output, overwrite=True)
    try:
        if plan.remark:
            terminal.print(plan.remark)
        with terminal.progress("running") as show:
            recording = rollout(env, _make_controller(plan, rate), steps, watch=watch)
    except (DriveError, RecordingError) as error:
        raise InputError(last.get("fault") or str(error)) from None
    except KeyboardInterrupt:
        raise Interrupted(f"what was measured until then is in {output}" if late else "nothing was measured") from None
    finally:
        env.close()
    jitter = 1e3 * np.percentile(late, (50, 99))
    terminal.print(
        f"samples {jitter[0]:.2g} ms after their tick, 99 % within {jitter[1]:.2g} ms; {last['overruns']} ticks missed"
    )
    # [s]; interpolation over a longer gap is no measurement
    if (worst := max(late)) > 0.03:
        terminal.print(
            f"the largest delay is {1e3 * worst:.0f} ms, and samples over it are interpolated. A diagnosis may take "
            "this for an effect: record again on an idle computer, or with realtime = true"
        )
    describe_recording(recording, terminal)
    if "fault" in last:
        raise InputError(f"{last['fault']}; what was measured until then is in {output}")
    report_files([output], terminal)


def _make_controller(plan: Plan, rate: float) -> OpenLoop | Pilot:
    """Create the controller at a rate [Hz]."""
    return plan.command if isinstance(plan.command, Pilot) else OpenLoop(plan.command, rate)


def make_environment(plan: Plan) -> gym.Env[Any, Any]:
    """Create the environment of a simulated plant, a replayed recording, or the rig (connected, without power).

    Raises InputError if the rig is not reachable or in use.
    """
    arguments = plan.arguments
    if plan.rig is not None:
        try:
            return gym.make(PENDULUM, max_episode_steps=-1, backend="dm1015b", config=str(plan.rig.path))
        except DriveError as error:
            raise InputError(str(error)) from None
    plant: dict[str, Any] = {"model": plan.plant, "rate": plan.rate} if arguments.replay is None else {}
    return gym.make(
        PENDULUM,
        max_episode_steps=-1,
        backend=arguments.backend or "pymunk",
        **plant,
        counts=arguments.counts,
        torque_noise=TORQUE_NOISE,
        max_torque=max(MAX_TORQUE, plan.command.amplitude),
        recording=arguments.replay,
    )


def describe_recording(recording: Recording, terminal: Terminal) -> None:
    """Print the duration, rate, range of angles and largest torque of a recording."""
    turns, peak = np.ptp(recording.position) / (2 * np.pi), np.abs(recording.torque).max()
    terminal.print(f"{len(recording) / recording.rate:.4g} s at {recording.rate:.4g} Hz, {len(recording)} samples")
    terminal.print(f"the pendulum covers {turns:.2g} turns under up to {peak:.2g} N m")
