"""Everything a training depends on, so that a file of a few lines repeats it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from agents.knowledge import CRITERIA
from agents.structure import DISCRIMINATE
from pendulum_env.lookup import find
from pendulum_env.reading import read_toml, shown


@dataclass(frozen=True)
class Config:
    """Everything a training depends on.

    Attributes:
        constraint: of the torque, "peak" or "rms".
        criterion: of the reward, "D", "A" or "discriminate".
        algorithm: "ppo", which chooses between torque levels, or "sac", which chooses any torque.
        seed: of plants, noise, network and exploration.
        steps: decisions in all.
        pendulums: that learn together.
        batch: decisions in a step of the optimiser.
        learning_rate: falls linearly to zero.
        gamma: discount per decision of 20 ms.
        hidden: width of the two hidden layers.
        rollout: decisions of each between updates; of PPO, as the next three.
        epochs: passes over a rollout.
        entropy: weight of the exploration bonus.
        levels: torque levels, shares of the peak.
        replay: decisions that are kept to learn from; of SAC, as the next.
        updates: steps of the optimiser after each decision of all pendulums.
        price_rate: by which the price of torque follows a relative excess of the budget, per decision; under "rms".
        head_start: decisions added to t in the weight of a reward; without any, nothing is worth while at the start.
        checkpoint: decisions between two checkpoints.
    """

    constraint: str = "peak"
    criterion: str = "D"
    algorithm: str = "ppo"
    seed: int = 0
    steps: int = 1_200_000
    pendulums: int = 64
    batch: int = 2000
    learning_rate: float = 1e-3
    gamma: float = 0.99
    hidden: int = 64
    rollout: int = 250
    epochs: int = 8
    entropy: float = 0.003
    levels: tuple[float, ...] = (-1.0, -0.5, 0.0, 0.5, 1.0)
    replay: int = 200_000
    updates: int = 8
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
        usual: dict[str, Any] = {}
        for name, choices in USUAL.items():
            usual |= find(name, str(settings.get(name, known[name].default)), choices)
        config = cls(**{**usual, **settings})
        for name, (low, high) in RANGES.items():
            _check(name, getattr(config, name), low, high, isinstance(known[name].default, int))
        if not isinstance(config.levels, tuple) or not 2 <= len(config.levels) <= MOST_LEVELS:
            raise ValueError(
                f"levels should be a list of 2 to {MOST_LEVELS} shares of the peak, not {shown(config.levels)}"
            )
        for level in config.levels:
            _check("a level", level, -1.0, 1.0, False)
        decisions = config.pendulums * config.rollout
        if decisions > ROLLOUT:
            raise ValueError(f"pendulums times rollout is {decisions}, at most {ROLLOUT} decisions are possible")
        if config.algorithm == "ppo" and config.batch > decisions:
            raise ValueError(f"batch ({config.batch}) has to be within the {decisions} decisions of a rollout")
        return config


def _check(name: str, value: object, low: float, high: float, whole: bool) -> None:
    """Refuse what is no number of a range.

    Raises:
        ValueError: if it is none.
    """
    right = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
    if not right or not low <= value <= high:  # type: ignore[operator]  # a number by then
        kind = "whole number" if whole else "number"
        raise ValueError(f"{name} should be a {kind}, from {low:.15g} to {high:.15g}, not {shown(value)}")


MOST_LEVELS = 1000
ROLLOUT = 50_000_000  # decisions of all pendulums between two updates, of some 100 bytes each
RANGES: dict[str, tuple[float, float]] = {  # of the settings that are numbers; the upper ends keep memory in bounds
    "seed": (0, 2**20 - 1),  # beyond, plants of an evaluation would be drawn
    "steps": (1, 10**12),
    "pendulums": (1, 100_000),
    "batch": (1, 10**7),
    "learning_rate": (0.0, 1.0),
    "gamma": (0.0, 1.0),
    "hidden": (1, 4096),
    "rollout": (1, 10**6),
    "epochs": (1, 10_000),
    "entropy": (0.0, 1e6),
    "replay": (1, 10**7),
    "updates": (1, 100_000),
    "price_rate": (0.0, 1e6),
    "head_start": (0, 10**9),
    "checkpoint": (1, 10**12),
}
USUAL: dict[str, dict[str, dict[str, Any]]] = {  # what a choice changes
    "constraint": {
        "peak": {},
        "rms": {"levels": (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6), "entropy": 0.001, "steps": 3_600_000},
    },
    "criterion": {**{name: {} for name in CRITERIA}, DISCRIMINATE: {"steps": 640_000}},
    "algorithm": {"ppo": {}, "sac": {"steps": 600_000, "batch": 512, "checkpoint": 50_000}},
}


def read_settings(path: str | Path) -> dict[str, Any]:
    """Settings of a TOML file.

    Raises:
        Unreadable: if it cannot be read, or is no TOML.
    """
    settings = read_toml(path)
    return {name: tuple(value) if isinstance(value, list) else value for name, value in settings.items()}
