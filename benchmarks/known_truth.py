"""Diagnoses of recordings with known hidden effects: one line each, then totals.

python -m benchmarks.known_truth FOLDER        # with NAME.train.csv.gz, NAME.holdout.csv.gz and truth.json
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.scoring import examine_all, print_by_effect, print_by_share, print_totals, take_workers
from benchmarks.truth import read_truth
from pendulum_env.lookup import find
from workbench.terminal import Terminal


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.known_truth", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="NAME.train.csv.gz, NAME.holdout.csv.gz and truth.json")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these recordings only")
    take_workers(parser)
    arguments = parser.parse_args(argv)
    terminal = Terminal()
    try:
        truths = {truth.name: truth for truth in read_truth(arguments.folder)}
        if arguments.only:
            truths = {name: find("recording", name, truths) for name in arguments.only}
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    outcomes = examine_all(arguments.folder, list(truths.values()), arguments.workers, terminal)
    print_totals(outcomes, terminal)
    print_by_effect(outcomes, terminal)
    print_by_share(outcomes, terminal)
    return 0 if len(outcomes) == len(truths) else 130


if __name__ == "__main__":
    sys.exit(main())
