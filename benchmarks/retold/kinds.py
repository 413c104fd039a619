"""Kinds of machines of retold logs, with their shares, rows and motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.retold import arms, joints, servos
from benchmarks.retold.retellings import RETELLINGS, Rng
from benchmarks.retold.scenario import Scenario


class Kind(NamedTuple):
    """Kind of machine: its share of the numbers, and how to draw a scenario of a row and perhaps a motion."""

    share: float
    rows: Sequence[str]
    motions: Sequence[str]
    draw: Callable[[Rng, str, str | None], Scenario]


def _make_joint(kind: str, share: float, *without: str) -> Kind:
    rows = [row for row in RETELLINGS if row not in without]
    return Kind(share, rows, joints.MOTIONS, lambda rng, row, motion: joints.draw_joint(rng, kind, row, motion))


KINDS = {
    "pendulum": _make_joint("pendulum", 0.42),
    "axis": _make_joint("axis", 0.18, "unit unnamed"),  # without gravity, no unit shows
    "motor": _make_joint("motor", 0.10, "unit unnamed"),
    "servo": Kind(0.15, [*servos.RETELLINGS], [*servos.MOTIONS], servos.draw_servo),
    "arm": Kind(0.15, [*arms.RETELLINGS], [*arms.MOTIONS], arms.draw_arm),
}
ROWS = [*dict.fromkeys(row for own in KINDS.values() for row in own.rows)]
MOTIONS = [*dict.fromkeys(motion for own in KINDS.values() for motion in own.motions)]


def draw_scenario(
    seed: int, number: int, kind: str | None = None, row: str | None = None, motion: str | None = None
) -> Scenario:
    """Draw the scenario of a number, of any kind that has the row and the motion."""
    rng = np.random.default_rng([seed, number])
    fitting = [
        name for name, own in KINDS.items()
        if kind in (None, name) and (row is None or row in own.rows) and (motion is None or motion in own.motions)
    ]  # fmt: skip
    if not fitting:
        raise ValueError(
            f"no kind has the row {row} and the motion {motion}: choose them from one of {', '.join(KINDS)}"
        )
    shares = np.array([KINDS[name].share for name in fitting])
    own = KINDS[str(rng.choice(fitting, p=shares / shares.sum()))]
    return own.draw(rng, row or own.rows[number % len(own.rows)], motion)
