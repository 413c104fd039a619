"""Recordings of plants with known parameters, from a simulator that shares no code with the packages under test."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from pendulum_env.recording import Recording

PLANT = Plant()  # inertia 0.09, gravity 2, viscous 0.35, coulomb 0.8


@dataclass(frozen=True)
class Run:
    """A recording with the truth behind it."""

    recording: Recording
    theta: np.ndarray  # inertia, gravity, viscous, coulomb


def simulated(plants: list[Plant], commands: list[np.ndarray | None] | None = None, **experiment: Any) -> list[Run]:
    """One recording of each plant, all under the same kind of experiment, with seeds 0, 1, ..."""
    cases = [(plant, Experiment(**{"seed": j, **experiment})) for j, plant in enumerate(plants)]
    runs = simulate(cases, commands)
    return [
        Run(
            Recording(f"run {j}", run.time, run.position, run.torque),
            np.array([run.plant.inertia, run.plant.gravity, run.plant.viscous, run.plant.coulomb]),
        )
        for j, run in enumerate(runs)
    ]


@pytest.fixture(scope="session")
def record() -> Callable[..., list[Run]]:
    """Make recordings of other plants."""
    return simulated


@pytest.fixture(scope="session")
def exact() -> Run:
    """8 s of the paper's experiment at 500 Hz without noise."""
    return simulated([PLANT], rate=500.0, seconds=8.0, counts=None, torque_noise=0.0)[0]


@pytest.fixture(scope="session")
def paper_run() -> Run:
    """10 s of the paper's experiment with its encoder and noise in the torque."""
    return simulated([PLANT], seconds=10.0)[0]


@pytest.fixture(scope="session")
def sticky() -> Run:
    """20 s of slow, weak excitation under which the joint sticks half of the time."""
    time = np.arange(10_000) / 500
    command = 1.6 * np.sin(3.0 * time) + 0.9 * np.sin(7.3 * time + 1)
    return simulated([PLANT], [command], rate=500.0, seconds=20.0)[0]
