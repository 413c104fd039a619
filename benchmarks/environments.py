"""Steps per second of environments and online estimators, beside their peers, in one run.

CPU time per step, the least of several repetitions, so that other work on the machine does not count.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence

import gymnasium as gym
import numpy as np

from benchmarks.recursion import start, step
from estimators.online.recursion import SquareRootLeastSquares
from estimators.wrappers import DiagnoseOnline, EstimateParameters
from pendulum_env.registration import PENDULUM
from workbench.terminal import Terminal

STEPS, REPEAT = 2000, 5


def cpu(work: Callable[[], object], steps: int = STEPS) -> float:
    """Return the least CPU time per step [us]."""
    work()
    times = []
    for _ in range(REPEAT):
        begin = time.process_time()
        for _ in range(steps):
            work()
        times.append((time.process_time() - begin) / steps * 1e6)
    return min(times)


def stepping(env: gym.Env, action: np.ndarray) -> Callable[[], object]:
    env.reset(seed=0)

    def work() -> None:
        *_, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()

    return work


def environments() -> list[tuple[str, float, str]]:
    one = np.array([0.5], dtype=np.float32)
    rows = [("Gymnasium's Pendulum-v1", cpu(stepping(gym.make("Pendulum-v1"), one)), "")]
    try:
        rows.append(("MuJoCo's InvertedPendulum-v5", cpu(stepping(gym.make("InvertedPendulum-v5"), one)), ""))
    except gym.error.DependencyNotInstalled:
        rows.append(("MuJoCo's InvertedPendulum-v5", np.nan, "pip install mujoco to compare"))
    push = np.array([3.0], dtype=np.float32)
    bare = cpu(stepping(gym.make(PENDULUM), push))
    rows.append(("DirectDrivePendulum-v0", bare, "aim: as fast as Pendulum-v1, faster than MuJoCo"))
    rows.append(("the same, 2 substeps", cpu(stepping(gym.make(PENDULUM, substeps=2), push)), ""))
    wrapped = cpu(stepping(EstimateParameters(gym.make(PENDULUM)), push))
    rows.append(("six estimators add", wrapped - bare, "aim: below 40 us"))
    rows.append(diagnosing(bare))
    return rows


def diagnosing(bare: float) -> tuple[str, float, str]:
    """Measure the time that `DiagnoseOnline` adds per sample at 1 kHz over half a minute, and its longest sample."""
    env = DiagnoseOnline(gym.make(PENDULUM, torque_noise=0.05))
    _, info = env.reset(seed=0)
    signal = 3 * np.sin(12.07 * np.arange(30_000) / 1000) + 3 * np.sin(2.25 * np.arange(30_000) / 1000)
    times = []
    for torque in signal.astype(np.float32)[:, None]:
        begin = time.process_time()
        *_, info = env.step(torque)
        times.append(time.process_time() - begin)
    usual, longest = np.percentile(times, 99) * 1e3, max(times) * 1e3
    note = f"aim: below 400 us; 99 % of samples within {usual:.1f} ms, the longest {longest:.0f} ms"
    effects = len(info["diagnosis"].ranking) + len(info["diagnosis"].not_run)
    return f"DiagnoseOnline, {effects} effects, adds", float(np.mean(times)) * 1e6 - bare, note


def recursions() -> list[tuple[str, float, str]]:
    from filterpy.kalman import KalmanFilter

    rng = np.random.default_rng(0)
    row = rng.normal(size=4)
    kalman = KalmanFilter(4, 1)
    kalman.P, kalman.Q = 1e7 * np.eye(4), np.zeros((4, 4))
    ours = SquareRootLeastSquares((1, 6), 4)
    six = np.tile(row, (1, 6, 1)), np.ones((1, 6)), np.ones((1, 6), dtype=bool)
    state = start(4)
    rows = [
        ("filterpy, one update", cpu(lambda: kalman.update(1.0, H=row[None])), ""),
        ("ours, one update (readable form)", cpu(lambda: step(state, row, 1.0)), ""),
        ("ours, six updates at once", cpu(lambda: ours.take(*six)), "in square-root form"),
    ]
    try:
        from padasip.filters import FilterRLS
    except ImportError:
        rows.append(("padasip, one update", np.nan, "pip install padasip to compare"))
    else:
        peer = FilterRLS(n=4, mu=1.0)
        rows.insert(1, ("padasip, one update", cpu(lambda: peer.adapt(1.0, row)), ""))
    return rows


def batches() -> list[tuple[str, float, str]]:
    rows = []
    for count in (1, 64, 1024, 4096):
        env = gym.make_vec(PENDULUM, num_envs=count, max_episode_steps=None)
        env.reset(seed=0)
        actions = np.random.default_rng(0).uniform(-6, 6, (count, 1)).astype(np.float32)
        each = cpu(lambda env=env, actions=actions: env.step(actions), 200) / count  # type: ignore[misc]
        rows.append((f"{count} pendulums", 1.0 / each, "aim: over 1" if count == 1024 else ""))
    return rows


def imports() -> list[tuple[str, float, str]]:
    def seconds(module: str) -> float:
        code = f"import time; t = time.perf_counter(); import {module}; print(time.perf_counter() - t)"
        runs = [
            subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(5)
        ]
        return min(float(run.stdout) for run in runs)

    aims = {"pendulum_env": "aim: below 0.4 s", "pendulum_env.env": "with Gymnasium and pymunk", "estimators": ""}
    return [(f"import {module}", seconds(module), aim) for module, aim in aims.items()]


def main(argv: Sequence[str] = ()) -> int:
    terminal = Terminal()
    for title, unit, rows in (
        ("One environment", "us per step", environments()),
        ("Recursive least squares, four parameters", "us", recursions()),
        ("Batched environment", "million steps per s", batches()),
        ("Imports", "s", imports()),
    ):
        terminal.heading(title)
        terminal.table(
            ("what", unit, "note"), [(what, f"{value:.3g}", note) for what, value, note in rows], left=("note",)
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
