"""Errors, coverage and CPU time of seven online estimators and two recursions, from 25 Hz to 1 kHz.

python -m benchmarks.joint_state

Random plants, excitations and closed loops of the independent simulator, 10 s each, torque noise 0.05 N m RMS.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.independent_plant import SimulatedRecording, random_case, simulate
from estimators.online import Estimates, JointState, OnlineEstimator
from estimators.online.recursion import RECURSIONS
from estimators.schemes.six import SCHEMES, LowPass, Scheme
from estimators.signals.measurements import compute_encoder_noise
from workbench.terminal import Terminal

RATES = (25.0, 50.0, 100.0, 200.0, 500.0, 1000.0)  # [Hz]
COUNTS = (1_024_000, 8192)
SECONDS = 10.0
SHOWN = tuple(scheme for scheme in SCHEMES if scheme.id != "filtered_hamiltonian")  # online equal to filtered_dynamic


@dataclass(frozen=True)
class Found:
    """Relative errors and standard errors of B runs (B, P)."""

    errors: np.ndarray
    std: np.ndarray

    @property
    def text(self) -> str:
        """Return the median and the 90 % quantile of the errors [%]."""
        half, most = np.quantile(np.abs(self.errors), (0.5, 0.9))
        return f"{_two(100 * half)} ({_two(100 * most)})"

    @property
    def covered(self) -> float:
        return float(np.mean(np.abs(self.errors) < 1.96 * self.std))


def _two(value: float) -> str:
    """Format a number with two digits, without an exponent."""
    return f"{float(f'{value:.2g}'):g}"


def runs_of(rate: float, counts: int, n: int, seed: int) -> list[SimulatedRecording]:
    rng = np.random.default_rng(seed)
    cases = [random_case(rng, rate=rate, counts=counts, torque_noise=0.05, seconds=SECONDS) for _ in range(n)]
    return simulate([(case.plant, case.train) for case in cases])


def feed(estimator: OnlineEstimator, runs: Sequence[SimulatedRecording]) -> tuple[Estimates, float]:
    """Return the estimates after the runs, and the CPU time of a sample [us]."""
    position, torque = (np.array([getattr(run, name) for run in runs]).T for name in ("position", "torque"))
    torque = np.vstack([np.zeros(len(runs)), torque[:-1]])
    begin = time.process_time()
    for k, t in enumerate(runs[0].time):
        now = estimator.take(np.full(len(runs), t), position[k], torque[k])
    return now, (time.process_time() - begin) / len(position) * 1e6


def seven(runs: Sequence[SimulatedRecording], rate: float, counts: int) -> dict[str, Found]:
    can = [one for one in SHOWN if not isinstance(one.operator, LowPass) or one.operator.cutoff < np.pi * rate]
    estimator = OnlineEstimator(
        rate,
        schemes=[*can, JointState()],
        batch=len(runs),
        position_noise=compute_encoder_noise(counts),
    )
    now, _ = feed(estimator, runs)
    plants = [run.plant for run in runs]
    truth = np.array([[p.inertia, p.gravity, p.viscous, p.coulomb] for p in plants])[:, None]
    errors = now.theta / truth - 1
    std = np.sqrt(np.einsum("bsii->bsi", now.covariance)) / truth
    return {one.id: Found(errors[:, s], std[:, s]) for s, one in enumerate(estimator.schemes)}


def accuracy(n: int, seed: int, terminal: Terminal) -> None:
    ids = [*(scheme.id for scheme in SHOWN), JointState.id]
    rows = []
    with terminal.progress("estimating") as progress:
        for k, (counts, rate) in enumerate((counts, rate) for counts in COUNTS for rate in RATES):
            progress(f"{rate:g} Hz", k / (len(COUNTS) * len(RATES)))
            found = seven(runs_of(rate, counts, n, seed), rate, counts)
            errors = [found[id].text if id in found else "-" for id in ids]
            six = np.mean([one.covered for id, one in found.items() if id != JointState.id])
            covered = f"{100 * six:.0f} %", f"{100 * found[JointState.id].covered:.0f} %"
            rows.append((f"{counts:,}", f"{rate:g}", *errors, *covered))
    terminal.print_heading(f"Errors of the parameters after {SECONDS:g} s [%]: half are smaller (nine in ten are)")
    terminal.print_table(("counts", "rate [Hz]", *ids, "95 % intervals of the six", "of the joint state"), rows)


def recursions(seed: int) -> list[tuple[str, ...]]:
    """Return table rows of the CPU time of a sample by recursion, for one scheme and six, and with the joint state."""
    runs, rows = runs_of(1000.0, COUNTS[0], 1, seed), []
    kinds: tuple[Sequence[Scheme], ...] = (SCHEMES[:1], SCHEMES)
    for name in RECURSIONS:
        times = [min(feed(OnlineEstimator(1000.0, schemes=s, recursion=name), runs)[1] for _ in "abc") for s in kinds]
        rows.append((name, *(f"{value:.0f}" for value in times)))
    times = [feed(OnlineEstimator(1000.0, schemes=[*s, JointState()]), runs)[1] for s in ((), SCHEMES)]
    rows.append((f"{JointState.id}, beside none and six", *(f"{value:.0f}" for value in times)))
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.joint_state", description=__doc__.partition("\n")[0])
    parser.add_argument("--n", type=int, default=16, help="plants (default 16)")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    terminal = Terminal()
    terminal.print_heading("CPU time of a sample at 1 kHz, measurement included [us]")
    terminal.print_table(("recursion", "one scheme", "six schemes"), recursions(args.seed))
    accuracy(args.n, args.seed, terminal)
    return 0


if __name__ == "__main__":
    sys.exit(main())
