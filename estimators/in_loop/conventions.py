"""Decide the conventions that a log of a servo leaves open: how goals run between rows, and how an integral acts."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.findings import Kind
from estimators.in_loop.goals import make_base, read_goals, with_goals
from estimators.in_loop.integral import read_integral, with_integral
from estimators.in_loop.rollouts import are_driven
from estimators.regression.least_squares import IdentificationError
from pendulum_env.physics import Model
from pendulum_env.recording import Recording


def decide_conventions(recordings: Sequence[Recording], model: Model) -> tuple[Recording, ...]:
    """Return the recordings with the conventions of a model, or else those that a diagnosis would find.

    Goals are held or run on; an integral has its order and its end at the limit. Goals of a joint that moves too little
    for the decision are held. Recordings without drives stay as they are.
    """
    if not are_driven(recordings):
        return tuple(recordings)
    recordings, base = with_integral(recordings, model.log_format), make_base(recordings)
    goal = model.log_format.get("goal")
    try:
        if (integral := read_integral(recordings, base)) is not None:
            recordings = with_integral(recordings, dict(integral.pairs))
        reading = read_goals(recordings, base) if goal is None else None
    except IdentificationError:
        reading = None
    is_held = goal == "held" if goal is not None else reading is None or reading.kind is Kind.GOALS_HELD
    return with_goals(recordings, is_held)
