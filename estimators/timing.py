"""Whether torque stands beside the motion that it drives: many logs hold that of the period that has just ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.dataset import Dataset, prepare
from estimators.least_squares import solve
from pendulum_env.physics import Term
from pendulum_env.recording import Recording

LATE = 0.8  # share of the torque error: nothing that obeys its past is explained so much better by torque to come


def late_torque(recordings: Sequence[Recording], models: Sequence[Sequence[Term]]) -> str | None:
    """One sentence if the terms of a model fit much better with torque moved one row up; None if those of none do.

    A recording holds the torque that acts from each row's time on. No effect can act before its cause, so that none of
    the library mends torque that is logged a sample late; several together only hide it.
    """
    if not models:
        return None
    as_it_is, moved = prepare(recordings), prepare([_earlier(recording) for recording in recordings])
    for terms in models:
        before, after = _misfit(as_it_is, terms), _misfit(moved, terms)
        if after <= LATE * before:
            return (
                "torque seems to be logged one sample late, beside the motion that it has caused already: moved one "
                f"row up it leaves an error of {after:.2g} instead of {before:.2g} N m; each row should hold the "
                "torque from its time on"
            )
    return None


def _earlier(recording: Recording) -> Recording:
    return replace(recording, torque=np.append(recording.torque[1:], recording.torque[-1]))


def _misfit(data: Dataset, terms: Sequence[Term]) -> float:
    """Root mean square torque that a fit of the terms leaves [N m]."""
    equations = data.equations(terms)
    return solve(equations, np.ones(len(equations.y)), data.clusters).rms
