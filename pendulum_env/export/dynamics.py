"""Simulation step of a model as symbolic expressions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from keyword import iskeyword
from typing import Any, Self, cast

import numpy as np

from pendulum_env.export.request import ExportError
from pendulum_env.physics import Estimate, Model, Samples
from pendulum_env.physics.simulation import TorqueBalance, step, write_balance
from pendulum_env.physics.symbols import NAME, Operand, Symbol, make_symbol, set_label, sort_symbols
from pendulum_env.physics.term import ROOM
from pendulum_env.recording.vocabulary import SI

RESERVED = frozenset(  # names used by the exported programs and their languages
    """time position velocity torque commands state step start sign State STEP math abs max min
    auto case char const default do double enum extern float goto int long register short signed sizeof static struct
    switch typedef union unsigned void volatile fabs sin cos tan exp log sqrt tanh atan pow fmax fmin gamma
    round hypot y0 y1 j0 j1 inline restrict memset INFINITY NAN NamedTuple pendulum_step
    np Any Value SimpleNamespace NUMBERS _functions temperature
    goal supply on phase held speed last_velocity last_goal integral limit kp ki kd gain""".split()
)


@dataclass(frozen=True)
class NamedParameter:
    """Parameter of the model with its name in the exported program."""

    name: str
    value: float
    unit: str
    std: float


@dataclass(frozen=True)
class StepQuantity:
    """Input or state of a step."""

    name: str
    unit: str
    default: float | None = None


@dataclass(frozen=True)
class Dynamics:
    """Step as expressions of state variables, parameters and inputs."""

    step: float  # length of a step [s]
    parameters: tuple[NamedParameter, ...]  # named in the expressions
    given: tuple[StepQuantity, ...]  # inputs of the step
    state: tuple[str, ...]  # names of the state variables
    start: tuple[Operand, ...]  # their initial values after long rest, as expressions of `position` and `velocity`
    after: tuple[Operand, ...]  # their values after the step
    delay: float = 0.0  # of the torque input [steps]

    @property
    def waiting(self) -> int:
        """Return the number of stored commands."""
        return math.ceil(self.delay)

    def write_arrival(self, commands: str) -> str:
        """Write the delayed command as an expression of a list, newest first; interpolate between two entries."""
        whole, share = divmod(self.delay, 1.0)
        late, later = f"{commands}[{int(whole)}]", f"{commands}[{int(whole) + 1}]"
        return late if share == 0 else f"{1.0 - share!r} * {late} + {share!r} * {later}"


def write_step(model: Model, seconds: float, connect: Callable[[StepBuilder], None]) -> Dynamics:
    """Write the step of a model; `connect` replaces its torque input by that of an actuator.

    Raises ExportError if a law of the model cannot be converted to an expression.
    """
    try:
        parts = StepBuilder.from_model(model, seconds)
        connect(parts)
        x = step(parts.balance, parts.x, seconds)
    except Exception as error:  # a user's law may raise anything
        raise ExportError(f"a law of this model cannot be written down as a formula: {error}") from None
    after = {"time": x.time, "position": x.position, "velocity": x.velocity}
    for id, names in parts.remembered.items():
        after |= dict(zip(names, x.memory[id], strict=True))
    return parts.make_dynamics(after)


@dataclass
class StepBuilder:
    """Expressions of a step in readable names, during construction."""

    seconds: float  # length of a step [s]
    balance: TorqueBalance
    x: Samples  # state and input at the start of a step
    remembered: dict[str, list[str]]  # names of state variables by term
    parameters: list[NamedParameter]  # of terms and drive
    given: list[StepQuantity]  # inputs of a step
    start: dict[str, Any]  # initial values of state variables by name
    delay: float  # of the torque input [s]
    after: dict[str, Any] = field(default_factory=dict)  # state variables of the controller after a step

    @classmethod
    def from_model(cls, model: Model, seconds: float) -> Self:
        """Create the expressions of a model with a torque input."""
        terms = model.terms
        balance, x, _ = write_balance(terms)
        named: list[tuple[str, str, Any, float]] = [
            (column.name, column.unit, symbol, 0.0)
            for column, symbol in zip((c for term in terms for c in term.columns), balance.theta, strict=True)
        ] + [
            (f"{term.id}.{p.name}", p.unit, getattr(symbols, p.name), term.nonlinear_values[p.name])
            for term, symbols in zip(terms, balance.terms, strict=True)
            for p in term.free
        ]
        parameters = []
        for text, unit, symbol, value in named:
            symbol.label = make_identifier(text)
            estimate = model.estimates.get(text, Estimate(value, 0.0, unit))  # without one: a default value
            parameters.append(NamedParameter(symbol.label, estimate.value, estimate.unit, estimate.std))
        start: dict[str, Any] = {"time": 0.0, "position": x.position, "velocity": x.velocity}
        remembered: dict[str, list[str]] = {}
        inputs = [StepQuantity("torque", model.units().unit("N m"))]
        warm = [term.id for term in terms if term.needs == "temperature"]
        if names := [f"{term.id} (by its {term.needs})" for term in terms if term.needs not in ("", "temperature")]:
            raise ExportError(f"{', '.join(names)}: no program is given that")
        if warm:
            inputs.append(StepQuantity("temperature", SI["temperature"], ROOM))
            x = replace(x, temperature=cast(Any, make_symbol("temperature")))
        long_ago, memory = balance.start(replace(x, torque=np.zeros(()))), cast(Mapping[str, Any], x.memory)
        as_given: dict[str, Any] = {id: (x.temperature, 0.0) for id in warm if id in memory}
        x = replace(x, memory={**memory, **as_given})
        for id, symbols in memory.items():
            if id in as_given:
                continue
            ends = [f"_{k + 1}" for k in range(len(symbols))] if len(symbols) > 1 else [""]
            remembered[id] = [f"{id}_memory{end}" for end in ends]
            for symbol, text, at_rest in zip(symbols, remembered[id], long_ago[id], strict=True):
                symbol.label, start[text] = text, at_rest
        return cls(seconds, balance, x, remembered, parameters, inputs, start, sum(term.delay for term in terms))

    def make_dynamics(self, after: Mapping[str, Any]) -> Dynamics:
        """Return the step without unused state variables."""
        after = {**after, **self.after}
        names_kept, required = {"time", "position", "velocity"}, set(after)
        while required:
            values = [_convert_operand(after[text]) for text in names_kept]
            required = {symbol.label for symbol in sort_symbols(values) if symbol.op == NAME} & set(after) - names_kept
            names_kept |= required
        state = tuple(text for text in after if text in names_kept)
        for text in state:
            set_label(after[text], f"{text}_after")
        names = [parameter.name for parameter in self.parameters] + [*state]
        if twice := [x for x in names if names.count(x) > 1 or re.fullmatch(r"t\d+|\w+_at_\w+|\w+_after", x)]:
            raise ExportError(f"'{twice[0]}' cannot be the name of a parameter in a program: rename it in its effect")
        return Dynamics(
            self.seconds,
            tuple(self.parameters),
            tuple(self.given),
            state,
            tuple(_convert_operand(self.start[text]) for text in state),
            tuple(_convert_operand(after[text]) for text in state),
            self.delay / self.seconds,
        )


def make_identifier(text: str) -> str:
    """Convert the name of a parameter to an identifier."""
    plain = re.sub(r"\W", "_", text, flags=re.ASCII)
    return f"{plain}_" if plain in RESERVED or iskeyword(plain) or plain[0].isdigit() else plain


def _convert_operand(value: Any) -> Operand:
    return value if isinstance(value, Symbol) else float(value)
