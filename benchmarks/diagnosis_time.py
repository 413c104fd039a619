"""Seconds and memory that a diagnosis of a pendulum needs, and how both grow; `six_joint` tells an arm's.

python -m benchmarks.diagnosis_time
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import numpy as np

from benchmarks.independent_plant import Experiment, Plant, simulate
from benchmarks.parallel import each, peak_memory
from estimators import diagnose
from pendulum_env.recording import Recording
from workbench.terminal import Terminal

AIM = 5.0  # [s], for 20 s at 1 kHz
SECONDS, RATE = 20.0, 1000.0  # [s], [Hz]
LENGTHS = (10.0, 20.0, 40.0, 80.0, 160.0)  # [s]
GROWING = "stribeck"  # the plant whose recordings grow
PLANTS = {
    "nothing": Plant(),
    "torque_offset": Plant(effects={"torque_offset": {"offset": 0.2}}),
    "stribeck": Plant(effects={"stribeck": {"strib_d": 0.45, "strib_v": 0.5}}),
    "cogging": Plant(effects={"cogging": {"cog_n": 14.0, "cog_s": 0.15, "cog_c": 0.1}}),
    "payload_change": Plant(effects={"payload_change": {"pay_t": 8.0, "pay_I": 0.02, "pay_mgl": 0.4}}),
    "presliding": Plant(effects={"presliding": {"dahl_sigma": 40.0}}),
    "joint_flexibility": Plant(effects={"joint_flexibility": {"Jm": 0.03, "bl_k": 22.0, "bl_d": 0.05}}),
    "backlash": Plant(effects={"backlash": {"Jm": 0.02, "bl_gap": 0.02, "bl_k": 400.0, "bl_d": 0.8}}),
    "torque_offset+quadratic_drag": Plant(effects={"torque_offset": {"offset": 0.2}, "quadratic_drag": {"drag": 0.04}}),
    "knocks, outside the library": Plant(effects={"knocks": {"knock_rate": 0.6, "knock_height": 3.0}}),
}


@dataclass(frozen=True)
class Timing:
    """One diagnosis of one recording, its end held out."""

    label: str
    seconds: float  # of the recording
    took: float  # [s]
    memory: float  # peak of a fresh process [MB]
    selected: tuple[str, ...]


def time_diagnosis(case: tuple[str, Recording]) -> Timing:
    """Diagnose one recording."""
    label, recording = case
    begin = perf_counter()
    found = diagnose([recording])
    return Timing(label, recording.duration, perf_counter() - begin, peak_memory(), found.selected)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.diagnosis_time", description=__doc__.splitlines()[0])
    parser.parse_args(argv)
    terminal = Terminal()
    longest = Experiment(rate=RATE, seconds=max(LENGTHS), seed=1)
    usual = [Experiment(rate=RATE, seconds=SECONDS, seed=1)] * len(PLANTS)
    with terminal.progress("simulating"):
        runs = simulate([*zip(PLANTS.values(), usual, strict=True), (PLANTS[GROWING], longest)])
    *several, whole = [Recording("timed", run.time, run.position, run.torque) for run in runs]
    lengths = [whole.slice(0, round(seconds * RATE)) for seconds in LENGTHS]
    # one at a time, so that they do not compete, and each in a process of its own, for its memory
    timed = partial(each, time_diagnosis, workers=1, fresh=True, terminal=terminal)
    by_effect = timed(list(zip(PLANTS, several, strict=True)), title="diagnosing")
    by_length = timed([(GROWING, recording) for recording in lengths], title="diagnosing longer ones")

    terminal.heading(f"Diagnosis of {SECONDS:g} s at {RATE:g} Hz, aim {AIM:g} s")
    rows = [(t.label, f"{t.took:.1f}", f"{t.memory:.0f}", "+".join(t.selected) or "nothing") for t in by_effect]
    terminal.table(("hidden", "time [s]", "memory [MB]", "selected"), rows, left=("selected",))
    if by_effect:
        took = [t.took for t in by_effect]
        terminal.say(f"median {np.median(took):.1f} s, longest {max(took):.1f} s")
    terminal.heading(f"Growth, {GROWING} hidden, at {RATE:g} Hz")
    rows = [
        (f"{t.seconds:.0f}", f"{t.took:.2f}", f"{1e3 * t.took / t.seconds:.1f}", f"{t.memory:.0f}") for t in by_length
    ]
    terminal.table(("recording [s]", "time [s]", "per recorded second [ms]", "memory [MB]"), rows)
    if len(by_length) > 1:
        power = np.polyfit(np.log([t.seconds for t in by_length]), np.log([t.took for t in by_length]), 1)[0]
        terminal.say(f"time grows as length to the power {power:.2f}, aim 1")
    return 0 if len(by_effect) + len(by_length) == len(PLANTS) + len(LENGTHS) else 130


if __name__ == "__main__":
    sys.exit(main())
