"""Runs of a pendulum: the torque that it is driven by, and what answers step by step."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from agents import multisine
from agents.network import load
from agents.observer import EPISODE
from agents.pilot import Pilot
from estimators.progress import Progress
from pendulum_env.excitation import Excitation, excitation
from pendulum_env.interface import MAX_TORQUE
from pendulum_env.physics import Estimate, Model, Term
from pendulum_env.recording import Recording
from pendulum_env.registration import PENDULUM
from workbench.inputs import read_suggestion
from workbench.mistakes import InputError
from workbench.until import LONGEST

SECONDS = 30.0  # length of a recording
USUAL = "paper"  # excitation
SUGGESTED = "suggested"  # excitation that a diagnosis holds
LEARNT = "rl"  # excitation that a policy chooses while the arm moves


@dataclass(frozen=True)
class Hidden:
    """A simulated plant with an effect hidden in it.

    Attributes:
        title: what it is.
        effect: what is hidden.
        law: of the effect.
        truth: true parameters by name.
        terms: of the model that knows nothing of the effect.
        record: makes a recording of a name.
    """

    title: str
    effect: str
    law: str
    truth: Mapping[str, Estimate]
    terms: Sequence[Term]
    record: Callable[[str, Progress], Recording]


def experiment(
    arguments: argparse.Namespace, rng: np.random.Generator, rate: float
) -> tuple[Excitation | Pilot, float]:
    """Torque command and length [s]: drawn, as a diagnosis suggests, or by a policy.

    Raises:
        InputError: if the arguments do not go together, the diagnosis suggests nothing, or there is no such policy.
    """
    kind = arguments.excitation
    for name, only in (("policy", LEARNT), ("diagnosis", SUGGESTED)):
        if getattr(arguments, name) is not None and kind != only:
            raise InputError(f"--{name} goes with --excitation {only} only")
    if kind in (LEARNT, SUGGESTED) and arguments.amplitude is not None:
        bound = "the policy decides as the arm moves" if kind == LEARNT else "`diagnose --max-torque` bounds its torque"
        raise InputError(f"--amplitude does not go with --excitation {kind}: {bound}")
    if kind == LEARNT:
        if arguments.replay is not None or arguments.backend == "simulated":
            raise InputError(f"--excitation {LEARNT} needs a backend that answers step by step: use --backend pymunk")
        seconds = arguments.seconds or (EPISODE if arguments.until is None else LONGEST)
        network = load(arguments.policy or "peak")
        return Pilot(network, network.constraint, seconds, rate), seconds
    if kind == SUGGESTED:
        if arguments.diagnosis is None:
            raise InputError(f"--excitation {SUGGESTED} needs --diagnosis FILE, which `diagnose --json FILE` writes")
        suggestion = read_suggestion(arguments.diagnosis)
        return suggestion.signal, arguments.seconds or suggestion.seconds
    seconds = arguments.seconds or (SECONDS if arguments.until is None else LONGEST)
    if arguments.until is not None and kind is None:
        return multisine.separating(arguments.amplitude), seconds
    return excitation(kind or USUAL, rng, seconds, arguments.amplitude), seconds


def environment(arguments: argparse.Namespace, plant: Model, command: Excitation | Pilot) -> gym.Env[Any, Any]:
    """What answers step by step: a simulated plant, or a recording that is replayed."""
    return gym.make(
        PENDULUM,
        max_episode_steps=-1,
        backend=arguments.backend or "pymunk",
        model=None if arguments.replay is not None else plant,
        rate=arguments.rate,
        counts=arguments.counts,
        torque_noise=arguments.noise,
        max_torque=max(MAX_TORQUE, command.amplitude),
        recording=arguments.replay,
    )
