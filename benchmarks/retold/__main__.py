"""Retold logs: the same machine, moved and logged in other ways; outcomes by kind, by row and by motion.

    python -m benchmarks.retold --n 1000 --seed 20261129 --log retold.jsonl

A number draws a machine, a motion, and a retelling of its log. Machines are a pendulum, an axis, a motor, a servo in
its loop, which logs goals and positions, or an arm with two joints. `diagnose` is right if it names the hidden effect
or nothing, with parameters within four standard errors; asked, if it is right after its printed remedies; declined, if
it refuses or withholds a parameter; else wrong. With `--log`, finished numbers are kept and an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from benchmarks.parallel import each
from benchmarks.retold.judging import OUTCOMES, Outcome, judge_number
from benchmarks.retold.kinds import KINDS, MOTIONS, ROWS
from workbench.terminal import Terminal


def read_log(path: Path | None, key: Sequence[object]) -> list[Outcome]:
    """Read finished outcomes with a key: seed, and kind, row and motion if given."""
    if path is None or not path.exists():
        return []
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    return [Outcome(**line["outcome"]) for line in lines if line["key"] == [*key]]


def print_counts(title: str, outcomes: Sequence[Outcome], key: str, terminal: Terminal) -> None:
    """Print a table of outcomes by the value of a field."""
    names = sorted({getattr(own, key) for own in outcomes})
    counts = Counter((getattr(own, key), own.outcome) for own in outcomes)
    rows = [(name, *(str(counts[name, outcome] or "") for outcome in OUTCOMES)) for name in names]
    rows.append(("all", *(str(sum(own.outcome == outcome for own in outcomes)) for outcome in OUTCOMES)))
    terminal.print_table((title, *OUTCOMES), rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Judge retold logs, and print tables of outcomes."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m benchmarks.retold", description=__doc__, formatter_class=formatter)
    parser.add_argument("--n", type=int, default=60, help="number of retellings (default 60)")
    parser.add_argument("--seed", type=int, default=20261129)
    parser.add_argument("--kind", choices=KINDS, help="this kind of machine alone")
    parser.add_argument("--row", choices=ROWS, help="this row alone")
    parser.add_argument("--motion", choices=MOTIONS, help="this motion alone")
    parser.add_argument("--numbers", type=int, nargs="+", metavar="NUMBER", help="these numbers alone, in place of --n")
    parser.add_argument("--log", type=Path, metavar="FILE.jsonl", help="file that keeps finished outcomes")
    parser.add_argument("--workers", type=int, default=1)
    arguments, terminal = parser.parse_args(argv), Terminal()
    key = (arguments.seed, arguments.kind, arguments.row, arguments.motion)
    wanted = arguments.numbers or range(arguments.n)
    done = [own for own in read_log(arguments.log, key) if own.number in wanted]
    finished = {own.number for own in done}
    numbers = [number for number in wanted if number not in finished]

    def store(own: Outcome) -> None:
        if arguments.log is not None:
            with arguments.log.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"key": key, "outcome": asdict(own)}) + "\n")

    judge = partial(judge_number, seed=arguments.seed, kind=arguments.kind, row=arguments.row, motion=arguments.motion)
    done += each(judge, numbers, workers=arguments.workers, title="judging", terminal=terminal, show=store)
    headers = ("number", "kind", "row", "motion", "hidden", "outcome", "named", "largest z", "remedies")
    lines = [
        (str(own.number), own.kind, own.row, own.motion, own.hidden, own.outcome, own.named,
         f"{own.z:+.1f} {own.parameter}", own.remedies)
        for own in sorted(done, key=lambda own: own.number) if own.outcome in ("declined", "wrong")
    ]  # fmt: skip
    terminal.print_table(headers, lines, left=headers[1:])
    for title in ("kind", "row", "motion"):
        print_counts(title, done, title, terminal)
    return 0


if __name__ == "__main__":
    sys.exit(main())
