"""Everything a training depends on, so that a file of a few lines repeats it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from agents.observer import CONSTRAINTS
from pendulum_env.lookup import find


@dataclass(frozen=True)
class Config:
    """Everything a training depends on.

    Attributes:
        constraint: of the torque, "peak" or "rms".
        criterion: of the reward, "D" or "A".
        seed: of plants, noise, network and exploration.
        steps: decisions in all.
        pendulums: that learn together.
        rollout: decisions of each between updates.
        batch: decisions in a step of the optimiser.
        epochs: passes over a rollout.
        learning_rate: falls linearly to zero.
        gamma: discount per decision of 20 ms.
        entropy: weight of the exploration bonus.
        hidden: width of the two hidden layers.
        levels: torque levels, shares of the peak.
        price_rate: by which the price of torque follows a relative excess of the budget, per decision; under "rms".
        head_start: decisions added to t in the weight of a reward; without any, nothing is worth while at the start.
        checkpoint: decisions between two checkpoints.
    """

    constraint: str = "peak"
    criterion: str = "D"
    seed: int = 0
    steps: int = 1_200_000
    pendulums: int = 64
    rollout: int = 250
    batch: int = 2000
    epochs: int = 8
    learning_rate: float = 1e-3
    gamma: float = 0.99
    entropy: float = 0.003
    hidden: int = 64
    levels: tuple[float, ...] = (-1.0, -0.5, 0.0, 0.5, 1.0)
    price_rate: float = 3e-5
    head_start: int = 50
    checkpoint: int = 200_000

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Config:
        """The usual configuration of a constraint, but for the settings by name.

        Raises:
            ValueError: if a setting or the constraint is unknown, or a value makes no sense.
        """
        known = {field.name: field for field in fields(cls)}
        for name in settings:
            find("setting", name, known)
        constraint = settings.get("constraint", "peak")
        find("constraint", constraint, CONSTRAINTS)
        config = cls(**{**USUAL[constraint], **settings})
        decisions = config.pendulums * config.rollout
        if not 0 < config.batch <= decisions or config.steps < 1:
            raise ValueError(f"batch ({config.batch}) has to be within the {decisions} decisions of a rollout")
        return config


USUAL: dict[str, dict[str, Any]] = {  # what differs between the constraints
    "peak": {},
    "rms": {"levels": (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6), "entropy": 0.001},
}


def read_settings(path: str | Path) -> dict[str, Any]:
    """Settings of a TOML file.

    Raises:
        ValueError: if it is no TOML.
        OSError: if it cannot be read.
    """
    with open(path, "rb") as file:
        settings = tomllib.load(file)
    return {name: tuple(value) if isinstance(value, list) else value for name, value in settings.items()}
