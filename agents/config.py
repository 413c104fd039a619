"""Everything a training depends on, so that a file of a few lines repeats it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta

from pendulum_env.lookup import find
from pendulum_env.reading import convert

ROLLOUT = 50_000_000  # decisions of all pendulums between two updates, of some 100 bytes each
OF_SPEED = (-1.0, -0.4, -0.04, 0.04, 0.4, 1.0)  # with a crawl, in which dry friction is told from viscous best
USUAL: dict[str, dict[str, Any]] = {  # what a constraint changes
    "peak": {},
    "arm": {"pendulums": 256, "rollout": 50, "steps": 8_000_000, "batch": 3200, "gamma": 1.0, "levels": OF_SPEED},
    "rms": {"levels": (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6), "entropy": 0.001, "steps": 3_600_000, "gamma": 0.985},
}


@dataclass(frozen=True)
class Config:
    """Everything a training depends on.

    Attributes:
        constraint: of the torque, "peak" or "rms"; "arm" to choose the motion of an arm.
        robot: file of the arm, URDF or MJCF; the links of `PlanarArm-v0` without one.
        seed: of plants, noise, network and exploration.
        steps: decisions in all.
        pendulums: or motions of an arm, that learn together.
        batch: decisions in a step of the optimiser.
        learning_rate: falls linearly to zero.
        gamma: discount per decision; of pendulums, patient trainings, with 0.99, are later to know every parameter to
            1 %, of arms, where what is known in the end counts, there is none.
        hidden: width of the two hidden layers.
        rollout: decisions of each between updates.
        epochs: passes over a rollout.
        entropy: weight of the exploration bonus.
        levels: torque levels, shares of the peak, or levels of each joint's speed.
        price_rate: by which the price of torque follows a relative excess of the budget, per decision; under "rms".
        head_start: decisions added to t in the weight of a reward; without any, nothing is worth while at the start.
        checkpoint: decisions between two checkpoints.
    """

    constraint: str = "peak"
    robot: str = ""
    seed: Annotated[int, Meta(ge=0, le=2**20 - 1)] = 0  # beyond, plants of an evaluation would be drawn
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

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Config:
        """The usual configuration of a constraint, but for the settings by name.

        Raises:
            ValueError: if a setting or the constraint is unknown, or a value makes no sense.
        """
        usual = find("constraint", str(settings.get("constraint", cls.constraint)), USUAL)
        config = convert({**usual, **settings}, cls)
        if config.robot and config.constraint != "arm":
            raise ValueError(f"robot is of the constraint arm, not of {config.constraint}")
        if len(config.levels) < 2:
            raise ValueError("levels should be 2 shares of the peak at least")
        decisions = config.pendulums * config.rollout
        if decisions > ROLLOUT:
            raise ValueError(f"pendulums times rollout is {decisions}, at most {ROLLOUT} decisions are possible")
        if config.batch > decisions:
            raise ValueError(f"batch ({config.batch}) has to be within the {decisions} decisions of a rollout")
        return config
