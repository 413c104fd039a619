"""Texts about one effect for people, beside its law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

Symptom = Literal[  # the most visible feature of the residual of a model without the effect
    "the same torque everywhere",
    "a curve over the angle",
    "waves over the angle",
    "a curve over the speed",
    "a peak around standstill",
    "a curve over the torque",
    "torque that comes late",
    "knocks and ringing",
    "a change in time",
]


def _tested_everywhere(term: Any, low: float, high: float) -> str:
    return ""


@dataclass(frozen=True)
class Description:
    """Texts about one effect; the defaults serve an effect that has a law only.

    Attributes:
        title: name within a sentence; empty for the id with spaces in place of underscores.
        symptom: first sign of the effect in a residual, one of `Symptom`.
        signature: traces of the effect in a recording, in a sentence or two.
        resembles: ids of terms that it is confused with.
        informative_experiment: experiment that shows the effect.
        typical_size: sizes that a rig might show, as `sin=0.15,cos=0.1`; by default the unit tells them.
        omission: consequence for a simulator without the effect.
        fits_friction: whether viscous and dry friction can stand in for it in such a simulator.
        percent_of: parts of the effect that are also given in per cent of the term of that name.
        untested_range: sentence about the motion that was not tested, made from a term and the ends of the motion
            [rad]; empty if none.
    """

    title: str = ""
    symptom: Symptom | None = None
    signature: str = ""
    resembles: tuple[str, ...] = ()
    informative_experiment: str = "a richer excitation"
    typical_size: str = ""
    omission: str = "it is left out"
    fits_friction: bool = False
    percent_of: tuple[str, ...] = ()
    untested_range: Callable[[Any, float, float], str] = _tested_everywhere
