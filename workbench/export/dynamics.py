"""The simulator's own step of a model, written down: what the forms `python` and `c` hold."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from keyword import iskeyword
from typing import Any

import numpy as np

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.physics import Column, Model, Samples, Term
from pendulum_env.physics.simulation import LONGEST_STEP, Balance, step
from pendulum_env.physics.symbols import Operand, Symbol, labelled, name
from pendulum_env.physics.term import Memory
from workbench.export.request import ExportError

RESERVED = frozenset(  # names that the exported programs and their languages have themselves
    """time position velocity torque commands state step start sign State STEP math abs max min
    auto case char const default do double enum extern float goto int long register short signed sizeof static struct
    switch typedef union unsigned void volatile fabs sin cos tan exp log sqrt tanh atan pow fmax fmin gamma
    round hypot y0 y1 j0 j1 inline restrict memset INFINITY NAN NamedTuple pendulum_step""".split()
)
STAGES = ("start", "middle", "rest")  # of a step: its begin, its middle, and where friction has stopped the joint


@dataclass(frozen=True)
class Parameter:
    """A number of the model that its exported form gives a name to."""

    name: str
    value: float
    unit: str
    std: float


@dataclass(frozen=True)
class Dynamics:
    """One step of a model as expressions in the names of its state, its parameters and `torque`.

    Attributes:
        step: length of a step [s].
        parameters: of the model, by which the expressions are written.
        start: values of the state variables beyond time, position and velocity after long rest, in `position`,
            `velocity` and torque zero.
        memory: names of those state variables.
        after: time, position, velocity and the state variables after the step, in this order.
        delay: of the torque, in steps.
    """

    step: float
    parameters: tuple[Parameter, ...]
    memory: tuple[str, ...]
    start: tuple[Operand, ...]
    after: tuple[Operand, ...]
    delay: float

    @property
    def state(self) -> tuple[str, ...]:
        """Names of all state variables, without the commands on their way."""
        return ("time", "position", "velocity", *self.memory)

    @property
    def waiting(self) -> int:
        """How many commands are on their way to the joint."""
        return math.ceil(self.delay)

    def arriving(self, commands: str) -> str:
        """The command that arrives now, from a list of that name, newest first; one between two is a mean of them."""
        whole, share = divmod(self.delay, 1.0)
        late, later = f"{commands}[{int(whole)}]", f"{commands}[{int(whole) + 1}]"
        return late if share == 0 else f"{1.0 - share!r} * {late} + {share!r} * {later}"


@dataclass
class _Spelled:
    """A balance whose results have names for the reader."""

    balance: Balance
    asked: dict[str, int] = field(default_factory=dict)

    def _label(self, what: str, value: Any) -> Any:
        count = self.asked[what] = self.asked.get(what, -1) + 1
        return labelled(value, f"{what}_at_{STAGES[count]}" if count < len(STAGES) else "")

    def net(self, x: Samples) -> ArrayLike:
        self._label("position", x.position)
        self._label("velocity", x.velocity)
        return self._label("net", self.balance.net(x))

    def dry(self, x: Samples) -> ArrayLike:
        return self._label("dry", self.balance.dry(x))

    def mass(self, x: Samples) -> ArrayLike:
        return self._label("inertia", self.balance.mass(x))

    def advance(self, x: Samples, velocity: Array, duration: ArrayLike) -> Mapping[str, Memory]:
        return self.balance.advance(x, velocity, duration)


def written(model: Model, seconds: float = LONGEST_STEP) -> Dynamics:
    """The step of a model, of that length [s].

    Raises:
        ExportError: if a law of the model is not made of what can be written down.
    """
    parameters = [_parameter(model, column) for column in model.columns]
    terms: list[Term] = []
    for term in model.terms:
        symbols: dict[str, Any] = dict(term.shape)
        for shape in term.shapes:
            if shape in term.free and not term.delay:
                parameter = _shape(model, term, shape.name, shape.unit)
                parameters.append(parameter)
                symbols[shape.name] = name(parameter.name)
        terms.append(replace(term, **symbols))
    theta: Any = [name(identifier(column.name)) for column in model.columns]
    balance = Balance(terms, theta)
    now: Any = [name(text) for text in ("time", "position", "velocity", "torque")]
    try:
        long_ago = balance.start(replace(Samples(*now), torque=np.zeros(())))
        names = {id: _names(id, len(values)) for id, values in long_ago.items()}
        memory: dict[str, Any] = {id: tuple(name(text) for text in texts) for id, texts in names.items()}
        spelled: Any = _Spelled(balance)
        after = step(spelled, replace(Samples(*now), memory=memory), seconds)
    except Exception as error:  # a user's law may do anything that NumPy does
        raise ExportError(f"a law of this model cannot be written down as a formula: {error}") from None
    states: list[Any] = [after.time, after.position, after.velocity]
    states += [
        labelled(value, f"{text}_after")
        for id in names
        for text, value in zip(names[id], after.memory[id], strict=True)
    ]
    for text, value in zip(("time", "position", "velocity"), states, strict=False):
        labelled(value, f"{text}_after")
    used = [parameter.name for parameter in parameters] + [text for texts in names.values() for text in texts]
    twice = [text for text in used if used.count(text) > 1 or re.fullmatch(r"t\d+|\w+_at_\w+|\w+_after", text)]
    if twice:
        raise ExportError(f"'{twice[0]}' cannot be the name of a parameter in a program: rename it in its effect")
    return Dynamics(
        step=seconds,
        parameters=tuple(parameters),
        memory=tuple(text for texts in names.values() for text in texts),
        start=tuple(_operand(value) for values in long_ago.values() for value in values),
        after=tuple(_operand(value) for value in states),
        delay=sum(term.delay for term in model.terms) / seconds,
    )


def identifier(text: str) -> str:
    """A parameter's name as a name in a program."""
    plain = re.sub(r"\W", "_", text, flags=re.ASCII)
    return f"{plain}_" if plain in RESERVED or iskeyword(plain) or plain[0].isdigit() else plain


def _names(id: str, count: int) -> list[str]:
    return [f"{id}_memory"] if count == 1 else [f"{id}_memory_{k + 1}" for k in range(count)]


def _operand(value: Any) -> Operand:
    return value if isinstance(value, Symbol) else float(value)


def _parameter(model: Model, column: Column) -> Parameter:
    estimate = model.estimates[column.name]
    return Parameter(identifier(column.name), estimate.value, estimate.unit, estimate.std)


def _shape(model: Model, term: Term, shape: str, unit: str) -> Parameter:
    estimate = model.estimates.get(f"{term.id}.{shape}")
    std = 0.0 if estimate is None else estimate.std
    unit = unit if estimate is None else estimate.unit
    return Parameter(identifier(f"{term.id}.{shape}"), float(term.shape[shape]), unit, std)
