"""Plants drawn around a nominal one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.plant import PAPER


class Spread:
    """Relative half widths within which linear parameters are drawn, uniformly."""

    def __init__(self, nominal: Model, spread: float | Mapping[str, float]) -> None:
        """Take the nominal plant, and one half width for its four base parameters or some by name.

        Raises:
            ValueError: if a parameter is unknown, or a width is not between 0 and 1, which a plant could not survive.
        """
        widths = dict.fromkeys(PAPER, spread) if isinstance(spread, int | float) else dict(spread)
        names = [column.name for column in nominal.columns]
        for name, width in widths.items():
            if name not in names:
                raise ValueError(f"the plant has no parameter '{name}' to draw: it has {', '.join(names)}")
            if not 0 <= width < 1:
                raise ValueError(f"the spread of {name} cannot be {width:g}: give a share from 0 to below 1")
        self.names = names
        self._nominal = nominal.theta
        self._width = np.array([widths.get(name, 0.0) for name in names])

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Parameters of `count` plants (P, count)."""
        factor = 1.0 + self._width[:, None] * rng.uniform(-1.0, 1.0, (len(self._width), count))
        return self._nominal[:, None] * factor
