"""Rate and jitter of the rig's loop over the serial adapter, with a drive emulated in another process."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import gymnasium as gym
import numpy as np

from pendulum_env.registration import PENDULUM
from workbench.terminal import Terminal

RATES = (500.0, 1000.0, 2000.0)  # [Hz]


def start_emulator(
    config: Path, rate: float, limits: Mapping[str, float], realtime: bool = False
) -> subprocess.Popen[str]:
    """Start a process with an emulated rig and generous time limits; the input `quit` ends it."""
    limits = {"behind": 5.0, "overruns": 1_000_000, **limits}
    code = (
        "from pathlib import Path; from pendulum_env.backends.emulators import emulate, make_serial\n"
        "from pendulum_env.plant import paper_plant\n"
        f"emulate(make_serial, paper_plant(), Path({str(config)!r}), {rate}, {{'limits': {limits}}}, "
        f"lambda text: print(text, flush=True), realtime={realtime})"
    )
    command = [sys.executable, "-c", code]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def row(rate: float, seconds: float, realtime: bool) -> tuple[str, ...]:
    """Return a table row: rate, duration of an exchange, lateness of samples, and missed ticks."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "rig.toml"
        with start_emulator(config, rate, {"watchdog": 2.0, "gap": 1.5}, realtime) as emulator:
            assert emulator.stdout is not None
            try:
                emulator.stdout.readline()  # "ready"
                late, cost, missed = measure_loop(config, round(seconds * rate))
            finally:
                emulator.communicate("quit\n")
    shown = [f"{1e3 * value:.2f}" for value in (*np.percentile(cost, (50, 99)), *np.percentile(late, (50, 99, 100)))]
    return (f"{rate:g}", *shown, f"{100 * missed / len(late):.2g}")


def measure_loop(config: Path, steps: int) -> tuple[list[float], list[float], int]:
    """Measure lateness of samples [s], durations of exchanges [s], and the number of missed ticks."""
    env = gym.make(PENDULUM, backend="dm1015b", config=config, max_episode_steps=-1)
    guard = env.unwrapped.backend.guard  # type: ignore[attr-defined]
    late, cost = [], []
    try:
        env.reset()
        for k in range(steps):
            *_, terminated, _, info = env.step(np.array([3 * np.sin(0.01 * k)], dtype=np.float32))
            if terminated:
                raise RuntimeError(info["fault"])
            late.append(info["jitter"])
        for _ in range(200):  # without waiting for ticks
            begin = time.perf_counter()
            guard.write(0.0)
            guard.read()
            cost.append(time.perf_counter() - begin)
    finally:
        env.close()
    return late, cost, info["overruns"]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--realtime", action="store_true")
    arguments = parser.parse_args(sys.argv[1:] if argv is None else argv)
    terminal = Terminal()
    headers = (
        "rate [Hz]", "exchange, median [ms]", "99 % [ms]", "late, median [ms]", "99 % [ms]", "worst [ms]",
        "ticks missed [%]",
    )  # fmt: skip
    table = []
    with terminal.progress("running") as progress:
        for rate in RATES:
            progress(f"{rate:g} Hz", len(table) / len(RATES))
            table.append(row(rate, arguments.seconds, arguments.realtime))
    terminal.print_table(headers, table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
