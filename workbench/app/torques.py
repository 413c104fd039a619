"""Torques that the page offers: signals, and the policies that ship, which see the motion and what it has taught."""

from __future__ import annotations

import numpy as np

from agents.network import NAMES, load
from agents.pilot import Pilot
from pendulum_env.excitation import EXCITATIONS, Excitation, excitation
from pendulum_env.lookup import find
from workbench.report.words import opening

LEARNT = {f"rl-{policy}": policy for policy in NAMES}  # the only policies that a page can name


def choices() -> dict[str, str]:
    """All of them by name, as a control calls them."""
    signals = {id: opening(id) for id in EXCITATIONS}
    return signals | {id: f"Learnt policy, {bound} torque bounded" for id, bound in LEARNT.items()}


def torque_of(
    name: str, rng: np.random.Generator, seconds: float, amplitude: float | None, rate: float
) -> Excitation | Pilot:
    """What chooses the torque for some seconds, at so many samples per second [Hz].

    Raises:
        ValueError: if there is none of that name, a number is out of its range, or a bound is given to a policy.
    """
    if name not in LEARNT:
        find("excitation", name, dict.fromkeys([*EXCITATIONS, *LEARNT]))
        return excitation(name, rng, seconds, amplitude)
    if amplitude is not None:
        raise ValueError("a learnt policy has a bound of its own: leave the peak torque empty")
    network = load(LEARNT[name])
    return Pilot(network, network.constraint, seconds, rate)
