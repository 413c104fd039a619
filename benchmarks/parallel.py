"""Parallel work on many cases, with a progress bar and partial results after an interrupt."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import TypeVar

from workbench.terminal import Terminal

Item = TypeVar("Item")
Result = TypeVar("Result")

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def each(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    workers: int,
    title: str,
    terminal: Terminal,
    show: Callable[[Result], None] = lambda result: None,
) -> list[Result]:
    """Return the results in order of completion, each passed to `show`; after Ctrl-C or a dead worker, those so far."""
    results: list[Result] = []
    for name in THREADS:
        os.environ[name] = "1"  # read by new processes before they load NumPy
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _quit_quietly)
    try:
        with terminal.progress(title) as progress:
            for future in as_completed([pool.submit(work, item) for item in items]):
                results.append(future.result())
                show(results[-1])
                progress(f"{len(results)} of {len(items)}", len(results) / len(items))
    except KeyboardInterrupt:
        terminal.print(f"interrupted: {len(results)} of {len(items)} done")
    except BrokenProcessPool:
        terminal.print(f"a worker died, of too little memory perhaps: {len(results)} of {len(items)} done")
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    return results


def _quit_quietly() -> None:
    """Let Ctrl-C end a worker without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def peak_memory() -> float:
    """Return the peak memory of this process [MB]; NaN if unknown."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return float("nan")
    return next((int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM")), float("nan"))
