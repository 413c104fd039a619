"""Blind benchmark: diagnoses of random plants with random hidden effects, and their error rates.

python -m benchmarks.hidden_effects --n 200
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.independent_plant import blind_set, simulate, write_case
from benchmarks.scoring import (
    Curve,
    Outcome,
    examine_all,
    positive,
    print_by_effect,
    print_by_share,
    print_totals,
    rate,
    select_library_cases,
    take_workers,
)
from benchmarks.truth import Truth, read_truth
from pendulum_env.physics import effects
from workbench.terminal import Terminal

NULLS, PAIRS, OUTSIDE = 1 / 5, 1 / 8, 1 / 12  # shares of the set
SIZES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, np.inf)  # bins of the effect's RMS torque over the noise's
SCORES = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9)  # bins of the score
INTERVAL = 1.96  # standard errors, 95 % of a normal distribution


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hidden_effects", description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=positive, default=200, help="recordings (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--wide", action="store_true", help="plants half to twice the usual ranges")
    parser.add_argument("--variants", action="store_true", help="also less usual laws of the same effects")
    parser.add_argument("--misfits", action="store_true", help="each effect beside one that the library lacks")
    parser.add_argument("--out", type=Path, help="folder for the recordings (default build/hidden_effects/...)")
    take_workers(parser)
    arguments = parser.parse_args(argv)
    terminal = Terminal()
    options = {"wide": arguments.wide, "variants": arguments.variants}
    chosen = [key for key, is_chosen in (options | {"misfits": arguments.misfits}).items() if is_chosen]
    name = "_".join([f"n{arguments.n}", f"seed{arguments.seed}", *chosen])
    folder: Path = arguments.out or Path("build") / "hidden_effects" / name

    n = arguments.n
    counts = (0, 0, 0, n) if arguments.misfits else tuple(round(share * n) for share in (NULLS, PAIRS, OUTSIDE))
    truths = generate(folder, n, arguments.seed, counts, options, terminal)
    outcomes = examine_all(folder, truths, arguments.workers, terminal)
    print_results(outcomes, terminal)
    return 0 if len(outcomes) == len(truths) else 130


def generate(
    folder: Path,
    n: int,
    seed: int,
    counts: Sequence[int],
    options: dict[str, bool],
    terminal: Terminal,
) -> list[Truth]:
    """Simulate the set, or read it from the folder; `counts`: of nulls, pairs, outside and misfits."""
    if (folder / "truth.json").exists() and len(truths := read_truth(folder)) == n:
        terminal.print(f"recordings taken from {folder}; delete it to simulate them anew")
        return truths
    (folder / "truth.json").unlink(missing_ok=True)
    cases = blind_set(seed, n, *counts, **options)
    with terminal.progress("simulating") as progress:
        for j, case in enumerate(cases):
            progress(f"{j} of {n}", j / n)
            write_case(folder, f"case_{j:03d}", *simulate([(case.plant, case.train), (case.plant, case.holdout)]))
    return read_truth(folder)


def print_results(outcomes: Sequence[Outcome], terminal: Terminal) -> None:
    """Print every table."""
    wrong = [outcome for outcome in outcomes if not outcome.right]
    terminal.print_heading("Wrong")
    rows = [
        (
            o.truth.name,
            o.truth.label,
            o.failure.partition(":")[0] or "+".join(o.selected) or "nothing",
            f"{o.truth.rate:g}",
            str(o.truth.counts),
            f"{o.truth.noise:g}",
            o.truth.excitation,
            f"{o.truth.share or 0:.1%}",
        )
        for o in wrong
    ]
    columns = ("hidden", "selected", "rate [Hz]", "counts", "noise [N m]", "excitation", "share")
    terminal.print_table(("case", *columns), rows, left=("hidden", "selected", "excitation"))
    print_totals(outcomes, terminal)
    print_by_effect(outcomes, terminal)
    print_by_share(outcomes, terminal)
    for curve in (power(outcomes), reliability(outcomes)):
        curve.print(terminal)
    terminal.print_heading("Parameters within their 95 % intervals, where one effect is hidden and found")
    terminal.print_table(("of", "within"), coverage(outcomes), left=("within",))


# ---------------------------------------------------------------------------------------------------------- statistics


def size(outcome: Outcome) -> float:
    """Return the RMS residual of the refitted base model over the noise of one torque sample."""
    return (outcome.truth.share or 0.0) * outcome.torque / outcome.truth.noise


def power(outcomes: Sequence[Outcome]) -> Curve:
    """Return the share of right diagnoses by the size of the effect relative to the noise."""
    known = [o for o in select_library_cases(outcomes) if not o.failure]
    return Curve.of("effect over noise", "right", SIZES, [(size(o), o.right) for o in known])


def reliability(outcomes: Sequence[Outcome]) -> Curve:
    """Return the share of selected effects that are hidden, alone or as a group, by their score."""
    claims = [(c.score, o.is_right(c)) for o in outcomes for c in o.claims if c.is_selected]
    return Curve.of("score", "right", SCORES, claims)


def coverage(outcomes: Sequence[Outcome]) -> list[tuple[str, str]]:
    """Return shares of estimates within their 95 % intervals: base terms, effects, by sampling rate, by effect."""
    base: list[bool] = []
    by_effect: dict[str, list[bool]] = {}
    by_rate: dict[float, list[bool]] = {}
    for outcome in outcomes:
        if len(outcome.truth.hidden) != 1:
            continue
        for name, z in outcome.deviations.items():
            id, inside = name.partition(".")[0], abs(z) < INTERVAL
            (by_effect.setdefault(id, []) if id in outcome.truth.hidden else base).append(inside)
            by_rate.setdefault(outcome.truth.rate, []).append(inside)
    groups = {"base terms": base, "effects": [inside for group in by_effect.values() for inside in group]}
    groups |= {f"  at {hertz:g} Hz": by_rate[hertz] for hertz in sorted(by_rate)}
    groups |= {f"  {id}": by_effect[id] for id in effects() if id in by_effect}
    return [(name, rate(sum(group), len(group))) for name, group in groups.items()]


if __name__ == "__main__":
    sys.exit(main())
