"""CPU time of `diagnose` [s] and of online samples [ms], each in a separate process.

    python -m benchmarks.timing [--other FOLDER] [NAME ...]

Cases are recordings of the independent plant, 20 s to fit and 20 s held out at 1 kHz, and of the arm of `six_joint`.
`--other` is a checkout of another version (`git worktree add`), measured for comparison.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks import six_joint
from benchmarks.independent_plant import random_case, simulate, write_case
from benchmarks.six_joint import Hidden
from pendulum_env.recording.storage import write_recording
from workbench.terminal import Terminal

PENDULUM = ("", "quadratic_drag", "stribeck", "cogging", "load_dependent_friction", "torque_saturation", "backlash")
LOADED = (Hidden("load_dependent_friction", 1), Hidden("load_dependent_friction", 2))
ARM = {  # hidden effects, rate [Hz], seconds to fit and held out, factor of the noise
    "six joints, nothing hidden": ((), 500.0, (20.0,), 1.0),
    "six joints, a spring": ((Hidden("spring", 2),), 500.0, (20.0,), 1.0),
    "six joints, friction by load at two": (LOADED, 94.0, (50.0, 40.0), 5.0),
}
LIMITS = {  # [s]
    "pendulum, backlash": 8.0,
    "six joints, nothing hidden": 8.0,
    "six joints, friction by load at two": 30.0,
}
# algorithm, rate [Hz], and longest CPU time of a sample [ms]
ONLINE = {
    "DiagnoseOnline, all effects": ("Diagnoser", 1000.0, 5.0),
    "DiagnoseOnline, all effects, 200 Hz": ("Diagnoser", 200.0, 5.0),
    "EstimateParameters, six schemes": ("OnlineEstimator", 1000.0, 5.0),
}
SHARES = (50.0, 99.0, 99.9, 100.0)  # [%], percentiles of the time of a sample
FEED = """
import time
import numpy as np
from estimators.online import Diagnoser, OnlineEstimator
from pendulum_env.backends import record
from pendulum_env.excitation import excitation
run = record(None, excitation("paper", 1), 20.0, rate={rate}, rng=1)
samples = [tuple(np.full(1, value) for value in each) for each in zip(run.time, run.position, run.torque)]
algorithm, times = {algorithm}({rate}), []
for sample in samples:
    begin = time.thread_time()
    algorithm.take(*sample)
    times.append(1e3 * (time.thread_time() - begin))
print(np.mean(times), *np.percentile(times, {shares}))
"""
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
HERE = Path(__file__).resolve().parents[1]


def make_environment(version: Path) -> dict[str, str]:
    """Return the environment of a process with one thread that imports the packages of a checkout, compiled once."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}  # as installed
    return kept | ONE_THREAD | {"PYTHONPATH": str(version.resolve())}


def measure_online(version: Path, algorithm: str, rate: float) -> list[float]:
    """Return mean and percentiles of the CPU time of a sample [ms], least of three runs of 20 s each."""
    line = [sys.executable, "-P", "-c", FEED.format(algorithm=algorithm, rate=rate, shares=SHARES)]
    environment = make_environment(version)
    runs = (subprocess.run(line, capture_output=True, text=True, check=True, env=environment) for _ in "abc")
    return np.min([np.fromstring(run.stdout, sep=" ") for run in runs], axis=0).tolist()


def write_inputs(name: str, folder: Path) -> list[str]:
    """Write the recordings of a case, and return the arguments of `diagnose`."""
    if name not in ARM:
        effect = name.removeprefix("pendulum, ").replace("nothing", "")
        case = random_case(np.random.default_rng(1), (effect,) if effect else (), rate=1000.0, seconds=20.0)
        write_case(folder, "case", *simulate([(case.plant, case.train), (case.plant, case.holdout)]))
        train, holdout = (next(folder.rglob(f"*{part}*.csv*")) for part in ("train", "holdout"))
        return [str(train), "--holdout", str(holdout)]
    hidden, rate, lengths, factor = ARM[name]
    (folder / "arm.urdf").write_text(six_joint.urdf())
    files = [folder / f"{part}.csv" for part, _ in zip(("train", "holdout"), lengths, strict=False)]
    for seed, (file, seconds) in enumerate(zip(files, lengths, strict=True), 1):
        write_recording(six_joint.simulate(seed, hidden, seconds, rate=rate, noise=factor * six_joint.NOISE), file)
    others = [text for file in files[1:] for text in ("--holdout", str(file))]
    return [str(files[0]), *others, "--robot", str(folder / "arm.urdf"), "--rotors"]


def measure(version: Path, arguments: Sequence[str]) -> float:
    """Return the CPU seconds [s] of `diagnose` with one thread."""
    code = "from workbench.entry import main; raise SystemExit(main())"
    line = [sys.executable, "-P", "-c", code, "diagnose", *arguments]  # -P: no package of the working folder
    run = subprocess.Popen(line, stdout=subprocess.DEVNULL, env=make_environment(version))
    _, status, usage = os.wait4(run.pid, 0)
    if status:
        raise SystemExit(f"diagnose ended with code {os.waitstatus_to_exitcode(status)}: run {' '.join(line)}")
    return usage.ru_utime + usage.ru_stime


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.timing", description=__doc__.splitlines()[0])
    names = [*(f"pendulum, {effect or 'nothing'}" for effect in PENDULUM), *ARM, *ONLINE]
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of the cases: {'; '.join(names)}")
    parser.add_argument("--other", metavar="FOLDER", type=Path, help="checkout of another version, for the ratio")
    arguments = parser.parse_args(argv)
    if unknown := sorted({*arguments.names} - {*names}):
        parser.error(f"unknown case {unknown[0]!r}: choose from {'; '.join(names)}")
    terminal, rows, online_rows = Terminal(), [], []
    for name in arguments.names or names:
        if name in ONLINE:
            algorithm, rate, limit = ONLINE[name]
            for version, suffix in ((HERE, ""), (arguments.other, ", other")):
                if version is not None:
                    times = measure_online(version, algorithm, rate)
                    online_rows.append((name + suffix, *(f"{value:.2f}" for value in times), f"{limit:g}"))
            continue
        with tempfile.TemporaryDirectory() as folder:
            inputs = write_inputs(name, Path(folder))
            here = measure(HERE, inputs)
            other = measure(arguments.other, inputs) if arguments.other else np.nan
        beside = (f"{other:.1f}", f"{here / other:.2f}") if arguments.other else ()
        rows.append((name, f"{here:.1f}", *beside, f"{LIMITS[name]:g}" if name in LIMITS else ""))
    beside = ("other [s]", "ratio") if arguments.other else ()
    if rows:
        terminal.print_table(("case", "CPU [s]", *beside, "limit [s]"), rows, left=("case",))
    if online_rows:
        headers = ("sample [ms]", "mean", *(f"{share:g} %" for share in SHARES), "limit")
        terminal.print_table(headers, online_rows, left=headers[:1])
    return 0


if __name__ == "__main__":
    sys.exit(main())
