"""Hide effects that are drawn for each episode, in one pendulum or in a batch."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from pendulum_env._typing import Array
from pendulum_env.lookup import find
from pendulum_env.physics import effect
from pendulum_env.plant import draw_parameter, get_typical_values, list_effects, list_typical_ranges, paper_plant
from pendulum_env.plant import hide as hide_effect
from pendulum_env.reading import quote_value
from pendulum_env.wrappers.drawing import DrawingVectorWrapper, DrawingWrapper, get_plant, get_plants

Bounds = float | tuple[float, float]  # a value, or the lowest and the highest one
Sizes = Bounds | Mapping[str, Bounds] | None
HiddenEffects = Sequence[str] | Mapping[str, Sizes]


class EffectDraw:
    """Distribution of hidden effects: each is present with a probability, and uniform within ranges."""

    stream = 2

    def __init__(self, effects: HiddenEffects, probability: float) -> None:
        """Set the effects, as `HideEffects`.

        Raises:
            ValueError: if an effect, a parameter, a range or the probability is unknown or impossible.
        """
        if not 0 <= probability <= 1:
            raise ValueError(f"the probability of an effect cannot be {probability:g}: give a number from 0 to 1")
        self._probability = probability
        self._ranges: dict[str, dict[str, tuple[float, float]]] = {}
        sizes = effects if isinstance(effects, Mapping) else dict.fromkeys(list_effects(effects))
        for id, size in sizes.items():
            kind = effect(id)
            if not kind().columns and not all(p.is_allowed(0.0) for p in kind.nonlinear_parameters):
                raise ValueError(f"{id} has no size 0 for its absence: hide it by the argument effects of gym.make")
            ranges = self._ranges[id] = {**list_typical_ranges(kind), **_read_ranges(id, size)}
            for k in (0, 1):
                hide_effect(paper_plant(), list_effects({id: {name: bounds[k] for name, bounds in ranges.items()}})[0])

    def add_to(self, plant: Any) -> None:
        """Add the effects that a plant lacks, with size 0."""
        plant.add_effects([f"{id}=0" for id in self._ranges if id not in plant.effects])

    def draw(self, rng: np.random.Generator, count: int) -> dict[str, Array]:
        """Draw parameters of `count` plants by name, (count,) each; the size of an absent effect is 0."""
        drawn: dict[str, Array] = {}
        for id, ranges in self._ranges.items():
            kind = effect(id)
            is_present = rng.random(count) < self._probability
            values = {name: draw_parameter(kind, name, *bounds, rng, count) for name, bounds in ranges.items()}
            linear = {column.name.removeprefix(f"{id}."): column.name for column in kind().columns}
            for name, value in values.items():
                if name in linear or not linear:  # a delay or a lag is its own size
                    value = np.where(is_present, value, 0.0)
                drawn[linear.get(name, kind.get_full_name(name))] = value
        return drawn


def _read_ranges(id: str, size: Sizes) -> dict[str, tuple[float, float]]:
    """Return the ranges (low, high) of the parameters of an effect that are given."""
    if size is None:
        return {}
    known = get_typical_values(effect(id)())
    by_name = size if isinstance(size, Mapping) else {next(iter(known)): size}
    ranges = {}
    for name, bounds in by_name.items():
        find(f"parameter of {id}", name, known)
        pair = np.ravel(np.asarray(bounds, dtype=object))
        try:
            low, high = float(pair[0]), float(pair[-1])
        except (TypeError, ValueError, IndexError):
            low, high = np.nan, np.nan
        if not low <= high or len(pair) > 2:
            raise ValueError(
                f"the range of {name} of {id} is {quote_value(bounds)}: give a number, or (lowest, highest)"
            )
        ranges[name] = (low, high)
    return ranges


class HideEffects(DrawingWrapper):
    """Hide effects in a simulated plant, whose presence and sizes are drawn at each reset.

    `info["plant"]` holds the drawn parameters; the size of an absent effect is 0.

    Examples:
        >>> import gymnasium as gym
        >>> from pendulum_env import PENDULUM
        >>> env = HideEffects(gym.make(PENDULUM), {"stribeck": (0.2, 0.6), "cogging": {"order": 14, "sin": (0.1, 0.3)}})
        >>> _, info = env.reset(seed=2)
        >>> info["plant"]["cogging.order"]
        14.0
    """

    def __init__(self, env: gym.Env[Any, Any], effects: HiddenEffects, *, probability: float = 0.5) -> None:
        """Wrap a simulated pendulum.

        Args:
            env: simulated pendulum.
            effects: ids, or ranges by id: a number or (lowest, highest) for the first parameter of the effect, or for
                parameters by name, in the order of `pendulum-ident effects`. The others, and those of None, are drawn
                around typical values.
            probability: of the presence of each effect in an episode, independent of the others.

        Raises:
            ValueError: if the environment is not simulated, or an effect or a number is unknown or impossible.
        """
        draw = EffectDraw(effects, probability)
        draw.add_to(get_plant(env, "HideEffectsVector"))
        super().__init__(env, draw, effects=effects, probability=probability)


class HideEffectsVector(DrawingVectorWrapper):
    """`HideEffects` for batched pendulums."""

    def __init__(self, env: VectorEnv[Any, Any, Any], effects: HiddenEffects, *, probability: float = 0.5) -> None:
        """Wrap batched pendulums; see `HideEffects` for the arguments.

        Raises:
            ValueError: if the environments are not batched pendulums, or as `HideEffects`.
        """
        draw = EffectDraw(effects, probability)
        draw.add_to(get_plants(env))
        super().__init__(env, draw)
