"""The form `python`: a module that needs nothing but Python, and takes NumPy's numbers and arrays, too."""

from __future__ import annotations

from pendulum_env.physics import Model
from pendulum_env.physics.symbols import BINARY, LOGICAL, UNARY, WHERE
from workbench.export.dynamics import Parameter, written
from workbench.export.heading import heading, parameter_note, plain, state_note
from workbench.export.request import Exported, Request
from workbench.export.source import INFIX, Dialect, Source

FUNCTIONS = {  # of single numbers, by NumPy's names; the others are called so in math, too
    "absolute": "abs",
    "maximum": "max",
    "minimum": "min",
    "power": "math.pow",
    "arctan": "math.atan",
    "sign": "lambda x: float(x > 0) - float(x < 0)",
    "logical_and": "lambda one, other: one and other",
    "logical_or": "lambda one, other: one or other",
    "where": "lambda condition, then, other: then if condition else other",
}
CALLED = sorted({*UNARY, *BINARY, *LOGICAL, WHERE} - {*INFIX, "negative"})
DIALECT = Dialect(
    calls={
        op: f"np.{op}({', '.join(f'{{{k}}}' for k in range(3 if op == WHERE else 1 if op in UNARY else 2))})"
        for op in CALLED
    },
    infinity="math.inf",
)
CHOICE = '''

def _functions(*values: Value) -> Any:
    """Functions of numbers, or NumPy's own where one of the values is an array."""
    for value in values:
        if getattr(value, "shape", ()):
            import numpy

            return numpy
    return NUMBERS
'''


def export(model: Model, request: Request) -> Exported:
    """The module: parameters by name, `State`, `start` and `step`."""
    dynamics = written(model, request.step)
    start, step = Source.of(dynamics.start, DIALECT), Source.of(dynamics.after, DIALECT)
    waiting = dynamics.waiting
    lines = [
        '"""' + "\n".join(heading(model, dynamics)) + '\n"""',
        "",
        "from __future__ import annotations",
        "",
        "import math",
        "from types import SimpleNamespace",
        "from typing import Any, NamedTuple",
        "",
        "Value = Any  # a number, or an array (B,)",
        f"STEP = {dynamics.step!r}  # [s]",
    ]
    needed = start.names | step.names
    lines += [f"{_assigned(p)}  # {parameter_note(p)}" for p in dynamics.parameters if p.name in needed]
    lines += ["NUMBERS = SimpleNamespace(  # NumPy's functions, of single numbers"]
    called = [op for op in CALLED if op in start.used | step.used]
    lines += [f"    {op}={FUNCTIONS.get(op, f'math.{op}')}," for op in called]
    lines += [")", *CHOICE.splitlines()]
    lines += ["", "", "class State(NamedTuple):", '    """Where the joint is, and what it remembers."""', ""]
    lines += [f"    {name}: Value  # {state_note(name)}" for name in dynamics.state]
    lines += [f"    commands: tuple[Value, ...]  # [N m], the last {waiting}, newest first"] if waiting else []
    lines += ["", "", "def start(position: Value = 0.0, velocity: Value = 0.0) -> State:"]
    lines += ['    """State of a joint that has been so for long, without torque; of B joints, from arrays (B,)."""']
    lines += ["    np = _functions(position, velocity)"] if start.used & set(CALLED) else []
    lines += [f"    {name} = {text}" for name, text in start.lines]
    values = ["0.0", "position", "velocity", *start.results, *([f"(0.0,) * {waiting}"] if waiting else [])]
    lines += [f"    return State({', '.join(values)})"]
    lines += ["", "", "def step(state: State, torque: Value) -> State:"]
    lines += [f'    """State one STEP later, under a torque [{plain(model.torque_unit)}] that is held meanwhile.', ""]
    lines += [
        "    State and torque are numbers, Python's or NumPy's, or arrays (B,) that step B joints at once.",
        '    """',
    ]
    names = [*dynamics.state, *(["commands"] if waiting else [])]
    lines += [f"    {', '.join(names)} = state"]
    if waiting:
        lines += ["    commands = (torque, *commands)", f"    torque = {dynamics.arriving('commands')}"]
    lines += [f"    np = _functions({', '.join(dynamics.state)}, torque)"]
    lines += [f"    {name} = {text}" for name, text in step.lines]
    results = [*step.results, *([f"commands[:{waiting}]"] if waiting else [])]
    lines += [f"    return State({', '.join(results)})", ""]
    return Exported("\n".join(lines), ())


def _assigned(parameter: Parameter) -> str:
    return f"{parameter.name} = {DIALECT.number(parameter.value)}"
