"""Surveys of a simulated fleet: what is found, throughput, memory, overhead of a case, and going on after kill -9.

A stub in the place of the diagnosis shows what the rest costs: reading and hashing files, Dask, and the dataset.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
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
from workbench.survey import Case, Dataset, Findings, Fleet, Settings, Tally, find_cases, look, survey
from workbench.survey.cluster import connected
from workbench.survey.work import content_hash
from workbench.terminal import Terminal

BEGAN = datetime(2026, 1, 5, tzinfo=UTC)
NOISE = 0.01  # of the torque [N m]
HIDDEN = 0.25  # Stribeck friction where it is missing [N m]
DRIFT = 0.04  # of the Coulomb friction, in a week
BATCH = 64  # recordings that are simulated together
CLUSTER = 100  # workers that are asked about


@dataclass(frozen=True)
class Plan:
    """A fleet: joints, weeks, what drifts, and what sets in.

    Attributes:
        joints: number of joints, on robots of five.
        weeks: recordings of each, one a week.
        drifting: joints whose Coulomb friction grows, the first ones.
        broken: joints in which Stribeck friction sets in half-way, the last ones.
        seconds: length of a recording.
    """

    joints: int
    weeks: int
    drifting: int
    broken: int
    seconds: float = 10.0

    def label(self, joint: int) -> tuple[str, str]:
        """Robot and joint."""
        return f"arm{joint // 5}", f"joint{joint % 5}"

    def theta(self, joint: int, week: int, rng: np.random.Generator) -> Array:
        """Inertia, gravity, viscous, Coulomb and Stribeck friction (5,) of a joint in a week, and a day's scatter."""
        usual = np.array([0.0895, 2.01, 0.3638, 0.9163, HIDDEN])
        unit = np.random.default_rng(1000 + joint).normal(1.0, [0.01, 0.01, 0.03, 0.03, 0.0])  # no two are alike
        day = rng.normal(1.0, [0.0, 0.0, 0.003, 0.003, 0.0])
        theta: Array = usual * unit * day
        if joint < self.drifting:
            theta[3] *= 1 + DRIFT * week
        if not (joint >= self.joints - self.broken and week >= self.weeks // 2):
            theta[4] = 0.0
        return theta


def record(folder: Path, plan: Plan, rate: float = 500.0) -> None:
    """Simulate the fleet and write a file for each joint and week."""
    rng = np.random.default_rng(0)
    everything = [(joint, week) for joint in range(plan.joints) for week in range(plan.weeks)]
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
            path = folder / robot / name / f"{BEGAN + timedelta(weeks=week):%Y-%m-%d}.parquet"
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


def killed(folder: Path, out: Path, workers: int, after: float) -> tuple[int, int]:
    """Rows that a survey has written when it is killed after some seconds, and workers that outlive it by five."""
    command = [sys.executable, "-m", "workbench.cli", "survey", str(folder), "-o", str(out), "--workers", str(workers)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not Dataset(out).parts and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.1)
    time.sleep(after)
    children = psutil.Process(process.pid).children(recursive=True)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    _, alive = psutil.wait_procs(children, timeout=5)
    return len(Dataset(out).rows(["name"])), len(alive)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=int, default=50, help="recordings that are diagnosed, 0 for none")
    parser.add_argument("--stub", type=int, default=2000, help="recordings that are only read")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args(argv)
    terminal = Terminal()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        overhead = _stubs(folder, arguments.stub, arguments.workers, terminal)
        if arguments.real:
            _real(folder, arguments.real, arguments.workers, overhead, terminal)
    return 0


def _stubs(folder: Path, count: int, workers: int, terminal: Terminal) -> float:
    """Time of a case in this process beside the diagnosis [s], which bounds how many workers it can feed."""
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
        ("second run", f"{again:.2f} s ({unchanged.unchanged} known)"),
        ("dataset, each", f"{sum(p.stat().st_size for p in Dataset(folder / 'stubs').parts) / count:.0f} bytes"),
        ("most memory, client / worker", f"{meter.own:.0f} / {meter.worker:.0f} MB"),
    ]
    terminal.table(("what", "measured"), rows, left=("measured",))
    return own


def _real(folder: Path, count: int, workers: int, overhead: float, terminal: Terminal) -> None:
    plan = Plan(max(5, count // 10), 10, drifting=1, broken=1)
    record(folder / "fleet", plan)
    cases = cases_of(folder / "fleet")
    seconds, tally, meter = measured(cases, folder / "whole", workers, look, terminal)
    rows, orphans = killed(folder / "fleet", folder / "killed", workers, after=0.25 * seconds)
    _, resumed, _ = measured(cases, folder / "killed", workers, look, terminal)
    compared = ("name", "status", "hash", "verdict", "selected", "parameters", "candidates", "diagnosis")
    same = Dataset(folder / "whole").rows(compared) == Dataset(folder / "killed").rows(compared)
    each = sum(row["seconds"] for row in Dataset(folder / "whole").rows(["seconds"])) / len(cases)
    terminal.heading(f"{len(cases)} recordings of {plan.seconds:g} s that are diagnosed, {workers} workers")
    table = [
        ("throughput", f"{60 * len(cases) / seconds:.0f} cases a minute ({tally.done} done)"),
        ("a case, in its worker", f"{each:.2f} s"),
        ("workers busy", f"{each * len(cases) / seconds / workers:.0%}"),
        ("most memory, client / worker", f"{meter.own:.0f} / {meter.worker:.0f} MB"),
        ("written when killed", f"{rows} of {len(cases)}, {orphans} processes left behind"),
        ("then gone on with", f"{resumed.done} done, {resumed.unchanged} known; result the same: {same}"),
        ("workers that one client can feed", f"{each / overhead:.0f}"),
        (f"10,000 cases with {CLUSTER} workers", f"{10_000 * max(each / CLUSTER, overhead) / 60:.1f} min"),
    ]
    terminal.table(("what", "measured"), table, left=("measured",))
    fleet = Fleet.of(Dataset(folder / "whole"))
    terminal.heading("Found")
    terminal.say(f"hidden: Coulomb friction drifts in {'/'.join(plan.label(0))} by {100 * DRIFT:g} % a week, "
                 f"Stribeck friction in {'/'.join(plan.label(plan.joints - 1))} from half-way")  # fmt: skip
    for joint, series in fleet.drifting:
        terminal.say(f"drifts: {joint.label} {series.parameter}")
    for one in fleet.effects:
        since = f" since {one.since:%Y-%m-%d}" if one.since else ""
        terminal.say(f"missing: {one.joint.label} {one.effect} in {one.cases} of {one.of}{since}")
    for odd in fleet.odd:
        terminal.say(f"odd: {odd.joint.label} {odd.series.parameter}")
    for shared in fleet.shared:
        terminal.say(f"weak in each: {shared.group} {shared.effect} {shared.pooled.total:.3g} nats")


if __name__ == "__main__":
    sys.exit(main())
