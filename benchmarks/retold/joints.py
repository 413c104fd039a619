"""Scenarios of one joint with logged torque: pendulum, axis or motor."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.retold.bound import bound_errors
from benchmarks.retold.logs import Log
from benchmarks.retold.machines import (
    CLOSED,
    OPEN,
    ORDINARY,
    UNUSUAL,
    Run,
    draw_effect,
    draw_machine,
    run_machine,
)
from benchmarks.retold.retellings import RETELLINGS, Rng, draw_sensors, log_run
from benchmarks.retold.scenario import Scenario

MOTIONS = (*OPEN, *CLOSED)
HARD_ROWS = ("extreme machine", "encoder edges")  # without hidden effects


def draw_joint(rng: Rng, kind: str, row: str, motion: str | None = None) -> Scenario:
    """Draw a machine of a kind, its motion, and its retold log."""
    run, log = draw_run(rng, kind, row, motion)
    write = partial(_write_files, run=run, log=log)
    truth = {**run.truth, **log.truth}
    return Scenario(kind, row, run.motion, run.hidden, truth, bound_errors([run]), write)


def draw_run(rng: Rng, kind: str, row: str, motion: str | None = None) -> tuple[Run, Log]:
    """Draw a machine of a kind, its run, and the retold log."""
    drawn = str(rng.choice(ORDINARY) if rng.random() < 0.5 else rng.choice([*UNUSUAL, *CLOSED]))
    motion = motion or drawn
    machine = draw_machine(rng, kind, row == "extreme machine")
    is_hidden = motion in ORDINARY and rng.random() < 0.5 and row not in HARD_ROWS
    sensors = draw_sensors(rng, row, float(np.clip(12 * machine.time, 8.0, 30.0)))
    run = run_machine(rng, machine, motion, sensors, draw_effect(rng, machine) if is_hidden else None)
    return run, RETELLINGS[row](log_run(run), run, rng)


def _write_files(folder: Path, run: Run, log: Log) -> list[str]:
    return [*log.write(folder), *run.options, *log.make_options()]
