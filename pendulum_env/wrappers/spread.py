"""Plants drawn around a nominal one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.plant import PAPER

OWN = "covariance"
SURE = 0.2  # of the inertia, its largest standard error: five of them from a body without any


class Spread:
    """How linear parameters are drawn: within relative half widths of nominal values, or as well as these are known."""

    def __init__(self, nominal: Model, spread: float | Mapping[str, float] | str) -> None:
        """Take the nominal plant, and one half width for its four base parameters, some by name, or "covariance".

        Raises:
            ValueError: if a parameter is unknown, a width is not between 0 and 1, which a plant could not survive, or
                the plant does not tell its covariance, or one so large.
        """
        self.names = [column.name for column in nominal.columns]
        self._nominal = nominal.theta
        self._least = np.array([[column.least] for column in nominal.columns])
        self._most = np.array([[column.most] for column in nominal.columns])
        self._uniform = spread != OWN
        self._root = _root(nominal, self.names) if spread == OWN else np.diag(self._nominal * self._widths(spread))

    def _widths(self, spread: float | Mapping[str, float] | str) -> Array:
        """Relative half widths (P,)."""
        if isinstance(spread, str):
            raise ValueError(f"plants cannot be drawn by '{spread}': give shares of parameters, or '{OWN}'")
        widths = dict.fromkeys(PAPER, spread) if isinstance(spread, int | float) else dict(spread)
        for name, width in widths.items():
            if name not in self.names:
                raise ValueError(f"the plant has no parameter '{name}' to draw: it has {', '.join(self.names)}")
            if not 0 <= width < 1:
                raise ValueError(f"the spread of {name} cannot be {width:g}: give a share from 0 to below 1")
        return np.array([widths.get(name, 0.0) for name in self.names])

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Parameters of `count` plants (P, count)."""
        shape = len(self.names), count
        unit = rng.uniform(-1.0, 1.0, shape) if self._uniform else rng.standard_normal(shape)
        return np.clip(self._nominal[:, None] + self._root @ unit, self._least, self._most)


def _root(nominal: Model, names: list[str]) -> Array:
    """A root (P, P) of the covariance of the linear parameters."""
    inertia = nominal.estimates["inertia"]
    if not 0 < inertia.std < SURE * inertia.value:
        raise ValueError(
            f"the plant's inertia is {inertia}, of which no covariance can be drawn: take a model that was fitted, or "
            "give shares"
        )
    place = [list(nominal.estimates).index(name) for name in names]
    variances, axes = np.linalg.eigh(nominal.assumed_covariance[np.ix_(place, place)])
    return axes * np.sqrt(np.maximum(variances, 0.0))
