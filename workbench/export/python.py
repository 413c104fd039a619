"""The form `python`: a module that needs nothing but Python."""

from __future__ import annotations

from collections.abc import Sequence

from pendulum_env.physics import Model
from workbench.export.dynamics import Dynamics, Parameter, Quantity, written
from workbench.export.heading import given_note, heading, parameter_note, plain, state_note
from workbench.export.request import Exported, Request
from workbench.export.source import Dialect, Source

DIALECT = Dialect(
    calls={
        "absolute": "abs({0})",
        "sign": "_sign({0})",
        "maximum": "max({0}, {1})",
        "minimum": "min({0}, {1})",
        "power": "math.pow({0}, {1})",
        "logical_and": "{0} and {1}",
        "logical_or": "{0} or {1}",
        "arctan": "math.atan({0})",
        **{op: f"math.{op}({{0}})" for op in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")},
    },
    where="{1} if {0} else {2}",
    infinity="math.inf",
)
SIGN = """

def _sign(x: float) -> float:
    return float(x > 0) - float(x < 0)  # of NumPy's numbers, too
"""


def export(model: Model, request: Request) -> Exported:
    """The module: parameters by name, `State`, `start` and `step`."""
    return Exported(program(model, written(model, request.step, request.drive)), ())


def program(model: Model, dynamics: Dynamics) -> str:
    """Text of the module."""
    results = list(dynamics.results.values())
    start, step = Source.of(dynamics.start, DIALECT), Source.of([*dynamics.after, *results], DIALECT)
    waiting = dynamics.waiting
    lines = [
        '"""' + "\n".join(heading(model, dynamics)) + '\n"""',
        "",
        "from __future__ import annotations",
        "",
        "import math",
        "from typing import NamedTuple",
        "",
        f"STEP = {dynamics.step!r}  # [s]",
    ]
    needed = start.names | step.names
    lines += [f"{_assigned(p)}  # {parameter_note(p)}" for p in dynamics.parameters if p.name in needed]
    lines += ["", "", "class State(NamedTuple):", '    """Where the joint is, and what it remembers."""', ""]
    lines += [f"    {name}: float  # {state_note(name)}" for name in dynamics.state]
    lines += [f"    commands: tuple[float, ...]  # [N m], the last {waiting}, newest first"] if waiting else []
    lines += ["", "", "def start(position: float = 0.0, velocity: float = 0.0) -> State:"]
    lines += ['    """State of a joint that has been so for long, without torque."""']
    lines += [f"    {name} = {text}" for name, text in start.lines]
    values = [*start.results, *([f"(0.0,) * {waiting}"] if waiting else [])]
    lines += [f"    return State({', '.join(values)})"]
    if "sign" in start.used | step.used:
        lines += SIGN.splitlines()
    given = ", ".join(f"{q.name}: float" + ("" if q.usual is None else f" = {q.usual!r}") for q in dynamics.given)
    gives = f"tuple[State{', float' * len(results)}]" if results else "State"
    lines += ["", "", f"def step(state: State, {given}) -> {gives}:"]
    told = [f"{q.name} [{plain(q.unit)}]" for q in dynamics.results]
    lines += [f'    """{", ".join(["State one STEP later", *told])}; given {_listed(dynamics.given)}."""']
    names = [*dynamics.state, *(["commands"] if waiting else [])]
    lines += [f"    {', '.join(names)}{',' if len(names) == 1 else ''} = state"]
    if waiting:
        lines += ["    commands = (torque, *commands)", f"    torque = {dynamics.arriving('commands')}"]
    lines += [f"    {name} = {text}" for name, text in step.lines]
    count = len(dynamics.state)
    after = ", ".join([*step.results[:count], *([f"commands[:{waiting}]"] if waiting else [])])
    lines += [f"    return {', '.join([f'State({after})', *step.results[count:]])}", ""]
    return "\n".join(lines)


def _listed(given: Sequence[Quantity]) -> str:
    return ", ".join(given_note(quantity) for quantity in given)


def _assigned(parameter: Parameter) -> str:
    return f"{parameter.name} = {DIALECT.number(parameter.value)}"
