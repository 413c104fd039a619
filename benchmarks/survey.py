"""Rates of drifts and jumps that a survey finds, by size, and of false changes.

python -m benchmarks.survey

Each survey has 20 parameters and one recording per week. Four parameters drift, and four jump. Estimates scatter by
three times their standard errors, as on real machines. Sizes are in units of that scatter: total change of a drift,
and step of a jump.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

from pendulum_env._typing import JSON
from workbench.survey.table import find_series
from workbench.terminal import Terminal

BEGAN = datetime(2026, 1, 5, tzinfo=UTC)
PARAMETERS, CHANGING = 20, 4  # of each kind of change
STD = 0.002  # standard error of values of about 1
SCATTER = 3 * STD


def simulate_rows(size: float, weeks: int, rng: np.random.Generator) -> list[JSON]:
    """Simulate the rows of a survey of one machine; the name of a parameter begins with its change."""
    share = np.arange(weeks) / (weeks - 1)
    shapes = {"drift": share, "jump": share >= 0.5, "": np.zeros(weeks)}
    kinds = ["drift"] * CHANGING + ["jump"] * CHANGING + [""] * (PARAMETERS - 2 * CHANGING)
    values = {f"{kind}-{k}": 1 + size * SCATTER * shapes[kind] for k, kind in enumerate(kinds)}
    noisy = {name: value + rng.normal(0.0, SCATTER, weeks) for name, value in values.items()}
    return [
        {
            "machine": "one",
            "joint": "",
            "selected": [],
            "date": BEGAN + timedelta(weeks=week),
            "parameters": {
                name: {"value": float(value[week]), "std": STD, "unit": "N m"} for name, value in noisy.items()
            },
        }
        for week in range(weeks)
    ]


def count(size: float, weeks: int, n: int, rng: np.random.Generator) -> tuple[list[str], Counter[tuple[str, str]]]:
    """Run n surveys; return a table row of shares, and counts of parameters by true and reported change."""
    named: Counter[tuple[str, str]] = Counter()
    dated = covered = 0
    slope, date = size * SCATTER / (weeks - 1), BEGAN + timedelta(weeks=weeks // 2)
    for _ in range(n):
        for own in find_series(simulate_rows(size, weeks, rng)):
            kind = own.parameter.partition("-")[0]
            named[kind, own.change] += 1
            covered += kind == "drift" and own.trend.interval[0] <= slope <= own.trend.interval[1]
            dated += kind == own.change == "jump" and own.jump_date == date
    total, jumps = n * CHANGING, named["jump", "jump"]
    parts = [named["drift", "drift"], named["drift", "jump"], jumps, named["jump", "drift"], covered]
    shares = [f"{100 * own / total:.0f} %" for own in parts]
    return [f"{size:g}", str(weeks), *shares, f"{100 * dated / jumps:.0f} %" if jumps else ""], named


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=40, help="surveys of each size (default 40)")
    arguments = parser.parse_args(argv)
    rng, rows, terminal = np.random.default_rng(0), [], Terminal()
    named: Counter[tuple[str, str]] = Counter()
    for weeks in (8, 16, 32):
        for size in (2.0, 4.0, 8.0):
            row, some = count(size, weeks, arguments.n, rng)
            rows.append(row)
            named += some
    headers = ["size", "weeks", "drift named", "as jump", "jump named", "as drift", "drift in interval", "jump dated"]
    terminal.print_table(headers, rows)
    false, changes = named["", "drift"] + named["", "jump"], sum(own for (_, what), own in named.items() if what)
    terminal.print(f"{false} of {changes} named changes are of parameters that do not change")
    steady = sum((count(0.0, 16, arguments.n, rng)[1] for _ in range(5)), Counter())
    wrong = sum(own for (_, what), own in steady.items() if what)
    terminal.print(f"{wrong} changes are named in {5 * arguments.n} surveys in which nothing changes")
    return int(false > 0.02 * changes or wrong > 0.03 * 5 * arguments.n)


if __name__ == "__main__":
    sys.exit(main())
