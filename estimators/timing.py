"""Whether torque stands beside the motion that it drives: many logs hold that of the period that has just ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.dataset import prepare
from pendulum_env.physics import Term
from pendulum_env.recording import Recording

LATE = 0.8  # share of the torque error: nothing that obeys its past is explained so much better by torque to come


def late_torque(recordings: Sequence[Recording], terms: Sequence[Term]) -> str | None:
    """One sentence if the terms fit much better with torque moved one row up; None if not.

    A recording holds the torque that acts from each row's time on. No effect can act before its cause, so that none of
    the library mends torque that is logged a sample late; several together only hide it.
    """
    before, after = (_misfit(version, terms) for version in (recordings, [_earlier(r) for r in recordings]))
    if after > LATE * before:
        return None
    return (
        "torque seems to be logged one sample late, beside the motion that it has caused already: moved one row up it "
        f"leaves an error of {after:.2g} instead of {before:.2g} N m; each row should hold the torque from its time on"
    )


def _earlier(recording: Recording) -> Recording:
    return replace(recording, torque=np.append(recording.torque[1:], recording.torque[-1]))


def _misfit(recordings: Sequence[Recording], terms: Sequence[Term]) -> float:
    """Root mean square torque that a fit of the terms leaves [N m]."""
    equations = prepare(recordings).equations(terms)
    scale = np.maximum(np.linalg.norm(equations.phi, axis=0), 1e-300)
    theta = np.linalg.lstsq(equations.phi / scale, equations.y, rcond=1e-10)[0] / scale
    return float(np.sqrt(np.mean((equations.y - equations.phi @ theta) ** 2)))
