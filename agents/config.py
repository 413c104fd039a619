"""Configuration of a training; a file with these settings repeats the training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta

from pendulum_env.lookup import find
from pendulum_env.reading import convert

MAX_ROLLOUT = 50_000_000  # decisions of all pendulums between two updates, about 100 bytes each
SPEED_LEVELS = (-1.0, -0.4, -0.04, 0.04, 0.4, 1.0)  # the slow levels distinguish dry from viscous friction
DEFAULTS: dict[str, dict[str, Any]] = {  # defaults that depend on the constraint
    "peak": {},
    "arm": {"pendulums": 256, "rollout": 50, "steps": 8_000_000, "batch": 3200, "gamma": 1.0, "levels": SPEED_LEVELS},
    "rms": {"levels": (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6), "entropy": 0.001, "steps": 3_600_000, "gamma": 0.985},
}


@dataclass(frozen=True)
class Config:
    """Configuration of a training.

    Attributes:
        constraint: of the torque, "peak" or "rms"; "arm" for the motion of links.
        robot: URDF or MJCF file of the links; those of `PlanarArm-v0` by default.
        seed: of plants, noise, network and exploration.
        steps: total number of decisions, rounded up to whole rollouts of all pendulums, see `total`.
        pendulums: number of pendulums, or of motions of links, in a batch.
        batch: decisions in a step of the optimiser.
        learning_rate: initial value; it falls linearly to zero.
        gamma: discount per decision. For pendulums, 0.99 reaches 1 % in all parameters later than 0.97. For links, only
            the final information counts, so rewards are not discounted.
        hidden: width of the two hidden layers.
        rollout: decisions of each pendulum between updates.
        epochs: passes over a rollout.
        entropy: weight of the exploration bonus.
        levels: of the torque, as shares of the peak; or of the speed of each joint, as shares of the largest.
        price_rate: rate of the price of torque per relative excess of the budget and decision; for "rms".
        head_start: decisions added to t in the weight of a reward, so that early rewards count.
        checkpoint: decisions between two intermediate policies.
    """

    constraint: str = "peak"
    robot: str = ""
    seed: Annotated[int, Meta(ge=0, le=2**20 - 1)] = 0  # larger seeds belong to evaluations
    steps: Annotated[int, Meta(ge=1, le=10**12)] = 1_200_000
    pendulums: Annotated[int, Meta(ge=1, le=100_000)] = 64
    batch: Annotated[int, Meta(ge=1, le=10**7)] = 2000
    learning_rate: Annotated[float, Meta(ge=0.0, le=1.0)] = 1e-3
    gamma: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.97
    hidden: Annotated[int, Meta(ge=1, le=4096)] = 64
    rollout: Annotated[int, Meta(ge=1, le=10**6)] = 250
    epochs: Annotated[int, Meta(ge=1, le=10_000)] = 8
    entropy: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.003
    levels: tuple[Annotated[float, Meta(ge=-1.0, le=1.0)], ...] = (-1.0, -0.5, 0.0, 0.5, 1.0)
    price_rate: Annotated[float, Meta(ge=0.0, le=1e6)] = 3e-5
    head_start: Annotated[int, Meta(ge=0, le=10**9)] = 50
    checkpoint: Annotated[int, Meta(ge=1, le=10**12)] = 200_000

    @property
    def total(self) -> int:
        """Return the number of decisions of the training, in whole rollouts of all pendulums."""
        decisions = self.pendulums * self.rollout
        return -(-self.steps // decisions) * decisions

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Config:
        """Create a configuration from settings by name; the constraint decides the defaults.

        Raises:
            ValueError: if a setting or the constraint is unknown, or a value is out of its range.
        """
        defaults = find("constraint", str(settings.get("constraint", cls.constraint)), DEFAULTS)
        config = convert({**defaults, **settings}, cls)
        if config.robot and config.constraint != "arm":
            raise ValueError(f'robot needs constraint = "arm", not {config.constraint}')
        if len(config.levels) < 2:
            raise ValueError(f"levels has {len(config.levels)} values: give two or more")
        decisions = config.pendulums * config.rollout
        if decisions > MAX_ROLLOUT:
            raise ValueError(f"pendulums times rollout is {decisions}: give at most {MAX_ROLLOUT} decisions")
        if config.batch > decisions:
            raise ValueError(f"batch is {config.batch}: give at most the {decisions} decisions of a rollout")
        return config
