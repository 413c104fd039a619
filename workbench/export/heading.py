"""What an exported file says of itself."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pendulum_env.physics import Model
from workbench.export.dynamics import Dynamics, Parameter, Quantity

STATE = {  # what its parts are, and their units
    "time": "[s]",
    "position": "[rad], 0 hangs down",
    "velocity": "[rad/s]",
    "integral": "of the error",
    "held": "output of the controller",
    "speed": "as the controller sees it [rad/s]",
    "phase": "turns of the controller, which looks again at 1",
}


def title(model: Model) -> str:
    """What the file is of, fit for a comment in any language: a law is whatever its author wrote."""
    return f"A pendulum, as identified: {plain(' + '.join(term.law for term in model.terms))} = tau."


def plain(text: str) -> str:
    """Text that ends no comment and no string, in any language."""
    return " ".join(text.replace("*/", "* /").replace('"', "'").replace("\\", "/").split())


def heading(model: Model, dynamics: Dynamics) -> list[str]:
    """Comment of a program that steps a model, or is called beside the step of an engine."""
    given = "; ".join(given_note(quantity) for quantity in dynamics.given)
    if dynamics.results:
        what = [f"{dynamics.call} gives the torque to apply and the largest dry friction to allow, both in"]
        what += [f"{plain(model.torque_unit)}, over a step of {dynamics.step:g} s of an engine that has the rest:"]
        what += [f"{given}."]
    else:
        what = [f"{dynamics.call} moves on by {dynamics.step:g} s, under what it is given and holds meanwhile:"]
        what += [f"{given}.", "Angles in rad, 0 hangs down, positive counter-clockwise."]
        what += ["Dry friction is set-valued: at rest it balances whatever is left of the torque, up to its size, and"]
        what += [
            "the joint stays exactly where it is; a step in which the velocity would change its sign is cut there."
        ]
        what += ["Second order in the step; a longer or shorter one is another export."]
    lines = [title(model), "", *what]
    if dynamics.waiting:
        lines.append(
            f"The torque arrives {dynamics.delay * dynamics.step:g} s late: the state holds the commands on their way."
        )
    return lines


def given_note(quantity: Quantity) -> str:
    """What a step is given, and its unit."""
    return f"{quantity.name} [{plain(quantity.unit)}]"


def state_note(name: str) -> str:
    """What a part of the state is, and its unit."""
    return STATE.get(name, "what it was before, as the model remembers it")


def parameter_note(parameter: Parameter) -> str:
    """Unit and standard error of a parameter."""
    error = f", standard error {parameter.std:.2g}" if parameter.std else ""
    return f"[{plain(parameter.unit)}]{error}"


def comment(lines: Sequence[str]) -> str:
    """Text of a comment in XML, where two dashes would end it."""
    return re.sub("-(?=-)", "- ", "\n".join(lines))


def remark(model: Model, lines: Sequence[str]) -> str:
    """A title and lines as a comment of a Python file."""
    return "\n".join(f"# {plain(line)}" for line in (title(model), *lines))


def commented(xml: str, lines: Sequence[str]) -> str:
    """An XML file with a comment after its first line."""
    first, rest = xml.split("\n", 1)
    return f"{first}\n<!-- {comment(lines)} -->\n{rest}"
