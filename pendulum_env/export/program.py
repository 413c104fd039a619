"""Export of a step as Python or C code without dependencies, by templates."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, partial

from jinja2 import Environment, PackageLoader, StrictUndefined

from pendulum_env.export.actuators import JointActuator
from pendulum_env.export.dynamics import NamedParameter, StepQuantity, write_step
from pendulum_env.export.request import Exported, Language, escape_text, write_title
from pendulum_env.physics import Model
from pendulum_env.physics.symbols import NAME, Operand, Symbol, merge_equal
from pendulum_env.units import JointUnits

INFIX = {  # sign and precedence of an operation
    **{"add": ("+", 4), "subtract": ("-", 4), "multiply": ("*", 5), "divide": ("/", 5)},
    **{"less": ("<", 3), "less_equal": ("<=", 3), "greater": (">", 3), "greater_equal": (">=", 3)},
    **{"equal": ("==", 3), "not_equal": ("!=", 3)},
}
NEGATIVE, ATOM, LOOSE = 6, 9, 0
CALLS = {  # scalar functions in Python and C99, by NumPy's name
    **{op: (f"math.{op}", f"{op}({{0}})") for op in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")},
    "absolute": ("abs", "fabs({0})"),
    "maximum": ("max", "fmax({0}, {1})"),
    "minimum": ("min", "fmin({0}, {1})"),
    "power": ("math.pow", "pow({0}, {1})"),
    "arctan": ("math.atan", "atan({0})"),
    "rint": ("round", "rint({0})"),
    "sign": ("lambda x: float(x > 0) - float(x < 0)", "sign({0})"),
    "logical_and": ("lambda one, other: one and other", "{0} && {1}"),
    "logical_or": ("lambda one, other: one or other", "{0} || {1}"),
    "where": ("lambda condition, then, other: then if condition else other", "{0} ? {1} : {2}"),
}
STATE = {  # description and unit of state variables
    "time": "[s]",
    "position": "[{rad}]",
    "velocity": "[{rad}/s]",
    "integral": "of the error",
    "held": "output of the controller",
    "speed": "as the controller sees it [{rad}/s]",
    "last_goal": "of the last turn of the controller",
    "phase": "turns of the controller, which looks again at 1",
}


def write_number(language: Language, value: float) -> str:
    """Write a number without loss of precision."""
    if math.isinf(value):
        return f"{'-' * (value < 0)}{'INFINITY' if language == 'c' else 'math.inf'}"
    return repr(value)


def export(model: Model, step: float, actuator: JointActuator, language: Language) -> Exported:
    """Write a Python module or a C file with parameters, initial state and step; `step` [s]."""
    dynamics = write_step(model, step, actuator.connect)
    start, after = (ProgramText.write(results, language) for results in (dynamics.start, dynamics.after))
    call = ", ".join(("state", *(quantity.name for quantity in dynamics.given)))
    return Exported(
        load_environment()
        .get_template("step.py.txt" if language == "python" else "step.c.txt")
        .render(
            number=partial(write_number, language),
            title=write_title(model),
            units=model.units(),
            call=f"step({call})" if language == "python" else f"pendulum_step({call})",
            dynamics=dynamics,
            waiting=dynamics.waiting,
            parameters=[p for p in dynamics.parameters if p.name in start.names | after.names],
            state=list(dynamics.state),
            given=dynamics.given,
            start=start,
            step=after,
            called=sorted(CALLS),
            functions={op: function for op, (function, _) in CALLS.items()},
        )
    )


def describe_quantity(item: StepQuantity | NamedParameter) -> str:
    """Return name and unit of an input, or unit and standard error of a parameter."""
    if isinstance(item, StepQuantity):
        return f"{item.name} [{escape_text(item.unit)}]"
    return f"[{escape_text(item.unit)}]" + (f", standard error {item.std:.2g}" if item.std else "")


def note_state(name: str, units: JointUnits) -> str:
    """Describe a state variable with its unit."""
    return STATE.get(name, "what it was before, as the model remembers it").format(rad=units.unit("rad"))


@cache
def load_environment() -> Environment:
    """Load the templates."""
    environment = Environment(
        loader=PackageLoader("pendulum_env.export"), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"note": describe_quantity, "note_state": note_state, "short": "{:.9g}".format}
    return environment


@dataclass
class ProgramText:
    """Lines that compute results; long, repeated or labelled expressions become variables."""

    language: Language
    lines: list[tuple[str, str]] = field(default_factory=list)  # name and expression of each variable, in order
    results: list[str] = field(default_factory=list)  # expression of each result
    used: set[str] = field(default_factory=set)  # operations in the expressions
    names: set[str] = field(default_factory=set)  # inputs, parameters and states in the expressions

    @classmethod
    def write(cls, results: Sequence[Operand], language: Language) -> ProgramText:
        """Create the lines and result expressions."""
        source = cls(language)
        order, representative = merge_equal(results)
        counts = Counter(
            representative[x] for x in (*(x for s in order for x in s.inputs), *results) if isinstance(x, Symbol)
        )
        texts: dict[Symbol, tuple[str, int]] = {}

        def write_operand(x: Operand) -> tuple[str, int]:
            if isinstance(x, Symbol):
                return texts[representative[x]]
            return write_number(language, x), ATOM if x >= 0 else NEGATIVE

        for symbol in order:
            text = source._write_expression(symbol, [write_operand(x) for x in symbol.inputs])
            if symbol.op != NAME and (symbol.label or counts[symbol] > 1 or len(text[0]) > 64):
                name = symbol.label or f"t{len(source.lines) + 1}"
                source.lines.append((name, text[0]))
                text = name, ATOM
            texts[symbol] = text
        source.results = [write_operand(x)[0] for x in results]
        return source

    def _write_expression(self, symbol: Symbol, parts: Sequence[tuple[str, int]]) -> tuple[str, int]:
        """Return the expression of an operation on operands, and its precedence."""
        if symbol.op == NAME:
            self.names.add(symbol.label)
            return symbol.label, ATOM
        self.used.add(symbol.op)
        if symbol.op in INFIX:
            sign, tight = INFIX[symbol.op]
            keeps = symbol.op in ("add", "multiply", "subtract", "divide")  # evaluated from the left
            first = _enclose(parts[0], tight if keeps else tight + 1)
            return f"{first} {sign} {_enclose(parts[1], tight + 1)}", tight
        if symbol.op == "negative":
            return f"-{_enclose(parts[0], NEGATIVE + 1)}", NEGATIVE
        # Python code accepts NumPy arrays, too
        numpy = f"np.{symbol.op}({', '.join(f'{{{k}}}' for k in range(len(parts)))})"
        template = CALLS[symbol.op][1] if self.language == "c" else numpy
        encloses = template.endswith(")")
        inner = [_enclose(part, LOOSE if encloses else ATOM) for part in parts]
        return template.format(*inner), ATOM if encloses else LOOSE


def _enclose(part: tuple[str, int], tight: int) -> str:
    text, precedence = part
    return text if precedence >= tight else f"({text})"
