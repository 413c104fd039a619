"""Recordings that the tests of the app share."""

import numpy as np

from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.plant import hide, paper_plant
from pendulum_env.recording import Recording


def recorded(name: str, seed: int, seconds: float = 8.0, effect: str = "stribeck", rate: float = 500.0) -> Recording:
    """A pendulum that hides an effect."""
    rng = np.random.default_rng(seed)
    return record(hide(paper_plant(), effect), excitation("paper", rng, seconds), seconds, rate, rng=rng, name=name)
