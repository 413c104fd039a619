"""What an export is asked for, and what comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pendulum_env.mistake import Mistake
from pendulum_env.physics.simulation import LONGEST_STEP


class ExportError(Mistake):
    """A model that a format cannot hold; the message says what, in which format, and what to do."""


@dataclass(frozen=True)
class Request:
    """How a model is to be exported.

    Attributes:
        approximate: whether what the format cannot hold may be approximated or left out.
        step: of the forms that are a step, and of MuJoCo [s].
        mass: of the arm [kg], where it is known; it only fixes where the centre of mass is drawn.
        armature: inertia of the rotor about the joint [kg m^2], where it is known: motion tells its sum with the arm's.
    """

    approximate: bool = False
    step: float = LONGEST_STEP
    mass: float | None = None
    armature: float = 0.0


@dataclass(frozen=True)
class Exported:
    """A file's content, and what it does not hold as the model has it, a sentence each."""

    content: str
    notes: tuple[str, ...] = ()


def keep(format: str, missing: Sequence[str], request: Request) -> tuple[str, ...]:
    """What a file does not hold of the model, a sentence each, if that is allowed.

    Args:
        format: name of the format.
        missing: what it cannot hold, and what would be in its place.
        request: whether approximations are allowed.

    Raises:
        ExportError: if something is missing and approximations are not allowed.
    """
    if missing and not request.approximate:
        raise ExportError(
            f"{format} cannot hold {'; nor '.join(missing)}. Ask for that with --approximate, or export --to python or "
            "c, which hold every effect"
        )
    return tuple(f"{format} cannot hold {text}" for text in missing)
