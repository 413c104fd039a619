"""Simulation step of a model as symbolic expressions."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from keyword import iskeyword
from typing import Any, Self, cast

import numpy as np

from pendulum_env.physics import Estimate, Model, Samples
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.simulation import TorqueBalance, step, write_balance
from pendulum_env.physics.symbols import NAME, Operand, Symbol, make_symbol, set_label, sort_symbols
from pendulum_env.physics.term import ROOM
from pendulum_env.recording.vocabulary import SI
from robots.servos import OUTPUT_UNITS, ServoDrive
from robots.servos.loop import (
    GAINS,
    Controller,
    ControllerState,
    ServoInputs,
    compute_control,
    compute_gains,
    compute_taps,
)
from workbench.export.request import ExportError
from workbench.export.servo import Motor, Servo, get_supply

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


def write_step(model: Model, seconds: float, actuator: Motor | Servo) -> Dynamics:
    """Write the step of a model with a torque input, or with a drive and a goal input.

    Raises ExportError if a law of the model cannot be converted to an expression.
    """
    try:
        parts = _StepBuilder.from_model(model, seconds)
        if isinstance(actuator, Servo):
            parts.take_goal(actuator.controller)
        x = step(parts.balance, parts.x, seconds)
    except Exception as error:  # a user's law may raise anything
        raise ExportError(f"a law of this model cannot be written down as a formula: {error}") from None
    after = {"time": x.time, "position": x.position, "velocity": x.velocity}
    for id, names in parts.remembered.items():
        after |= dict(zip(names, x.memory[id], strict=True))
    return parts.make_dynamics(after)


@dataclass
class _StepBuilder:
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

    def take_goal(self, drive: ServoDrive) -> None:
        """Replace the torque input by a drive with a goal input, which delays its own output."""
        seconds, x = self.seconds, self.x
        is_always_sampled = drive.rate is None or drive.rate * seconds >= 1.0
        gains: dict[str, Any] = dict(zip(GAINS, compute_gains(drive, seconds), strict=True))
        output = {"duty": "1", "voltage": "V", "current": "A", "torque": drive.unit}[drive.output]
        per = "s/rad" if drive.acts_on_speed else "rad"
        units = {"kp": f"{output}/{per}", "ki": f"{output}/({per} s)", "kd": f"{output} s/rad", "limit": output}
        for text, unit in units.items():
            if gains[text] not in (0.0, math.inf):
                self.parameters.append(NamedParameter(text, gains[text], unit, 0.0))
                gains[text] = make_symbol(self.parameters[-1].name)
        gains["stop_output"] = gains["limit"] if math.isfinite(gains["stop_output"]) else math.inf
        gains["max_integral"] = gains["limit"] / gains["ki"] if math.isfinite(gains["max_integral"]) else math.inf
        scale: Any = 1.0
        self.given[0] = StepQuantity("goal", "rad/s" if drive.acts_on_speed else "rad")
        if drive.output == "duty":
            self.given.append(StepQuantity("supply", "V", get_supply(drive)))
            scale = make_symbol("supply")
        if drive.gain is not None:
            self.parameters.append(NamedParameter("gain", drive.gain, f"N m/{OUTPUT_UNITS[drive.output]}", 0.0))
            scale = scale * make_symbol("gain")
        self.given.append(StepQuantity("on", "0: the motor is open", 1.0))
        weights = compute_taps(np.array((drive.delay + self.delay) / seconds)).tolist()
        self.delay = 0.0
        phase: Any = make_symbol("phase")  # time to the controller's next sample, in its periods
        samples_per_step, period = seconds * (drive.rate or 0.0), 1.0 / (drive.rate or math.inf)
        sample_time: Any = 0.5 * max(seconds - period, 0.0) if drive.rate else 0.0
        has_sample: Any = 1.0
        share: Any = 1.0
        elapsed: Any = seconds
        last_sample_time: Any = make_symbol("last_lead")
        if not is_always_sampled:
            sample_time, has_sample = np.maximum(phase, 0.0) * period, samples_per_step * (1.0 - 1e-6) - phase
            share, elapsed = 1.0 - sample_time / seconds, period - sample_time + last_sample_time
        previous_weight = (0.5 * period - sample_time) / elapsed
        past_outputs = tuple(make_symbol(f"before_{k + 1}") for k in range(len(weights) - 1))
        speed = x.velocity if is_always_sampled and gains["speed_weight"] == 1.0 else make_symbol("speed")
        last = make_symbol("last_velocity") if drive.rate else x.velocity
        integral: Any = make_symbol("integral") if drive.ki else 0.0
        state = ControllerState(make_symbol("held"), past_outputs, integral, speed, last)
        is_on: Any = make_symbol("on")
        goal, last_goal = (cast(Any, make_symbol(name)) for name in ("goal", "last_goal"))
        has_goal_speed = drive.kd > 0 and drive.acts_on_position and drive.derivative == "error"
        goal_speed = (goal - last_goal) / max(seconds, period) if has_goal_speed else 0.0
        times = {"share": share, "sample_time": sample_time, "previous_weight": previous_weight}
        inputs = ServoInputs(goal, scale, is_on, has_sample, **times, goal_speed=goal_speed)
        torque, after = compute_control(x, state, inputs, Controller(gains, weights, drive.acts_on_speed))
        memory = {id: (is_on,) if id == BackEmf.id else memory for id, memory in x.memory.items()}
        self.x = replace(x, torque=torque, memory=memory)
        next_phase = np.where(has_sample > 0, phase + 1.0, phase) - samples_per_step
        self.after = {"held": after.held_output, "integral": after.integral, "speed": after.speed, "phase": next_phase}
        last_values = {"last_lead": (sample_time, last_sample_time), "last_goal": (goal, last_goal)}
        self.after |= {name: np.where(has_sample > 0, *values) for name, values in last_values.items()}
        self.after["last_velocity"] = after.velocity
        self.after |= {symbol.label: value for symbol, value in zip(past_outputs, after.past_outputs, strict=True)}
        self.start |= dict.fromkeys(self.after, 0.0) | {
            "speed": make_symbol("velocity"),
            "last_velocity": make_symbol("velocity"),
            "last_goal": make_symbol("position"),
        }

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
