"""Decide whether the goals of a log are held from row to row, or run on between rows.

A held goal is late by half a sample against one that runs on. A dead time and a lag imitate that, and feedback turns it
into viscous friction. So each reading is fitted without and with these two effects, beside the base model, which has
viscous friction. The likeliest fit wins; of fits that are less likely by `TIE` standard errors at most, the likeliest
with the fewest effects. A tie is an open question, which a diagnosis asks again with the effects that it finds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.data.rows import BLOCK
from estimators.findings import Finding, Kind, Quantity
from estimators.in_loop.fit import densities
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.in_loop.rollouts import FINE, Rollouts, are_driven
from estimators.regression.least_squares import IdentificationError
from estimators.selection.score import Bootstrap
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Model, Term, list_ids
from pendulum_env.physics.actuation import ActuatorLag, BackEmf, DeadTime
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.recording import Recording

LATE = (DeadTime, ActuatorLag)  # effects that half a sample imitates
TIE = 2.0  # standard errors of a gain


@dataclass(frozen=True)
class Reading:
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
    """Decide whether goals are held or run on; None if every drive says it."""
    if all(own.drive is None or own.drive.goal for own in recordings):
        return None
    torque = RegressionData.from_recordings(recordings, part=part).torque
    late = [() if effect.id in list_ids(base) else (effect(),) for effect in LATE]
    found: list[Reading] = []
    for is_held in (True, False):
        rows = RolloutRows(Rollouts(tuple(recordings), FINE, is_held, part), torque)
        alone = rows.fit(base, exactly=True).terms
        blocks, _, of_block = rows.rollouts.blocks(BLOCK)
        for more in dict.fromkeys([(), *late]):
            terms = rows.with_nonlinear((*alone, *more)) if more else alone
            density = densities(rows.rollouts, rows.near(terms).error)
            found.append(Reading(is_held, terms, np.bincount(blocks, density).astype(float)))
    bootstrap = Bootstrap(of_block, np.random.default_rng(0))
    best = max(found, key=lambda one: one.density.sum())
    gains = [bootstrap.gain(best.density, one.density) for one in found]
    tied = [one for one, gain in zip(found, gains, strict=True) if one is best or gain.total <= TIE * gain.error]
    chosen = min(tied, key=lambda one: (len(one.terms), -one.density.sum()))
    others = [one for one in found if one.is_held != chosen.is_held]
    other = max(others, key=lambda one: one.density.sum())
    gain = bootstrap.gain(chosen.density, other.density)
    numbers = {"gain": Quantity(gain.total, gain.error)}
    for term in other.terms[len(base) :]:
        numbers |= {name: Quantity(float(value), unit="s") for name, value in term.nonlinear_values.items()}
    effects = tuple(term.id for term in other.terms[len(base) :])
    unsaid = tuple(own.name for own in recordings if own.drive is None or not own.drive.goal)
    names = unsaid if len(unsaid) < len(recordings) else ()
    return Finding(Kind.GOALS_HELD if chosen.is_held else Kind.GOALS_RUN_ON, numbers, effects=effects, recordings=names)


def change_reading(recordings: Sequence[Recording], reading: Finding) -> tuple[Recording, ...] | None:
    """Return the recordings with goals read the other way; None if drives or the base model decide the reading."""
    gain = reading.numbers.get("gain")
    if gain is None or reading.recordings or abs(gain.value) > TIE * (gain.std or 0.0):
        return None
    unsaid = [replace(own, drive=own.drive and replace(own.drive, goal=None)) for own in recordings]
    return with_goals(unsaid, reading.kind is Kind.GOALS_RUN_ON)


def with_goals(recordings: Sequence[Recording], is_held: bool) -> tuple[Recording, ...]:
    """Return the recordings with goals that are held or run on, where their drives do not say it."""
    return tuple(
        replace(own, drive=replace(own.drive, goal=own.drive.goal or ("held" if is_held else "ramp")))
        if own.drive is not None
        else own
        for own in recordings
    )


def make_base(recordings: Sequence[Recording], base: Sequence[Term] = BASE) -> tuple[Term, ...]:
    """Return the base model of servos: a horn is put on by hand, so the angle at which it hangs is fitted as well.

    Back-EMF can be distinguished from viscous friction where a motor that a voltage drives was off for a while.
    """
    more = [GravityTilt(), *([BackEmf()] if has_unpowered_motor(recordings) else [])]
    return (*base, *(term for term in more if term.id not in list_ids(base)))


def decide_goals(recordings: Sequence[Recording], model: Model) -> tuple[Recording, ...]:
    """Return the recordings with goals that are held or run on, as of a model, or else decided as by a diagnosis.

    Goals of a joint that moves too little for the decision are held. Recordings without drives stay as they are.
    """
    if not are_driven(recordings):
        return tuple(recordings)
    if (goal := model.log_format.get("goal")) is not None:
        return with_goals(recordings, goal == "held")
    try:
        reading = read_goals(recordings, make_base(recordings))
    except IdentificationError:
        reading = None
    return with_goals(recordings, reading is None or reading.kind is Kind.GOALS_HELD)


def has_unpowered_motor(recordings: Sequence[Recording]) -> bool:
    """Return whether a motor that a voltage drives is off for a while."""
    return not all(recording.powered.all() for recording in select_voltage_drives(recordings))


def select_voltage_drives(recordings: Sequence[Recording]) -> list[Recording]:
    """Return the recordings whose drive gives the motor a voltage, not a torque."""
    return [own for own in recordings if own.drive is not None and own.drive.output in ("duty", "voltage")]
