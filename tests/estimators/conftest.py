"""Recordings of the plant of `tests.cases.THETA`, which share no code with the packages under test."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment
from pendulum_env.recording import Recording
from tests.cases import PLANT, recorded


@pytest.fixture(scope="session")
def exact() -> Recording:
    """8 s of the paper's experiment at 500 Hz without noise."""
    return recorded(PLANT, Experiment(rate=500.0, seconds=8.0, counts=None, torque_noise=0.0))[0]


@pytest.fixture(scope="session")
def paper_run() -> Recording:
    """10 s of the paper's experiment with its encoder and noise in the torque."""
    return recorded(PLANT, Experiment(seconds=10.0))[0]


@pytest.fixture(scope="session")
def sticky() -> Recording:
    """20 s of slow, weak excitation under which the joint sticks half of the time."""
    time = np.arange(10_000) / 500
    command = 1.6 * np.sin(3.0 * time) + 0.9 * np.sin(7.3 * time + 1)
    return recorded(PLANT, Experiment(rate=500.0, seconds=20.0), commands=[command])[0]
