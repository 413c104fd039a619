"""Draw a new plant for each episode, of one pendulum or of a batch."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.plant import PAPER
from pendulum_env.wrappers.drawing import DrawingVectorWrapper, DrawingWrapper, get_plant, get_plants


class Spread:
    """Uniform distribution of linear parameters around those of a plant, of given relative widths."""

    stream = 1

    def __init__(self, nominal: Model, spread: float | Mapping[str, float]) -> None:
        """Set the nominal plant, and one relative half width for its four base parameters, or widths by name.

        Raises:
            ValueError: if a parameter is unknown, or a width is not from 0 to below 1.
        """
        values = dict(zip((column.name for column in nominal.columns), nominal.theta, strict=True))
        widths = dict(spread) if isinstance(spread, Mapping) else dict.fromkeys(PAPER, spread)
        for name, width in widths.items():
            if name not in values:
                raise ValueError(f"the plant has no parameter '{name}' to draw: it has {', '.join(values)}")
            if not 0 <= width < 1:
                raise ValueError(f"the spread of {name} cannot be {width:g}: give a share from 0 to below 1")
        self._centres = {name: value for name, value in values.items() if name in widths}
        self._widths = {name: value * widths[name] for name, value in self._centres.items()}

    def draw(self, rng: np.random.Generator, count: int) -> dict[str, Array]:
        """Draw parameters of `count` plants by name, (count,) each."""
        shares = dict(zip(self._centres, rng.uniform(-1.0, 1.0, (len(self._centres), count)), strict=True))
        return {name: centre + self._widths[name] * shares[name] for name, centre in self._centres.items()}


class RandomizePlant(DrawingWrapper):
    """Draw the parameters of a simulated plant at each reset, around those that it was made with.

    `info["plant"]` holds the drawn parameters.
    """

    def __init__(self, env: gym.Env[Any, Any], spread: float | Mapping[str, float] = 0.3) -> None:
        """Wrap a simulated pendulum.

        Args:
            env: simulated pendulum.
            spread: relative half width of the four base parameters, or of some linear parameters by name.

        Raises:
            ValueError: if the environment is not simulated, or as `Spread`.
        """
        plant = get_plant(env, "RandomizePlantVector")
        super().__init__(env, Spread(plant.model, spread), spread=spread)


class RandomizePlantVector(DrawingVectorWrapper):
    """`RandomizePlant` for batched pendulums."""

    def __init__(self, env: VectorEnv[Any, Any, Any], spread: float | Mapping[str, float] = 0.3) -> None:
        """Wrap batched pendulums; see `RandomizePlant` for the spread.

        Raises:
            ValueError: if the environments are not batched pendulums, or as `Spread`.
        """
        super().__init__(env, Spread(get_plants(env).model, spread))
