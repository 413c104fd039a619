"""A model's step, written down: the simulator's own, or what it adds to the step of a physics engine."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from keyword import iskeyword
from typing import Any

import numpy as np

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.physics import Model, Samples, Term
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.simulation import LONGEST_STEP, Balance, step
from pendulum_env.physics.symbols import NAME, Operand, Symbol, in_order, labelled, name
from pendulum_env.physics.term import Memory
from pendulum_env.servo.drive import UNIT, Drive
from pendulum_env.servo.loop import GAINS, Given, State, control, gains_of, taps
from workbench.export.request import ExportError
from workbench.export.servo import supply_of

RESERVED = frozenset(  # names that the exported programs and their languages have themselves
    """time position velocity torque commands state step start sign State STEP math abs max min
    auto case char const default do double enum extern float goto int long register short signed sizeof static struct
    switch typedef union unsigned void volatile fabs sin cos tan exp log sqrt tanh atan pow fmax fmin gamma
    round hypot y0 y1 j0 j1 inline restrict memset INFINITY NAN NamedTuple pendulum_step
    np Any Value SimpleNamespace NUMBERS _functions
    goal supply on applied friction phase held speed integral limit kp ki kd gain""".split()
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
class Quantity:
    """What a step is given, or gives."""

    name: str
    unit: str
    usual: float | None = None


@dataclass(frozen=True)
class Dynamics:
    """One step as expressions in the names of its state, its parameters and what it is given.

    Attributes:
        step: length of a step [s].
        parameters: of the model, by which the expressions are written.
        given: what the step is given beside the state.
        state: names of the state variables.
        start: their values after long rest, in `position` and `velocity`.
        after: their values after the step.
        results: what the step gives beside the state.
        delay: of the torque, in steps, where it is given.
    """

    step: float
    parameters: tuple[Parameter, ...]
    given: tuple[Quantity, ...]
    state: tuple[str, ...]
    start: tuple[Operand, ...]
    after: tuple[Operand, ...]
    results: Mapping[Quantity, Operand] = field(default_factory=dict)
    delay: float = 0.0

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


def written(model: Model, seconds: float = LONGEST_STEP, drive: Drive | None = None) -> Dynamics:
    """The step of a model, of that length [s], under a torque; or under a goal, with a drive.

    Raises:
        ExportError: if a law of the model is not made of what can be written down.
    """
    held, x = _Held.of(model, drive, seconds), _now()
    with _formulas():
        names = _Names.of(model, model.terms)
        spelled: Any = _Spelled(names.balance)
        after = step(spelled, names.under(held), seconds)
        start = {"time": 0.0, "position": x.position, "velocity": x.velocity} | names.start | held.start
        states: dict[str, Any] = {"time": after.time, "position": after.position, "velocity": after.velocity}
        states |= names.flat(after.memory) | held.after
    delay = 0.0 if drive else sum(term.delay for term in model.terms) / seconds
    return _dynamics(seconds, (*names.parameters, *held.parameters), held.given, start, states, {}, delay)


def beside(model: Model, terms: Sequence[Term], drive: Drive | None, seconds: float = LONGEST_STEP) -> Dynamics:
    """What some terms of a model, and perhaps a drive, add to each step of an engine that has the other terms.

    The step is told where the joint is, and gives the torque to apply and the largest dry friction to allow.

    Raises:
        ExportError: if a law of the model is not made of what can be written down, or adds inertia that varies.
    """
    held = _Held.of(model, drive, seconds)
    with _formulas():
        names = _Names.of(model, terms)
        balance, x = names.balance, names.under(held)
        applied, dry = balance.net(x), np.maximum(balance.dry(x), 0.0)
        memory = balance.advance(x, x.velocity, seconds)
        states: dict[str, Any] = {"time": x.time + seconds} | names.flat(memory) | held.after
    unit, given = model.torque_unit, (Quantity("position", "rad"), Quantity("velocity", "rad/s"), *held.given)
    results = {Quantity("applied", unit): _operand(applied), Quantity("friction", unit): _operand(dry)}
    start, delay = {"time": 0.0} | names.start | held.start, sum(term.delay for term in terms) / seconds
    parameters = (*names.parameters, *held.parameters)
    return _dynamics(seconds, parameters, given, start, states, results, 0.0 if drive else delay)


@contextmanager
def _formulas() -> Iterator[None]:
    """A law that cannot be written down is told in a sentence."""
    try:
        yield
    except Exception as error:  # a user's law may do anything that NumPy does
        raise ExportError(f"a law of this model cannot be written down as a formula: {error}") from None


def _dynamics(
    seconds: float,
    parameters: tuple[Parameter, ...],
    given: tuple[Quantity, ...],
    start: Mapping[str, Any],
    after: Mapping[str, Any],
    results: Mapping[Quantity, Operand],
    delay: float = 0.0,
) -> Dynamics:
    """A step without the state variables that nothing depends on."""
    kept = {"time"} | ({"position", "velocity"} & set(after))
    while True:
        needed = {
            symbol.label
            for symbol in in_order([*results.values(), *(_operand(after[text]) for text in kept)])
            if symbol.op == NAME
        }
        if not (more := needed & set(after) - kept):
            break
        kept |= more
    state = tuple(text for text in after if text in kept)
    for text in state:
        labelled(after[text], f"{text}_after")
    used = [parameter.name for parameter in parameters] + [*state]
    twice = [text for text in used if used.count(text) > 1 or re.fullmatch(r"t\d+|\w+_at_\w+|\w+_after", text)]
    if twice:
        raise ExportError(f"'{twice[0]}' cannot be the name of a parameter in a program: rename it in its effect")
    return Dynamics(
        seconds,
        parameters,
        given,
        state,
        tuple(_operand(start[text]) for text in state),
        tuple(_operand(after[text]) for text in state),
        results,
        delay,
    )


@dataclass(frozen=True)
class _Names:
    """Terms of a model in names: their parameters, their balance, and what they remember."""

    parameters: tuple[Parameter, ...]
    balance: Balance
    memory: Mapping[str, tuple[str, ...]]
    start: dict[str, Operand]

    @classmethod
    def of(cls, model: Model, terms: Sequence[Term]) -> _Names:
        parameters = [_estimated(model, column.name, column.unit) for term in terms for column in term.columns]
        named: list[Term] = []
        for term in terms:
            symbols: dict[str, Any] = dict(term.shape)
            for shape in term.shapes:
                if shape in term.free and not term.delay:
                    value = float(term.shape[shape.name])
                    parameters.append(_estimated(model, f"{term.id}.{shape.name}", shape.unit, value))
                    symbols[shape.name] = name(parameters[-1].name)
            named.append(replace(term, **symbols))
        theta: Any = [name(identifier(column.name)) for term in terms for column in term.columns]
        balance = Balance(named, theta)
        long_ago = balance.start(replace(_now(), torque=np.zeros(())))
        memory = {id: _texts(id, len(values)) for id, values in long_ago.items()}
        start = {text: _operand(one) for id in memory for text, one in zip(memory[id], long_ago[id], strict=True)}
        return cls(tuple(parameters), balance, memory, start)

    def under(self, held: _Held) -> Samples:
        """The samples at the start of a step under a torque, or under that of a drive, which brakes while it is on."""
        memory: Any = {id: tuple(name(text) for text in texts) for id, texts in self.memory.items()}
        if held.is_driven and BackEmf.id in memory:
            memory[BackEmf.id] = (name("on"),)
        return replace(_now(), torque=held.torque, memory=memory)

    def flat(self, memory: Mapping[str, Memory]) -> dict[str, Any]:
        """What is remembered, by name."""
        return {text: one for id, texts in self.memory.items() for text, one in zip(texts, memory[id], strict=True)}


@dataclass(frozen=True)
class _Held:
    """A torque in names, or that of a drive: what it is given, and what its controller remembers."""

    torque: Any
    given: tuple[Quantity, ...]
    is_driven: bool = False
    parameters: tuple[Parameter, ...] = ()
    start: dict[str, Operand] = field(default_factory=dict)
    after: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, model: Model, drive: Drive | None, seconds: float) -> _Held:
        x = _now()
        if drive is None:
            return cls(x.torque, (Quantity("torque", model.torque_unit),))
        looks_always = drive.rate is None or drive.rate * seconds >= 1.0
        gains: dict[str, Any] = dict(zip(GAINS, gains_of(drive, seconds), strict=True))
        output = {"duty": "1", "voltage": "V", "current": "A", "torque": model.torque_unit}[drive.output]
        per = "s/rad" if drive.acts_on_speed else "rad"
        units = {"kp": f"{output}/{per}", "ki": f"{output}/({per} s)", "kd": f"{output} s/rad", "most": output}
        parameters = []
        for text, unit in units.items():
            if gains[text] not in (0.0, math.inf):
                parameters.append(Parameter("limit" if text == "most" else text, gains[text], unit, 0.0))
                gains[text] = name(parameters[-1].name)
        scale: Any = 1.0
        given = [Quantity("goal", "rad/s" if drive.acts_on_speed else "rad")]
        if drive.output == "duty":
            given.append(Quantity("supply", "V", supply_of(drive)))
            scale = name("supply")
        if drive.gain is not None:
            parameters.append(Parameter("gain", drive.gain, f"N m/{UNIT[drive.output]}", 0.0))
            scale = scale * name("gain")
        given.append(Quantity("on", "0: the motor is open", 1.0))
        weights = taps(np.array((drive.delay + sum(term.delay for term in model.terms)) / seconds)).tolist()
        due = 1.0 if looks_always else name("phase") - (1.0 - 1e-6)
        before = tuple(name(f"before_{k + 1}") for k in range(len(weights) - 1))
        speed = x.velocity if looks_always and gains["seen"] == 1.0 else name("speed")
        state = State(name("held"), before, name("integral"), speed)
        if not drive.ki:
            state = state._replace(integral=0.0)
        torque, after = control(
            x, state, Given(name("goal"), scale, name("on"), due), gains, weights, drive.acts_on_speed
        )
        starts: dict[str, Operand] = {"held": 0.0, "integral": 0.0, "speed": name("velocity"), "phase": 1.0}
        later: dict[str, Any] = {"held": after.held, "integral": after.integral, "speed": after.speed}
        phase: Any = name("phase")
        later["phase"] = np.where(due > 0, phase - 1.0, phase) + seconds * (drive.rate or 0.0)
        for one, value in zip(before, after.before, strict=True):
            starts[one.label], later[one.label] = 0.0, value
        return cls(torque, tuple(given), True, tuple(parameters), starts, later)


def identifier(text: str) -> str:
    """A parameter's name as a name in a program."""
    plain = re.sub(r"\W", "_", text, flags=re.ASCII)
    return f"{plain}_" if plain in RESERVED or iskeyword(plain) or plain[0].isdigit() else plain


def _now() -> Samples:
    time: Any = name("time")
    position: Any = name("position")
    velocity: Any = name("velocity")
    torque: Any = name("torque")
    return Samples(time, position, velocity, torque)


def _texts(id: str, count: int) -> tuple[str, ...]:
    return (f"{id}_memory",) if count == 1 else tuple(f"{id}_memory_{k + 1}" for k in range(count))


def _operand(value: Any) -> Operand:
    return value if isinstance(value, Symbol) else float(value)


def _estimated(model: Model, text: str, unit: str, value: float = 0.0) -> Parameter:
    """A parameter as the model has it; a shape of an effect may be as it usually is."""
    estimate = model.estimates.get(text)
    if estimate is None:
        return Parameter(identifier(text), value, unit, 0.0)
    return Parameter(identifier(text), estimate.value, estimate.unit, estimate.std)
