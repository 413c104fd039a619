"""Random draws keyed by their subject, so that a new effect in the library changes no other draws."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from itertools import combinations

import numpy as np


def make_generator(seed: int, *key: str | int) -> np.random.Generator:
    """Make the random generator of one subject, for example an effect and a number."""
    return np.random.default_rng([seed, *" ".join(map(str, key)).encode()])


def draw_size(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw uniformly in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def shuffle_keys(seed: int, keys: Iterable[tuple[str | int, ...]]) -> list[tuple[str | int, ...]]:
    """Sort keys at random; the order of two of them does not depend on the others."""
    return sorted(keys, key=lambda key: make_generator(seed, "order", *key).random())


def choose_pairs(seed: int, effects: Sequence[str], excluded: Collection[frozenset[str]]) -> list[tuple[str, str]]:
    """List all pairs of effects except the excluded ones in random order; the first n are a sample."""
    couples = [couple for couple in combinations(sorted(effects), 2) if frozenset(couple) not in excluded]
    return sorted(couples, key=lambda couple: make_generator(seed, "pair", *couple).random())
