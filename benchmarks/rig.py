"""Rate and jitter of the rig's loop over each adapter, its drive emulated in another process."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import gymnasium as gym
import numpy as np

from pendulum_env.registration import PENDULUM
from workbench.terminal import Terminal

RATES = {"serial": (500.0, 1000.0, 2000.0), "canopen402": (250.0, 500.0, 1000.0), "nidaq": (100.0, 250.0, 500.0)}


def rows(kind: str, rate: float, seconds: float, realtime: bool) -> tuple[str, ...]:
    """Adapter, rate, cost of an exchange, and how late its samples were."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "rig.toml"
        command = [sys.executable, "-m", "workbench.cli", "emulate", kind, "--rate", str(rate), "-o", str(config)]
        command += ["--watchdog", "2", *(["--realtime"] if realtime else [])]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as emulator:
            assert emulator.stdin is not None and emulator.stdout is not None
            emulator.stdout.readline()
            env = gym.make(PENDULUM, backend="dm1015b", config=config, max_episode_steps=-1)
            env.reset()
            backend = env.unwrapped.backend  # type: ignore[attr-defined]
            late, cost = [], []
            info: dict[str, float] = {"overruns": 0}
            for k in range(int(seconds * rate)):
                action = np.array([3 * np.sin(8 * k / rate)], dtype=np.float32)
                *_, terminated, _, info = env.step(action)
                if terminated:
                    break
                late.append(info["jitter"])
            for _ in range(200):  # without waiting for ticks
                begin = time.perf_counter()
                backend.guard.write(0.0)
                backend.guard.read()
                cost.append(time.perf_counter() - begin)
            env.close()
            emulator.communicate("quit\n")
    shown = [f"{1e3 * value:.2f}" for value in (*np.percentile(cost, (50, 99)), *np.percentile(late, (50, 99, 100)))]
    return (kind, f"{rate:g}", *shown, f"{100 * info['overruns'] / len(late):.2g}")


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--realtime", action="store_true")
    arguments = parser.parse_args(sys.argv[1:] if argv is None else argv)
    terminal = Terminal()
    headers = (
        "adapter", "rate [Hz]", "exchange, median [ms]", "99 % [ms]", "late, median [ms]", "99 % [ms]", "worst [ms]",
        "ticks missed [%]",
    )  # fmt: skip
    table = [rows(kind, rate, arguments.seconds, arguments.realtime) for kind, rates in RATES.items() for rate in rates]
    terminal.table(headers, table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
