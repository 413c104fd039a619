"""Multisines found in advance by CMA-ES, the best of their kind on the average of random plants.

What ships was found by `python -m benchmarks.multisine`, which takes some minutes and writes it anew; but for
"separating", which keeps to the peak and was found, by version 1.0, to tell seven hidden effects apart.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from agents.observer import CONSTRAINTS, EPISODE, TICK, Constraint
from pendulum_env._typing import Array
from pendulum_env.excitation import Levels

FOUND = Path(__file__).parent / "policies" / "multisine.json"
FREQUENCIES = 0.2 * np.arange(1, 21)  # [Hz]
SEPARATING = "separating"


def signal(weights: Array, constraint: Constraint) -> Array:
    """Torque at each tick (T, ...) of weights (2 F, ...) of sines and cosines, as large as the constraint allows."""
    phase = 2 * np.pi * TICK * np.outer(np.arange(round(EPISODE / TICK)), FREQUENCIES)
    torque = np.concatenate([np.sin(phase), np.cos(phase)], axis=1) @ weights
    if constraint.rms is None:
        return np.asarray(torque * constraint.peak / np.abs(torque).max(axis=0))
    torque = torque * constraint.rms / np.sqrt((torque**2).mean(axis=0))
    return np.asarray(np.clip(torque, -constraint.peak, constraint.peak))


def separating(amplitude: float | None = None) -> Levels:
    """The multisine that tells hidden effects apart, with that bound of the torque [N m]; over and over."""
    constraint = CONSTRAINTS["peak"] if amplitude is None else Constraint(amplitude)
    torque = signal(shipped(SEPARATING), constraint)
    return Levels(constraint.peak, tuple(TICK * np.arange(1, len(torque) + 1)), tuple(torque))


def shipped(name: str) -> Array:
    """Weights (2 F,) that were found under the constraint of that name, or to tell effects apart."""
    return np.array(json.loads(FOUND.read_text())[name])
