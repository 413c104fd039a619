"""Optimise the multisines of `agents.baselines` by CMA-ES: python -m benchmarks.multisine.

Source: Hansen, The CMA Evolution Strategy: A Tutorial, arXiv 1604.00772.
"""

from __future__ import annotations

import json

import numpy as np

from agents.baselines import FREQUENCIES, WEIGHTS_FILE, make_multisine_torque, predict_rows
from agents.observer import CONSTRAINTS, INFORMATION_PRIOR, N_PARAMETERS, NOMINAL, Constraint, compute_log_det
from pendulum_env._typing import Array

PAPER = (1, 9)  # indices of the frequencies nearest to the paper's two tones
GENERATIONS, PLANTS = 250, 24
SPREAD = 0.3  # largest relative deviation of drawn plants


def optimise(name: str, constraint: Constraint) -> Array:
    """Find the weights (2 F,) of the multisine with the largest mean information over random plants.

    Raises ModuleNotFoundError if cma, of the extra rl, is not installed.
    """
    try:
        import cma
    except ModuleNotFoundError:
        raise ModuleNotFoundError("optimising a signal needs the extra rl: pip install 'pendulum-ident[rl]'") from None

    theta = NOMINAL * (1 + SPREAD * np.random.default_rng(0).uniform(-1, 1, (PLANTS, N_PARAMETERS)))
    start = np.zeros(2 * len(FREQUENCIES))
    start[list(PAPER)] = 1.0
    options = {"seed": 1, "maxiter": GENERATIONS, "verbose": -9}  # to cma, a seed of 0 is the clock
    search = cma.CMAEvolutionStrategy(start, 0.2, options)
    for generation in range(GENERATIONS):
        weights = np.array(search.ask()).T
        search.tell(list(weights.T), list(-mean_log_det(weights, theta, constraint)))
        print(f"{name} {(generation + 1) / GENERATIONS:.0%} {-search.best.f:.3f} nat", flush=True)
    return np.asarray(search.best.x)


def mean_log_det(weights: Array, theta: Array, constraint: Constraint) -> Array:
    """Return the mean over plants (B, P) of log det information after an episode, for C signals (2 F, C) [nat]."""
    torque = make_multisine_torque(weights, constraint)  # (T, C)
    rest = np.zeros(len(theta))
    rows, usable = predict_rows(np.repeat(torque[:, None], len(theta), axis=1), theta, rest, rest)
    rows = rows * usable[..., None]
    information = INFORMATION_PRIOR * np.eye(N_PARAMETERS) + np.einsum("tbci,tbcj->bcij", rows, rows, optimize=True)
    return np.asarray(compute_log_det(information).mean(axis=0))


def main() -> None:
    """Optimise and write the weights of both constraints."""
    found = json.loads(WEIGHTS_FILE.read_text())
    for name, constraint in CONSTRAINTS.items():
        weights = optimise(name, constraint)
        found[name] = np.round(weights / np.abs(weights).max(), 4).tolist()
    WEIGHTS_FILE.write_text(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
