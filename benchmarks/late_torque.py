"""Detection of torque that is logged late or filtered, and effects that are named in such logs.

Plants have no hidden effect or Stribeck friction. A late log holds the mean torque of each sample after a delay; a
fraction of a sample interpolates between two rows.

    python -m benchmarks.late_torque                # timing, 1 min
    python -m benchmarks.late_torque --diagnose     # timing and effects, 5 min
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.independent_plant import SimulatedRecording, random_case, simulate
from benchmarks.parallel import each
from benchmarks.scoring import rate, take_workers
from estimators import align, diagnose
from pendulum_env.recording import Recording
from workbench.narrator import describe
from workbench.terminal import Terminal

Array = NDArray[np.float64]

EXCITATIONS = ("two_tone", "multisine", "chirp", "prbs", "steps")
RATES = (200.0, 500.0, 1000.0, 2000.0)  # [Hz]
LOGS = (("delay", 0.5), *(("delay", ms) for ms in (1.0, 3.0, 5.0, 10.0, 30.0)), ("filter", 3.0), ("filter", 10.0))
SHARE, SAMPLES = 0.1, 0.2  # largest accepted error: share of the delay, or samples


@dataclass(frozen=True)
class Case:
    """Recording with a late or filtered torque.

    Attributes:
        excitation, rate, hidden: of the recording [Hz].
        kind, ms: delay or time constant of a filter [ms].
        recording: the log.
    """

    excitation: str
    rate: float
    hidden: str
    kind: str
    ms: float
    recording: Recording


@dataclass(frozen=True)
class Found:
    """Result of a case: delay and time constant [ms], text of the finding, and named effects."""

    case: Case
    delay: float
    lag: float
    text: str
    named: tuple[str, ...] | None

    @property
    def is_right(self) -> bool:
        """Return whether the delay, or the mean delay of the filter, is right to 10 % or 0.2 samples."""
        period = 1e3 / self.case.rate
        true, seen = self.case.ms, self.delay + _mean_delay(self.lag, period)
        if self.case.kind == "filter":
            true = _mean_delay(true, period)
        return abs(seen - true) <= max(SHARE * true, SAMPLES * period)

    @property
    def is_named_right(self) -> bool:
        """Return whether exactly the hidden effect is named."""
        return self.named == ((self.case.hidden,) if self.case.hidden else ())


def _mean_delay(lag: float, period: float) -> float:
    """Return the delay of slow torque by a sampled first-order filter [ms]; arguments in ms."""
    return period / float(np.expm1(period / lag)) if lag > 0 else 0.0


def log_torque(run: SimulatedRecording, kind: str, ms: float) -> Array:
    """Return the torque (N,) [N m] of a log with a delay or filter time constant `ms`."""
    samples = 1e-3 * ms * run.experiment.rate
    if kind == "filter":
        keep = np.exp(-1 / samples)
        return np.asarray(lfilter([1 - keep], [1, -keep], run.torque))
    whole, share = divmod(samples, 1.0)
    before = np.concatenate([np.full(int(whole) + 1, run.torque[0]), run.torque])
    return np.asarray((1 - share) * before[1 : 1 + len(run.torque)] + share * before[: len(run.torque)])


def make(hidden: str, seed: int) -> list[Case]:
    """Make the logs of every kind for each excitation and rate."""
    rng = np.random.default_rng(seed)
    counts = (65_536, 1_024_000)
    plants = [
        random_case(rng, (hidden,) if hidden else (), excitation=kind, rate=hertz, counts=counts[j % 2], seconds=15.0)
        for j, (kind, hertz) in enumerate((kind, hertz) for kind in EXCITATIONS for hertz in RATES)
    ]
    runs = simulate([(case.plant, case.train) for case in plants])
    cases = []
    for j, kind in enumerate(EXCITATIONS):
        for k, (law, ms) in enumerate(LOGS):
            run = runs[j * len(RATES) + (j + k) % len(RATES)]
            name = f"{kind} at {run.experiment.rate:g} Hz, {law} of {ms:g} ms"
            recording = Recording(run.time, run.position, log_torque(run, law, ms), name=name)
            cases.append(Case(kind, run.experiment.rate, hidden, law, ms, recording))
    return cases


def examine(case: Case, named: bool) -> Found:
    """Diagnose the timing of one case, and on request its effects."""
    diagnosis = diagnose([case.recording]) if named else None
    found = align(case.recording).alignments[0] if diagnosis is None else diagnosis.alignments[0]
    text = describe(found.finding) if found.finding is not None else ""
    selected = diagnosis.selected if diagnosis is not None else None
    return Found(case, 1e3 * found.delay, 1e3 * found.lag, text, selected)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.late_torque", description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--diagnose", action="store_true", help="also what `diagnose` names")
    parser.add_argument("--hidden", nargs="*", choices=("stribeck",), default=None, help="only behind this effect")
    take_workers(parser)
    arguments = parser.parse_args(argv)
    terminal = Terminal()
    cases = [case for hidden in arguments.hidden or ("", "stribeck") for case in make(hidden, arguments.seed)]
    work = partial(examine, named=arguments.diagnose)
    results = each(work, cases, workers=arguments.workers, title="late torque", terminal=terminal)
    results.sort(key=lambda found: (found.case.hidden, found.case.kind, found.case.ms, found.case.excitation))
    terminal.print_heading("Not found, or not named right")
    rows = [
        (found.case.hidden or "nothing", found.case.recording.name, f"{found.delay:.2f}", f"{found.lag:.2f}")
        + ((", ".join(found.named) or "nothing",) if found.named is not None else ())
        for found in results
        if not found.is_right or (found.named is not None and not found.is_named_right)
    ]
    columns = ("hidden", "log", "delay [ms]", "filter [ms]", *(("named",) if arguments.diagnose else ()))
    terminal.print_table(columns, rows, left=[name for name in columns if "[ms]" not in name])
    terminal.print_heading("Right")
    for hidden in dict.fromkeys(found.case.hidden for found in results):
        own = [found for found in results if found.case.hidden == hidden]
        terminal.print(f"hidden: {hidden or 'nothing'}")
        terminal.print(f"  time found {rate(sum(found.is_right for found in own), len(own))}")
        if arguments.diagnose:
            terminal.print(f"  named and nothing else {rate(sum(found.is_named_right for found in own), len(own))}")
    return 0 if len(results) == len(cases) else 130


if __name__ == "__main__":
    sys.exit(main())
