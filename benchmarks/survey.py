"""Surveys that only read: what a case costs beside its diagnosis, and so how many workers one client feeds.

That is reading and hashing files, Dask, and the dataset. What a survey finds is measured by `benchmarks.fleet`.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import psutil

from pendulum_env._typing import Array
from pendulum_env.excitation import excitation
from pendulum_env.recording import Recording, write_recording
from pendulum_env.vector_env import DirectDrivePendulumVector
from workbench.commands.survey import configure
from workbench.survey import Case, Dataset, Findings, Settings, Tally, find_cases, survey
from workbench.survey.cluster import connected
from workbench.survey.work import content_hash
from workbench.terminal import Terminal

BEGAN = datetime(2026, 1, 5, tzinfo=UTC)
NOISE = 0.01  # of the torque [N m]
HIDDEN = 0.25  # Stribeck friction where it is missing [N m]
GROWTH = 0.2  # of the Coulomb friction where it drifts, over all weeks
BATCH = 64  # recordings that are simulated together
DIAGNOSIS = 1.5  # [s] of a core, of a recording of 10 s at 500 Hz


@dataclass(frozen=True)
class Plan:
    """A fleet: joints, weeks, what drifts, and what sets in.

    Attributes:
        joints: number of joints, on robots of five.
        weeks: recordings of each, one a week.
        drifting: joints whose Coulomb friction grows, the first ones.
        broken: joints in which Stribeck friction sets in half-way, the last ones.
        seconds: length of a recording.
        growth: of the Coulomb friction that drifts, in a week, as a share.
    """

    joints: int
    weeks: int
    drifting: int
    broken: int
    seconds: float = 10.0
    growth: float = 0.0

    def label(self, joint: int) -> tuple[str, str]:
        """Robot and joint."""
        return f"arm{joint // 5}", f"joint{joint % 5}"

    def theta(self, joint: int, week: int, rng: np.random.Generator) -> Array:
        """Inertia, gravity, viscous, Coulomb and Stribeck friction (5,) of a joint in a week, and a day's scatter."""
        usual = np.array([0.0895, 2.01, 0.3638, 0.9163, HIDDEN])
        unit = np.random.default_rng(1000 + joint).normal(1.0, [0.01, 0.01, 0.03, 0.03, 0.0])  # no two are alike
        today = rng.normal(1.0, [0.0, 0.0, 0.003, 0.003, 0.0])
        theta: Array = usual * unit * today
        if joint < self.drifting:
            theta[3] *= 1 + self.growth * week
        if not (joint >= self.joints - self.broken and week >= self.weeks // 2):
            theta[4] = 0.0
        return theta


def day(week: int) -> datetime:
    """When the joints are recorded in a week."""
    return BEGAN + timedelta(weeks=week)


def record(folder: Path, plan: Plan, rate: float = 500.0, everything: Sequence[tuple[int, int]] | None = None) -> None:
    """Simulate the fleet and write a file for each joint and week, or for some."""
    if everything is None:
        everything = [(joint, week) for joint in range(plan.joints) for week in range(plan.weeks)]
    rng = np.random.default_rng(len(everything))
    for start in range(0, len(everything), BATCH):
        part = everything[start : start + BATCH]
        plants = DirectDrivePendulumVector(len(part), effects=["stribeck"], torque_noise=NOISE, rate=rate)
        plants.set_theta(np.column_stack([plan.theta(joint, week, rng) for joint, week in part]))
        clock = np.arange(round(plan.seconds * rate)) / rate
        torque = np.column_stack([excitation("paper", rng, plan.seconds).signal(clock) for _ in part])
        plants.reset(seed=start)
        shown = [plants.step(row[:, None].astype(np.float32))[-1] for row in torque]
        for k, (joint, week) in enumerate(part):
            robot, name = plan.label(joint)
            path = folder / robot / name / f"{day(week):%Y-%m-%d}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            columns = {what: np.array([info[what][k] for info in shown]) for what in ("time", "position", "torque")}
            write_recording(Recording(path.stem, **columns), path)


def stub(case: Case, settings: Settings) -> Findings:
    """Read a recording and find nothing."""
    recording = case.source.read()
    parameters = ({"name": "inertia", "value": float(np.std(recording.torque)), "std": 0.01, "unit": "kg m^2"},)
    return Findings(
        "nothing", "Nothing is missing", None, (), (), (), parameters, "N m", 0.01, 0.01, 1e-3, len(recording),
        recording.duration, "{}",
    )  # fmt: skip


def cases_of(folder: Path) -> list[Case]:
    parser = argparse.ArgumentParser()
    configure(parser)
    return find_cases([str(folder)], parser.parse_args([str(folder), "-o", "-"]))


class Meter:
    """Most memory of this process and of its children [MB], looked at after each case."""

    def __init__(self) -> None:
        self.own, self.worker, self._last = 0.0, 0.0, 0.0

    def __call__(self, tally: Tally) -> None:
        if time.monotonic() - self._last < 3.0:  # looking takes time itself
            return
        self._last, process = time.monotonic(), psutil.Process()
        self.own = max(self.own, process.memory_info().rss / 1e6)
        for child in process.children(recursive=True):
            try:
                self.worker = max(self.worker, child.memory_info().rss / 1e6)
            except psutil.NoSuchProcess:
                continue


def measured(
    cases: Sequence[Case], out: Path, workers: int, finder: object, terminal: Terminal
) -> tuple[float, Tally, Meter]:
    """Seconds of a survey without the start of its workers, and what it took."""
    meter = Meter()
    with connected(None, workers) as client:
        client.wait_for_workers(workers)
        client.run(lambda: __import__("workbench.survey"))  # which takes a second or two
        begun = time.perf_counter()
        tally = survey(cases, Dataset(out), client, look=finder, tell=meter)  # type: ignore[arg-type]
        return time.perf_counter() - begun, tally, meter


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stub", type=int, default=2000, help="recordings (default 2000)")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        _stubs(Path(name), arguments.stub, arguments.workers, Terminal())
    return 0


def _stubs(folder: Path, count: int, workers: int, terminal: Terminal) -> None:
    distinct = min(count, 40)
    begun = time.perf_counter()
    record(folder / "few", Plan(distinct, 1, 0, 0))
    simulated = (time.perf_counter() - begun) / distinct
    files = sorted((folder / "few").rglob("*.parquet"))
    many = folder / "many"
    many.mkdir()
    for k in range(count):
        os.link(files[k % distinct], many / f"joint{k % 20}_{BEGAN + timedelta(days=k // 20):%Y-%m-%d}.parquet")
    begun = time.perf_counter()
    cases = cases_of(many)
    listed = time.perf_counter() - begun
    begun = time.perf_counter()
    for case in cases[:distinct]:
        content_hash(case.source.file)
        stub(case, Settings())
    read = (time.perf_counter() - begun) / distinct
    before = time.process_time()
    seconds, tally, meter = measured(cases, folder / "stubs", workers, stub, terminal)
    own = (time.process_time() - before) / count  # scheduler, client and dataset; without waiting for workers
    again, unchanged, _ = measured(cases, folder / "stubs", workers, stub, terminal)
    terminal.heading(f"{count} recordings that are only read, {workers} workers")
    rows = [
        ("simulated, each", f"{1e3 * simulated:.1f} ms"),
        ("listed, all", f"{listed:.2f} s"),
        ("throughput", f"{count / seconds:.0f} cases/s ({tally.done} done)"),
        ("hashed and read, each", f"{1e3 * read:.1f} ms"),
        ("client and scheduler, each", f"{1e3 * own:.2f} ms"),
        (f"workers that one client can feed with {DIAGNOSIS:g} s each", f"{DIAGNOSIS / own:.0f}"),
        ("second run", f"{again:.2f} s ({unchanged.unchanged} known)"),
        ("dataset, each", f"{sum(p.stat().st_size for p in Dataset(folder / 'stubs').parts) / count:.0f} bytes"),
        ("most memory, client / worker", f"{meter.own:.0f} / {meter.worker:.0f} MB"),
    ]
    terminal.table(("what", "measured"), rows, left=("measured",))


if __name__ == "__main__":
    sys.exit(main())
