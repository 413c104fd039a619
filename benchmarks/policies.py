"""Bound, error and their ratio by excitation policy and by scheme, on plants that no policy was trained on.

python -m benchmarks.policies --plants 200
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from agents import compare_policies, load
from benchmarks.scoring import positive
from workbench.terminal import Terminal

BASELINES = ("two-tone", "random-sinusoid", "multisine-optimised", "look-ahead")


def play_other_tones(time: float) -> float:
    """Return the torque of two tones with frequencies that were not optimised [N m]."""
    return float(3.0 * np.sin(2 * np.pi * 1.6 * time) + 3.0 * np.sin(2 * np.pi * 0.5 * time))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.policies", description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=positive, default=200, help="number of plants (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of plants, noise and signals (default %(default)s)")
    arguments = parser.parse_args(argv)
    policies = {"1.6 + 0.5 Hz": play_other_tones, "agent": load("peak")}
    found = compare_policies(policies, BASELINES, plants=arguments.plants, seed=arguments.seed)
    Terminal().print(str(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
