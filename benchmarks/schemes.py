"""Seconds that six schemes need for recordings of growing length: growth should be linear.

python -m benchmarks.schemes
"""

from __future__ import annotations

import sys
from time import perf_counter

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.schemes.identification import identify
from pendulum_env.recording import Recording

LENGTHS = (10.0, 20.0, 40.0, 60.0, 80.0, 160.0)  # [s]
REPEATS = 3


def main() -> int:
    plant, experiment = Plant(), Experiment(rate=1000.0, seconds=max(LENGTHS), seed=1)
    (run,) = simulate([(plant, experiment)])
    whole = Recording("paper's run", run.time, run.position, run.torque)
    print("six schemes with their histories, measurements included, at 1 kHz")
    print("recording [s]   time [s]   per recorded second [ms]")
    for seconds in LENGTHS:
        recording = whole.slice(0, round(seconds * experiment.rate))
        times = []
        for _ in range(REPEATS):
            begin = perf_counter()
            identify([recording])
            times.append(perf_counter() - begin)
        print(f"{seconds:13.0f}   {min(times):8.3f}   {1e3 * min(times) / seconds:24.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
