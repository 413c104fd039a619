"""Recordings, sample by sample, to what takes in one after the other; and torques to environments."""

from collections.abc import Sequence
from typing import Any

import numpy as np


def feed(learner: Any, runs: Any, first: int = 0, last: int | None = None) -> list[Any]:
    """What an estimator or a diagnoser says after each sample of a run, or of several at once.

    The torque comes with the sample that ends its period.
    """
    runs = runs if isinstance(runs, Sequence) and not hasattr(runs, "time") else [runs]
    position, torque = (np.array([getattr(one, name) for one in runs]).T for name in ("position", "torque"))
    time, held = runs[0].time, np.vstack([np.zeros(len(runs)), torque[:-1]])
    return [learner.take(np.full(len(runs), time[k]), position[k], held[k]) for k in range(len(time))[first:last]]


def play_two_tones(env: Any, steps: int, first: int = 0) -> list[dict[str, Any]]:
    """Infos of the steps of one or several pendulums at 200 Hz under the paper's two tones."""
    time = np.arange(first, first + steps) / 200
    torque = 3 * np.sin(12.07 * time) + 3 * np.sin(2.25 * time)
    return [env.step(np.full(env.action_space.shape, own, dtype=np.float32))[-1] for own in torque]
