"""Plan of a pendulum recording: torque command, duration, and plant or rig."""

import argparse
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from msgspec import Struct

from agents.network import load
from agents.observer import CONSTRAINTS, EPISODE, Pilot
from estimators.diagnosis.result import SCHEMA
from estimators.diagnosis.suggestion import Suggestion
from pendulum_env.backends.hardware import config
from pendulum_env.errors import FileError
from pendulum_env.excitation import STILL, Excitation, excitation
from pendulum_env.physics import Model
from pendulum_env.reading import Text, convert, read_json
from workbench.errors import InputError
from workbench.options import make_plant

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
        bound = "the policy decides as the arm moves" if kind == LEARNT else "`diagnose --max-torque` bounds its torque"
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


class _Diagnosis(Struct):
    """Fields of a diagnosis file on the next experiment."""

    suggestion: dict[str, Any] | None = None
    forbidden: Text | None = None
    inseparable: list[list[Text]] | None = None


def read_suggestion(path: str) -> Suggestion:
    """Read the suggested experiment of a diagnosis file.

    Raises InputError if the file is missing, is not a diagnosis, or has no suggestion.
    """
    hint = "a diagnosis is what `diagnose --json` writes"
    content = read_json(path, hint)
    if not isinstance(content, dict) or content.get("schema") not in (SCHEMA, "pendulum-ident/diagnosis@1"):
        raise InputError(f"{path}: is not a diagnosis; {hint}")
    try:
        data = convert(content, _Diagnosis)
        if data.suggestion is not None:
            return Suggestion.from_json(data.suggestion, "suggestion")
    except FileError as error:
        raise InputError(f"{path}: {error}") from None
    if data.forbidden is not None:
        raise InputError(f"{path}: {data.forbidden}")
    reason = f", and no torque tells {' from '.join(data.inseparable[0])}" if data.inseparable else ""
    raise InputError(f"{path}: this diagnosis suggests no further experiment{reason}")
