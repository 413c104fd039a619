"""Diagnosing online: how soon what is hidden is named, and how often something is where nothing is hidden.

python -m benchmarks.diagnosing

Random plants of the independent simulator. Alarms in plants that lack nothing are counted in hours of motion, under
four sensors and four excitations; effects have 3 % of the RMS torque or more.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.independent_plant import SimulatedRecording, effect_share, random_case, simulate
from benchmarks.scoring import rate as share
from benchmarks.watching import EXCITATIONS, SENSORS, SHARE
from estimators.online import Diagnoser, OnlineDiagnosis
from estimators.signals.measurements import Smoothing
from workbench.terminal import Terminal

MOMENTS = (5.0, 10.0, 20.0)  # [s]
EFFECTS = (
    "stribeck",
    "cogging",
    "quadratic_drag",
    "load_dependent_friction",
    "torque_offset",
    "coulomb_asymmetry",
    "position_dependent_friction",
    "spring",
)


def diagnosed(run: SimulatedRecording, alarms_per_hour: float = 1.0) -> list[tuple[float, OnlineDiagnosis]]:
    """What is said of a run, and since when."""
    rate, counts = run.experiment.rate, run.experiment.counts or 0
    one = Diagnoser(rate, smoothing=Smoothing.of_encoder(counts, rate), alarms_per_hour=alarms_per_hour)
    told: list[tuple[float, OnlineDiagnosis]] = []
    for t, q, tau in zip(run.time, run.position, np.r_[0.0, run.torque[:-1]], strict=True):
        (said,) = one.take(*(np.full(1, value) for value in (t, q, tau)))
        if not told or said is not told[-1][1]:
            told.append((float(t), said))
    return told


def runs_of(rng: np.random.Generator, effect: str, n: int, seconds: float) -> list[SimulatedRecording]:
    """Runs of n plants, drawn until the effect changes the torque as much as it should."""
    found: list[SimulatedRecording] = []
    while len(found) < n:
        k = len(found)
        rate, counts = SENSORS[k // len(EXCITATIONS) % len(SENSORS)]
        case = random_case(
            rng, (effect,) if effect else (), seconds=seconds, torque_noise=0.05, rate=rate, counts=counts
        )
        drawn = replace(case.train, excitation=EXCITATIONS[k % len(EXCITATIONS)], scale=1.0)
        (run,) = simulate([(case.plant, drawn)])
        if not effect or effect_share(run).with_true_parameters >= SHARE:
            found.append(run)
    return found


def nulls(n: int, seconds: float, seed: int, terminal: Terminal) -> None:
    """Nothing is hidden: runs in which something is said to be missing."""
    begin, alarmed, motion, highest = time.process_time(), [], 0.0, []
    for run in runs_of(np.random.default_rng([seed, 99]), "", n, seconds):
        told = diagnosed(run)
        motion += told[-1][1].motion
        highest.append(max(said.evidence for _, said in told))
        wrong = [said for _, said in told if said.kind == "missing"]
        alarmed += [f"{'+'.join(wrong[0].group)} ({run.experiment.excitation})"] if wrong else []
    cost = (time.process_time() - begin) / (n * seconds)
    terminal.heading("Nothing is hidden: runs in which something is said to be missing, where one alarm an hour is set")
    terminal.say(f"{len(alarmed)} in {n} runs, {motion / 3600:.2f} hours of motion: {', '.join(alarmed) or 'none'}")
    highest_said = ", ".join(f"{value:.1f}" for value in sorted(highest)[-5:])
    terminal.say(f"highest evidence {highest_said} nat; {1e3 * cost:.0f} ms of computing for a second")


def detection(n: int, seed: int, terminal: Terminal) -> None:
    """An effect is hidden: when, and how often, it is in the group that is named."""
    rows = []
    for k, effect in enumerate(EFFECTS):
        when, first, last = [], 0, 0
        for run in runs_of(np.random.default_rng([seed, k]), effect, n, max(MOMENTS)):
            told = diagnosed(run)
            right = [t for t, said in told if said.kind == "missing" and effect in said.group]
            when.append(right[0] if right else np.inf)
            last += told[-1][1].kind == "missing" and effect in told[-1][1].group
            first += bool(told[-1][1].group) and told[-1][1].group[0] == effect
        shares = [f"{100 * np.mean(np.array(when) <= moment):.0f} %" for moment in MOMENTS]
        rows.append((effect, f"{np.median(when):.1f}", *shares, share(last, n), share(first, n)))
    headers = ("hidden", "median [s]", *(f"by {moment:g} s" for moment in MOMENTS), "in the last group", "first of it")
    terminal.heading(f"Hidden effects, {n} plants each")
    terminal.table(headers, rows)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.diagnosing", description=__doc__.partition("\n")[0])
    parser.add_argument("--n", type=int, default=16, help="plants for each effect (default 16)")
    parser.add_argument("--nulls", type=int, default=32, help="plants without any (default 32)")
    parser.add_argument("--seconds", type=float, default=120.0, help="that each of those runs for (default 120)")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    terminal = Terminal()
    if args.nulls:
        nulls(args.nulls, args.seconds, args.seed, terminal)
    if args.n:
        detection(args.n, args.seed, terminal)
    return 0


if __name__ == "__main__":
    sys.exit(main())
