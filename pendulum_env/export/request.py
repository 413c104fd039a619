"""Request and result of an export, and the header of its files."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pendulum_env.errors import UserError
from pendulum_env.physics import Model
from pendulum_env.physics.simulation import LONGEST_STEP
from pendulum_env.recording.actuator import Actuator

Language = Literal["python", "c"]


class ExportError(UserError):
    """Format cannot represent the model; the message names the part, the format and the remedy."""


@dataclass(frozen=True)
class Request:
    """Request to export a model.

    Attributes:
        approximate: whether unsupported parts of the model may be approximated or left out.
        step: simulation step [s].
        mass: of the pendulum [kg], if known; it sets the centre of mass, not the motion.
        armature: known part of the inertia that is the rotor's [kg m^2].
        language: of a feedforward.
        drive: controller and motor to export with the joint, with a goal input; None: torque input.
    """

    approximate: bool = False
    step: float = LONGEST_STEP
    mass: float | None = None
    armature: float = 0.0
    language: Language = "c"
    drive: Actuator | None = None


@dataclass(frozen=True)
class Exported:
    """Content of a file, and sentences on the parts of the model that it lacks or approximates."""

    content: str
    notes: tuple[str, ...] = ()


WHOLE = ", or export --to python or c, which hold every effect"


def note_missing(missing: Sequence[str], request: Request, remedy: str = WHOLE) -> tuple[str, ...]:
    """List the parts of the model that MJCF lacks, one sentence each; `remedy`: hint at other formats.

    Raises ExportError if something is missing and approximations are not allowed.
    """
    if missing and not request.approximate:
        raise ExportError(f"mjcf cannot hold {'; nor '.join(missing)}. Ask for that with --approximate{remedy}")
    return tuple(f"mjcf cannot hold {text}" for text in missing)


def write_title(model: Model) -> str:
    """Return the title of the file, escaped for a comment in any language."""
    subject = "A joint that slides, q in m and tau in N" if model.is_prismatic else "A pendulum"
    return f"{subject}, as identified: {escape_text(' + '.join(term.law for term in model.terms))} = tau."


def escape_text(text: str) -> str:
    """Escape a text for comments and strings of any language."""
    return " ".join(text.replace("*/", "* /").replace('"', "'").replace("\\", "/").split())


def escape_comment(lines: Sequence[str]) -> str:
    """Join lines for a comment in XML, without double dashes."""
    return re.sub("-(?=-)", "- ", "\n".join(lines))
