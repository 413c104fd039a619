"""Decide whether the goals of a log are held from row to row, or run on between rows.

On average, a held goal is late by half a sample. A dead time and a lag imitate this delay; feedback turns it into
viscous friction. So each reading is fitted by the base model, which has viscous friction, without and with these two
effects. Fits are tied if they are less likely than the best by at most `TIE` standard errors. The likeliest of those
with the fewest effects is taken. After a tie, a diagnosis decides again with the effects that it finds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.rows import BLOCK
from estimators.findings import Finding, Kind, Quantity
from estimators.in_loop.fit import compute_log_densities
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.in_loop.rollouts import FINE, Rollouts
from estimators.selection.score import Bootstrap
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Term, list_ids
from pendulum_env.physics.actuation import ActuatorLag, BackEmf, DeadTime
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.recording import Recording
from pendulum_env.servo.drive import Goal
from pendulum_env.servo.torque import replace_drive

LATE = (DeadTime, ActuatorLag)  # effects that half a sample imitates
TIE = 2.0  # standard errors of a gain


@dataclass(frozen=True)
class GoalReading:
    """Fit under one reading of the goals.

    Attributes:
        is_held: whether goals are held from row to row.
        terms: of the fit, the base model first.
        density: log density of each block (S,) [nat].
    """

    is_held: bool
    terms: tuple[Term, ...]
    density: Array


def read_goals(recordings: Sequence[Recording], base: Sequence[Term], part: Part = WHOLE) -> Finding | None:
    """Decide whether goals are held or run on; return None if every drive declares it.

    The finding has the gain over the likeliest fit under the other reading [nat], and the effects of that fit with
    their sizes [s]. It names the undeclared recordings, unless all are undeclared.
    """
    if all(r.drive is None or r.drive.goal for r in recordings):
        return None
    torque = RegressionData.from_recordings(recordings, part=part).torque
    added_effects = [() if effect.id in list_ids(base) else (effect(),) for effect in LATE]
    readings: list[GoalReading] = []
    for is_held in (True, False):
        rows = RolloutRows(Rollouts(tuple(recordings), FINE, is_held, part).without_counts, torque)
        base_terms = rows.fit(base, exactly=True).terms
        blocks, _, of_block = rows.rollouts.blocks(BLOCK)
        for added in dict.fromkeys([(), *added_effects]):
            terms = rows.with_nonlinear((*base_terms, *added)) if added else base_terms
            density = compute_log_densities(rows.rollouts, rows.linearise_at_fit(terms).error)
            readings.append(GoalReading(is_held, terms, np.bincount(blocks, density).astype(float)))
    bootstrap = Bootstrap(of_block, np.random.default_rng(0))
    best = max(readings, key=lambda r: r.density.sum())
    gains = [bootstrap.gain(best.density, r.density) for r in readings]
    tied = [r for r, gain in zip(readings, gains, strict=True) if r is best or gain.total <= TIE * gain.error]
    chosen = min(tied, key=lambda r: (len(r.terms), -r.density.sum()))
    others = [r for r in readings if r.is_held != chosen.is_held]
    alternative = max(others, key=lambda r: r.density.sum())
    gain = bootstrap.gain(chosen.density, alternative.density)
    numbers = {"gain": Quantity(gain.total, gain.error)}
    for term in alternative.terms[len(base) :]:
        numbers |= {name: Quantity(float(value), unit="s") for name, value in term.nonlinear_values.items()}
    effects = tuple(term.id for term in alternative.terms[len(base) :])
    undeclared = tuple(r.name for r in recordings if r.drive is None or not r.drive.goal)
    names = undeclared if len(undeclared) < len(recordings) else ()
    return Finding(Kind.GOALS_HELD if chosen.is_held else Kind.GOALS_RUN_ON, numbers, effects=effects, recordings=names)


def change_reading(recordings: Sequence[Recording], reading: Finding) -> tuple[Recording, ...] | None:
    """Return the recordings under the other reading of their goals: held from row to row, or run on between rows.

    `reading` is the finding of the reading in use. Return None if a drive declares its reading, or if the gain of
    the base model exceeds `TIE` standard errors.
    """
    gain = reading.numbers.get("gain")
    if gain is None or reading.recordings or abs(gain.value) > TIE * (gain.std or 0.0):
        return None
    undeclared = [replace(r, drive=r.drive and replace(r.drive, goal=None)) for r in recordings]
    is_held = reading.kind is Kind.GOALS_RUN_ON  # now
    return with_goals(undeclared, is_held)


def with_goals(recordings: Sequence[Recording], is_held: bool) -> tuple[Recording, ...]:
    """Return the recordings with held goals, or goals that run on; goals that a drive declares stay as they are."""
    goal: Goal = "held" if is_held else "ramp"
    return tuple(
        r if r.drive is None or r.drive.goal else replace_drive(r, replace(r.drive, goal=goal)) for r in recordings
    )


def make_base(recordings: Sequence[Recording], base: Sequence[Term] = BASE) -> tuple[Term, ...]:
    """Return the base model of servos, with a tilt of gravity, since a horn is mounted by hand.

    Back-EMF is added if a motor driven by a voltage is ever off; otherwise it equals viscous friction.
    """
    added = [GravityTilt(), *([BackEmf()] if has_unpowered_motor(recordings) else [])]
    return (*base, *(term for term in added if term.id not in list_ids(base)))


def has_unpowered_motor(recordings: Sequence[Recording]) -> bool:
    """Return whether a motor that a voltage drives is ever off."""
    return not all(recording.powered.all() for recording in select_voltage_drives(recordings))


def select_voltage_drives(recordings: Sequence[Recording]) -> list[Recording]:
    """Return the recordings with a drive that gives the motor a voltage, not a torque."""
    return [r for r in recordings if r.drive is not None and r.drive.output in ("duty", "voltage")]
