"""Steps per second of the environments and of similar ones, and times of imports.

The CPU time per step is the least of several repetitions, to exclude other work on the machine.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence

import gymnasium as gym
import numpy as np

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
    aim = "aim: as fast as Pendulum-v1, faster than MuJoCo"
    rows.append(("DirectDrivePendulum-v0", cpu(stepping(gym.make(PENDULUM), push)), aim))
    rows.append(("the same, 2 substeps", cpu(stepping(gym.make(PENDULUM, substeps=2), push)), ""))
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
        ("Batched environment", "million steps per s", batches()),
        ("Imports", "s", imports()),
    ):
        terminal.print_heading(title)
        terminal.print_table(
            ("what", unit, "note"), [(what, f"{value:.3g}", note) for what, value, note in rows], left=("note",)
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
