"""A multisine that teaches most on the average of random plants, found in advance by CMA-ES: the best of its kind.

What ships was found by `python -m agents.multisine`, which takes some minutes and writes it anew.

Source: Hansen, The CMA Evolution Strategy: A Tutorial, arXiv 1604.00772.
"""

from __future__ import annotations

import itertools
import json
from functools import partial
from pathlib import Path

import numpy as np

from agents.foresight import foresee
from agents.knowledge import COUNT, CRITERIA, NOMINAL, PRIOR
from agents.observer import CONSTRAINTS, EPISODE, TICK, Constraint
from agents.structure import DISCRIMINATE, FAINT, Structure, promised
from estimators.progress import Progress
from pendulum_env._typing import Array

FOUND = Path(__file__).parent / "policies" / "multisine.json"
FREQUENCIES = 0.2 * np.arange(1, 21)  # [Hz]
PAPER = (1, 9)  # where the paper's two tones are among them, about
GENERATIONS = {"D": 250, DISCRIMINATE: 80}
SPREAD = 0.3  # within which plants are drawn


def signal(weights: Array, constraint: Constraint) -> Array:
    """Torque at each tick (T, ...) of weights (2 F, ...) of sines and cosines, as large as the constraint allows."""
    phase = 2 * np.pi * TICK * np.outer(np.arange(round(EPISODE / TICK)), FREQUENCIES)
    torque = np.concatenate([np.sin(phase), np.cos(phase)], axis=1) @ weights
    if constraint.rms is None:
        return np.asarray(torque * constraint.peak / np.abs(torque).max(axis=0))
    torque = torque * constraint.rms / np.sqrt((torque**2).mean(axis=0))
    return np.asarray(np.clip(torque, -constraint.peak, constraint.peak))


def optimise(
    constraint: Constraint,
    *,
    criterion: str = "D",
    generations: int = 250,
    plants: int = 24,
    seed: int = 0,
    tell: Progress | None = None,
) -> Array:
    """Weights (2 F,) of the multisine that teaches most, on the average of plants drawn within 30 %.

    Raises:
        ModuleNotFoundError: if cma is not installed; it is of the extra rl.
    """
    try:
        import cma
    except ModuleNotFoundError:
        raise ModuleNotFoundError("optimising a signal needs the extra rl: pip install 'pendulum-ident[rl]'") from None

    theta = NOMINAL * (1 + SPREAD * np.random.default_rng(seed).uniform(-1, 1, (plants, COUNT)))
    start = np.zeros(2 * len(FREQUENCIES))
    start[list(PAPER)] = 1.0
    options = {"seed": seed + 1, "maxiter": generations, "verbose": -9}  # to cma, a seed of 0 is the clock
    search = cma.CMAEvolutionStrategy(start, 0.2, options)
    for generation in range(generations):
        weights = np.array(search.ask()).T
        search.tell(list(weights.T), list(-taught(weights, theta, constraint, criterion)))
        if tell is not None:
            tell(f"{-search.best.f:.3f} nat", (generation + 1) / generations)
    return np.asarray(search.best.x)


def taught(weights: Array, theta: Array, constraint: Constraint, criterion: str = "D") -> Array:
    """Mean over plants (B, P) of what the criterion counts after an episode under each of C signals (2 F, C) [nat]."""
    torque = signal(weights, constraint)  # (T, C)
    rest = np.zeros(len(theta))
    structure = Structure() if criterion == DISCRIMINATE else None
    rows, usable = foresee(np.repeat(torque[:, None], len(theta), axis=1), theta, rest, rest, structure)
    rows = rows * usable[..., None]
    information = (PRIOR if structure is None else FAINT) * np.eye(rows.shape[-1]) + np.einsum(
        "tbci,tbcj->bcij", rows, rows, optimize=True
    )
    worth = promised if structure is not None else CRITERIA[criterion]
    return np.asarray(worth(information).mean(axis=0))


def shipped(constraint: str, criterion: str = "D") -> Array:
    """Weights (2 F,) that were found under a constraint, for log det information or to tell structures apart."""
    return np.array(json.loads(FOUND.read_text())[_key(constraint, criterion)])


def _key(constraint: str, criterion: str) -> str:
    return constraint if criterion == "D" else f"{criterion}-{constraint}"


def _say(name: str, text: str, share: float) -> None:
    print(f"{name} {share:.0%} {text}", flush=True)


def main() -> None:
    """Find them anew."""
    found = {}
    for name, criterion in itertools.product(CONSTRAINTS, ("D", DISCRIMINATE)):
        key, generations = _key(name, criterion), GENERATIONS[criterion]
        weights = optimise(CONSTRAINTS[name], criterion=criterion, generations=generations, tell=partial(_say, key))
        found[key] = np.round(weights / np.abs(weights).max(), 4).tolist()
    FOUND.write_text(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
