"""Texts of effects for readers; `effect_texts` has those of the built-in effects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Symptom = Literal[  # most visible feature in the residual of a model without the effect
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


@dataclass(frozen=True)
class Description:
    """Texts of an effect; all are optional.

    Attributes:
        title: name within a sentence; by default the id with spaces in place of underscores.
        symptom: first sign of the effect in a residual, one of `Symptom`.
        signature: traces of the effect in a recording, in one or two sentences.
        resembles: ids of terms that the effect may be confused with.
        informative_experiment: experiment that shows the effect.
        omission: consequence for a simulator without the effect.
        fits_friction: whether viscous and dry friction can replace the effect in a simulator.
    """

    title: str = ""
    symptom: Symptom | None = None
    signature: str = ""
    resembles: tuple[str, ...] = ()
    informative_experiment: str = "a richer excitation"
    omission: str = "it is left out"
    fits_friction: bool = False


DESCRIPTIONS: dict[str, Description] = {}  # descriptions of effects with a `description`, by id
