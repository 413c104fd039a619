"""Texts about one effect for people, beside its law; those of the built-in effects stand in `workbench.narrator`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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


@dataclass(frozen=True)
class Description:
    """Texts about one effect; the defaults serve an effect that has a law only.

    Attributes:
        title: name within a sentence; empty for the id with spaces in place of underscores.
        symptom: first sign of the effect in a residual, one of `Symptom`.
        signature: traces of the effect in a recording, in a sentence or two.
        resembles: ids of terms that it is confused with.
        informative_experiment: experiment that shows the effect.
        omission: consequence for a simulator without the effect.
        fits_friction: whether viscous and dry friction can stand in for it in such a simulator.
    """

    title: str = ""
    symptom: Symptom | None = None
    signature: str = ""
    resembles: tuple[str, ...] = ()
    informative_experiment: str = "a richer excitation"
    omission: str = "it is left out"
    fits_friction: bool = False


DESCRIPTIONS: dict[str, Description] = {}  # of effects that bring their own, by id
