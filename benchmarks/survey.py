"""A survey of ten thousand recordings but for their diagnoses: throughput, memory and kills.

Every recording is simulated, written, hashed and read; what a diagnosis finds of one of them stands for what it finds
of each. What a survey finds is measured by `benchmarks.fleet`. Ends with 1 unless surveys whose client and one of
whose workers are killed come to what the uninterrupted one did.
"""

from __future__ import annotations

import argparse
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
import psutil
from distributed import Client

from pendulum_env._typing import JSON, Array
from pendulum_env.excitation import excitation
from pendulum_env.recording import Recording, write_recording
from pendulum_env.vector_env import DirectDrivePendulumVector
from workbench.commands.survey import configure
from workbench.processes import connected
from workbench.survey import Case, Dataset, Fleet, Settings, Tally, find_cases, look, survey
from workbench.survey.page import render
from workbench.survey.work import Look, content_hash
from workbench.terminal import Terminal

BEGAN = datetime(2026, 1, 5, tzinfo=UTC)
NOISE = 0.01  # of the torque [N m]
HIDDEN = 0.25  # Stribeck friction where it is missing [N m]
GROWTH = 0.2  # of the Coulomb friction where it drifts, over all weeks
BATCH = 64  # recordings that are simulated together
FOUND = "found.pickle"  # what stands for every diagnosis
COMPARED = ("name", "status", "hash", "verdict", "selected", "parameters", "candidates", "diagnosis")


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


def record(folder: Path, plan: Plan, rate: float = 500.0) -> None:
    """Simulate the fleet and write a file for each joint and week."""
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


def stub(case: Case, settings: Settings) -> JSON:
    """Read a recording, and tell what was found of another."""
    case.source.read()
    assert settings.folder is not None
    return _found(settings.folder)


@cache
def _found(folder: Path) -> JSON:
    found: JSON = pickle.loads((folder / FOUND).read_bytes())
    return found


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
    client: Client,
    cases: Sequence[Case],
    out: Path,
    finder: Look = look,
    settings: Settings | None = None,
    tell: Callable[[Tally], None] = lambda tally: None,
) -> tuple[float, Tally]:
    """Seconds of a survey without the start of its workers, and its tally."""
    client.run(lambda: __import__("workbench.survey"))  # which takes a second or two
    begun = time.perf_counter()
    tally = survey(cases, Dataset(out), client, settings, look=finder, tell=tell)
    return time.perf_counter() - begun, tally


def killed(command: Sequence[str], out: Path, rows: int) -> tuple[int, int]:
    """Rows that a survey has written when it is killed, once there are so many, and processes that outlive it."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(Dataset(out).rows(["name"])) < rows and process.poll() is None:
        time.sleep(3.0)  # looking takes time itself
    children = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
    process.kill()
    process.wait()
    _, alive = psutil.wait_procs(children, timeout=30)
    return len(Dataset(out).rows(["name"])), len(alive)


def gone_on(folder: Path, workers: int, worker_dies_at: float = np.inf) -> Tally:
    """Survey `data` to `broken`; a worker is killed once so many cases are through."""
    with connected(None, workers) as client:
        victims = [next(iter(client.run(os.getpid).values()))]

        def tell(tally: Tally) -> None:
            if victims and tally.through >= worker_dies_at:
                os.kill(victims.pop(), signal.SIGKILL)

        return measured(client, cases_of(folder / "data"), folder / "broken", stub, Settings(folder=folder), tell)[1]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=10_000, help="recordings, of 20 joints (default 10000)")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each (default 20)")
    parser.add_argument("--rate", type=float, default=200.0, help="of each [Hz] (default 200)")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        return _run(Path(name), arguments, Terminal())


def _run(folder: Path, arguments: argparse.Namespace, terminal: Terminal) -> int:
    data, whole, broken = (folder / name for name in ("data", "whole", "broken"))
    workers, settings = arguments.workers, Settings(folder=folder)
    begun = time.process_time()
    record(data, Plan(20, arguments.n // 20, 0, 0, arguments.seconds), arguments.rate)
    simulated = time.process_time() - begun
    begun = time.perf_counter()
    cases = cases_of(data)
    count, listed = len(cases), time.perf_counter() - begun
    (folder / FOUND).write_bytes(pickle.dumps(look(cases[0], Settings())))
    begun = time.process_time()
    for case in cases[:100]:
        content_hash(case.source.file)
        stub(case, settings)
    read = (time.process_time() - begun) / len(cases[:100])

    meter = Meter()
    with connected(None, workers) as client:
        before = time.process_time()  # of scheduler, client and dataset; without waiting for workers
        seconds, _ = measured(client, cases, whole, stub, settings, meter)
        own = (time.process_time() - before) / count
        again, known = measured(client, cases, whole, stub, settings)
    command = f"from benchmarks.survey import *; gone_on(Path({str(folder)!r}), {workers})"
    rows, orphans = killed([sys.executable, "-c", command], broken, count // 3)
    rest = gone_on(folder, workers, 2 * count / 3)
    same = Dataset(whole).rows(COMPARED) == Dataset(broken).rows(COMPARED)
    begun = time.perf_counter()
    page = render(Fleet.of(Dataset(whole)), whole)
    shown = time.perf_counter() - begun

    terminal.heading(f"{count} recordings of {arguments.seconds:g} s at {arguments.rate:g} Hz, {workers} workers")
    table = [
        ("simulated and written, each", f"{1e3 * simulated / count:.0f} ms"),
        ("listed, all", f"{listed:.1f} s"),
        ("hashed and read, each", f"{1e3 * read:.1f} ms"),
        ("throughput", f"{count / seconds:.0f} a second"),
        ("client and scheduler, each", f"{1e3 * own:.1f} ms"),
        ("most memory, client / worker", f"{meter.own:.0f} / {meter.worker:.0f} MB"),
        ("second run", f"{again:.1f} s ({known.known.total()} known)"),
        ("client killed", f"with {rows} written, {orphans} processes left behind"),
        (
            "gone on with, and a worker killed",
            f"{rest.new['done']} done, {rest.new['failed']} failed; result the same: {same}",
        ),
        ("page of all", f"{shown:.0f} s, {len(page) / 1e6:.0f} MB"),
    ]
    terminal.table(("what", "measured"), table, left=("measured",))
    return int(not same or bool(orphans or rest.new["failed"]))


if __name__ == "__main__":
    sys.exit(main())
