"""Request and result of an export, and the header of its files."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pendulum_env.errors import UserError
from pendulum_env.physics import Model
from pendulum_env.physics.simulation import LONGEST_STEP
from pendulum_env.servo import ServoDrive

Language = Literal["python", "c"]


class ExportError(UserError):
    """A model that a format cannot hold; the message says what, in which format, and what to do."""


@dataclass(frozen=True)
class Request:
    """Request to export a model.

    Attributes:
        approximate: whether what the format cannot hold may be approximated or left out.
        step: of the forms that are a step, and of MuJoCo [s].
        mass: of the arm [kg], where it is known; it only fixes where the centre of mass is drawn.
        armature: inertia of the rotor about the joint [kg m^2], where it is known: motion tells its sum with the arm's.
        drive: the controller and motor to export with the joint, which then takes a goal; else it takes a torque.
    """

    approximate: bool = False
    step: float = LONGEST_STEP
    mass: float | None = None
    armature: float = 0.0
    drive: ServoDrive | None = None


@dataclass(frozen=True)
class Exported:
    """A file's content, and what it does not hold as the model has it, a sentence each."""

    content: str
    notes: tuple[str, ...] = ()


WHOLE = ", or export --to python or c, which hold every effect"


def note_missing(missing: Sequence[str], request: Request, others: str = WHOLE) -> tuple[str, ...]:
    """List the parts of the model that a file for MuJoCo lacks, one sentence each; `others` hold more.

    Raises ExportError if something is missing and approximations are not allowed.
    """
    if missing and not request.approximate:
        raise ExportError(f"mjcf cannot hold {'; nor '.join(missing)}. Ask for that with --approximate{others}")
    return tuple(f"mjcf cannot hold {text}" for text in missing)


def write_title(model: Model) -> str:
    """Return the title of the file, escaped for a comment in any language."""
    what = "A joint that slides, q in m and tau in N" if model.slides else "A pendulum"
    return f"{what}, as identified: {escape_text(' + '.join(term.law for term in model.terms))} = tau."


def escape_text(text: str) -> str:
    """Escape a text, so that it ends no comment and no string in any language."""
    return " ".join(text.replace("*/", "* /").replace('"', "'").replace("\\", "/").split())


def escape_comment(lines: Sequence[str]) -> str:
    """Escape lines for a comment in XML, which two dashes would end."""
    return re.sub("-(?=-)", "- ", "\n".join(lines))
