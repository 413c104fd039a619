"""Simulate servos in closed loop, from the goals of whole recordings.

A closed loop is stable, so a simulation needs no restarts from measurements. Within each integration step, the
controller samples the simulated motion and holds its output until the next sample.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pendulum_env._typing import Array, ArrayLike, Index
from pendulum_env.physics import KnownLoad, Samples, Term
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.friction import TemperatureDependentFriction
from pendulum_env.physics.simulation import StepPrograms, TorqueBalance, stack_rows, step, unstack_rows, write_balance
from pendulum_env.physics.symbols import make_symbol, may_be_true, repeat_step
from pendulum_env.physics.term import ROOM, round_up
from pendulum_env.physics.terms import move_to_motor, read_encoder
from robots.servos.drive import ServoDrive

if TYPE_CHECKING:
    from pendulum_env.physics.compiled import Recurrence

ROUNDING = 2e-3  # difference of equal inputs, relative to their range
GAINS = ("kp", "ki", "kd", "limit", "speed_weight", "period", "lead_time", "stop_output", "max_integral")
# if controllers read counts: step [rad] and a position of the encoder, and whether the speed is a difference of counts
COUNTS = ("encoder_step", "origin", "is_sampled")


@dataclass(frozen=True)
class ControllerSamples:
    """Samples of a controller relative to N steps of the integrator.

    Steps and controller periods have different lengths and phases. The output of a sample acts until the next one.
    Samples within a step are averaged with these durations as weights.

    Attributes:
        rate: rate of the controller [Hz].
        step: step of the integrator [s].
        count: number of steps N.
    """

    rate: float
    step: float
    count: int

    @cached_property
    def time(self) -> Array:
        """Return the times of the samples (K,) [s]."""
        return np.arange(math.ceil(self.count * self.step * self.rate - 1e-6)) / self.rate

    @cached_property
    def _step_index(self) -> Index:
        return np.floor(self.time / self.step + 1e-6).astype(np.intp)

    @cached_property
    def _duration(self) -> Array:
        """Return the time from each sample to the next one or to the end of its step (K,) [s]."""
        return np.minimum(self.time + 1.0 / self.rate, (self._step_index + 1) * self.step) - self.time

    @cached_property
    def has_sample(self) -> Array:
        """Return 1 for steps with a sample and 0 for others (N,)."""
        return (self.share > 0).astype(float)

    @cached_property
    def share(self) -> Array:
        """Return the share of each step after its first sample (N,)."""
        return np.bincount(self._step_index, self._duration, self.count) / self.step

    @cached_property
    def sample_time(self) -> Array:
        """Return the mean time of the samples from the start of their step (N,) [s]."""
        return self.average(np.maximum(self.time - self._step_index * self.step, 0.0))

    @cached_property
    def previous_weight(self) -> Array:
        """Return the weight of the previous velocity in the measured one (N,).

        States have the velocity at the start of a step; a difference of positions is the velocity half a period ago.
        """
        steps = np.flatnonzero(self.has_sample)
        elapsed = np.full(self.count, max(self.step, 1.0 / self.rate))
        elapsed[steps[1:]] = np.diff(steps) * self.step
        return (0.5 / self.rate - self.sample_time) / elapsed

    def average(self, values: Array) -> Array:
        """Return the means (N,) per step of values at the samples (K,); 0 for steps without a sample."""
        weighted = np.bincount(self._step_index, self._duration * values, self.count)
        return np.asarray(weighted / np.maximum(self.share * self.step, 1e-300))


@dataclass(frozen=True)
class Servos:
    """Inputs of B servos over N steps of the integrator.

    Attributes:
        drives: drive of each servo (B,).
        step: step of the integrator [s].
        goal: goal of the controller per step (N, B) [rad, or rad/s].
        supply: bus voltage per step (N, B) [V].
        is_on: whether the motor has power (N, B).
        position, velocity: initial state (B,) [rad, rad/s].
        start: time of the first sample (B,) [s].
        load: known loads (B,), with their torque per step (N, B).
        temperature: temperature per step (N, B) [deg C]; None if not measured.
        encoder_step: step of the encoder that position controllers read [rad], from the initial position; None: they
            read the exact position. The speed of a continuous controller is exact.
        ends: number of steps of each servo (B,); later ones need no simulation. None: all steps.
    """

    drives: tuple[ServoDrive, ...]
    step: float
    goal: Array
    supply: Array
    is_on: Array
    position: Array
    velocity: Array
    start: Array
    load: KnownLoad
    temperature: Array | None = None
    encoder_step: float | None = None
    ends: Index | None = None

    @property
    def at_output(self) -> bool:
        """Return whether the encoders are at the output of the gear."""
        return self.drives[0].encoder == "output"

    @cached_property
    def programs(self) -> StepPrograms:
        """Return the compiled steps by model."""
        return StepPrograms()

    @property
    def has_derivative(self) -> bool:
        """Return whether a controller acts on the derivative of its error."""
        return any(drive.kd > 0 and drive.derivative == "error" for drive in self.drives)

    @property
    def is_sampled(self) -> bool:
        """Return whether a controller has a rate."""
        return any(drive.rate is not None for drive in self.drives)

    @cached_property
    def samples(self) -> list[ControllerSamples]:
        """Return the samples of each controller, at the start of each step for continuous controllers."""
        return [ControllerSamples(drive.rate or 1.0 / self.step, self.step, len(self.goal)) for drive in self.drives]

    @property
    def n_inputs(self) -> int:
        """Return the number of inputs: 6 if all controllers are continuous, 10 with a `has_derivative`, else 9."""
        return 10 if self.has_derivative else 9 if self.is_sampled else 6

    @cached_property
    def load_torque(self) -> Array:
        """Return the torque of the known loads per step (N, B) [N m]."""
        return np.broadcast_to(self.load.torque, self.goal.shape)

    def make_inputs(self) -> Array:
        """Return the inputs per step (N, C, B), in the order of `ServoInputs`; they need much memory."""
        scale = np.column_stack([drive.scale(supply) for drive, supply in zip(self.drives, self.supply.T, strict=True)])
        temperature = np.full_like(self.goal, ROOM) if self.temperature is None else self.temperature
        times = [np.ones_like(self.goal)]
        if self.is_sampled or self.has_derivative:
            is_continuous = [drive.rate is None for drive in self.drives]  # continuous controllers
            names = ("has_sample", "share", "sample_time", "previous_weight")
            times = [np.column_stack([getattr(samples, name) for samples in self.samples]) for name in names]
            times[3] = np.where(is_continuous, 0.0, times[3])
        if self.has_derivative:
            last_sample = np.maximum.accumulate(np.where(times[0] > 0, np.arange(len(self.goal))[:, None], 0))
            change = np.diff(np.take_along_axis(self.goal, last_sample, axis=0), axis=0, prepend=self.goal[:1])
            periods = [max(self.step, 1.0 / samples.rate) for samples in self.samples]
            times.append(np.where([drive.derivative == "error" for drive in self.drives], change / periods, 0.0))
        return np.stack([self.goal, scale, self.is_on, times[0], temperature, self.load_torque, *times[1:]], axis=1)

    def count_equal_steps(self, every: int) -> int:
        """Return `every` if all inputs are constant over so many steps, apart from rounding of the clock; else 1."""
        if len(self.goal) % every:
            return 1
        if every not in self._equal_steps:
            series = (one.reshape(-1, every, one.shape[1]) for one in np.moveaxis(self.make_inputs(), 1, 0))
            is_equal = (
                np.abs(rows - rows[:, every // 2, None]).max() <= ROUNDING * span
                for rows in series
                if (span := np.ptp(rows))  # else it is constant
            )
            self._equal_steps[every] = every if all(is_equal) else 1
        return self._equal_steps[every]

    @cached_property
    def _equal_steps(self) -> dict[int, int]:
        return {1: 1}

    def list_inputs(self, terms: Sequence[Term], repeats: int) -> Array:
        """Return the inputs of each `repeats` equal steps with the known states of terms in their middle."""
        inputs = self.make_inputs()[repeats // 2 :: repeats]
        middles = self.start + self.step * repeats * (np.arange(len(inputs)) + 0.5)[:, None]
        known = [series for term in terms for series in term.list_known_states(middles)]
        return np.concatenate([inputs, np.stack(known, axis=1)], axis=1) if known else inputs

    def list_spans(self, every: int) -> list[Span]:
        """Return spans of steps, each of a multiple of `every`, with the servos that have not ended."""
        ends = np.full(len(self.drives), len(self.goal)) if self.ends is None else -(-self.ends // every) * every
        edges = np.unique([0, *ends]).tolist()
        return [Span(begin, end, np.flatnonzero(ends >= end)) for begin, end in pairwise(edges)]

    @cached_property
    def _wrapped_inputs(self) -> dict[Hashable, list[Array]]:
        return {}

    def wrap_inputs(self, step: Recurrence, terms: Sequence[Term], every: int, repeats: int) -> list[Array]:
        """Return the inputs of each span in the layout of a compiled step, memoised by its width and known states."""
        key = step.width, every, repeats, *(type(term) for term in terms if term.has_known_states())
        if key not in self._wrapped_inputs:
            inputs = self.list_inputs(terms, repeats)
            self._wrapped_inputs[key] = [
                step.wrap_inputs(inputs[begin // repeats : end // repeats][..., places])
                for begin, end, places in self.list_spans(every)
            ]
        return self._wrapped_inputs[key]


class Span(NamedTuple):
    """Steps of the integrator from `begin` to before `end`, and the places of the servos that are simulated."""

    begin: int
    end: int
    places: Index


class ControllerState(NamedTuple):
    """State of a controller: held and past outputs, integral of the error, filtered speed, velocity at the last sample.

    A difference of positions equals the mean of the velocities at both samples if the acceleration is constant.
    """

    held_output: Any
    past_outputs: tuple[Any, ...]
    integral: Any
    speed: Any
    velocity: Any


class ServoInputs(NamedTuple):
    """Inputs of a servo over a step: goal, output scale, power, sample, temperature [deg C], load torque [N m].

    A sample (`has_sample`) acts over the last `share` of the step. It has the position at `sample_time` [s] after the
    start of the step, and the velocity of the previous sample with the weight `previous_weight`. `goal_speed` is 0
    unless the controller acts on the derivative of the error.
    """

    goal: Any
    scale: Any
    is_on: Any
    has_sample: Any
    temperature: Any = ROOM
    load_torque: Any = 0.0
    share: Any = 1.0
    sample_time: Any = 0.0
    previous_weight: Any = 0.0
    goal_speed: Any = 0.0


class Controller(NamedTuple):
    """Law of a controller: gains by name, weights of the last outputs, newest first, and the controlled quantity."""

    gains: Mapping[str, Any]
    taps: Sequence[Any]
    acts_on_speed: bool


def simulate_servos(terms: Sequence[Term], theta: Array, servos: Servos, every: int = 1) -> Array:
    """Simulate B servos with V models each.

    Args:
        terms: terms of the models, with nonlinear parameters as scalars or (V, 1) arrays.
        theta: linear parameters (P, V).
        servos: goals and other inputs of the servos.
        every: steps between returned positions.

    Returns:
        Encoder positions at the start and after each `every` steps (N / every + 1, V, B) [rad]; a servo that has ended
        keeps its last one.
    """
    h, shape = servos.step, (theta.shape[1], len(servos.drives))
    delays = sum((np.asarray(term.delay, dtype=float) for term in terms), np.zeros(1)).reshape(-1, 1)
    steps = (delays + np.array([drive.delay for drive in servos.drives])) / h
    weights = compute_taps(np.broadcast_to(steps, shape))
    speed = servos.drives[0].acts_on_speed
    if any(drive.acts_on_speed != speed for drive in servos.drives):
        raise ValueError("servos under position and under velocity control cannot be simulated at once")
    if any((drive.encoder == "output") != servos.at_output for drive in servos.drives):
        raise ValueError("servos with encoders at the motor and at the output cannot be simulated at once")
    has_load, has_integral = bool(servos.load), any(drive.ki for drive in servos.drives)
    gains = np.array([compute_gains(drive, servos.step) for drive in servos.drives]).T
    names: tuple[str, ...] = GAINS
    if servos.encoder_step is not None:
        is_sampled = [float(drive.rate is not None) for drive in servos.drives]
        encoder = np.full(len(servos.drives), servos.encoder_step), servos.position, is_sampled
        names, gains = (*GAINS, *COUNTS), np.vstack([gains, *encoder])
    count = servos.n_inputs
    options = speed, len(weights), has_load, has_integral, h, servos.at_output, count, names
    program = servos.programs.find(_compile_step, terms, *options)
    nonlinear = [value for term in terms for value in term.free_values]
    theta = theta[:, :, None]
    constants = [*theta, *nonlinear, *gains[:, None], *(servos.load[:2] if has_load else ()), *weights, h]
    parameters = np.array([np.broadcast_to(value, shape) for value in constants])
    q, v = (np.broadcast_to(part, shape) for part in (servos.position, servos.velocity))
    x = Samples(servos.start, q, v, np.zeros(shape), load=servos.load._replace(torque=servos.load_torque[0]))
    balance = TorqueBalance(terms, theta, has_load)
    x = move_to_motor(replace(x, memory=balance.start(x)), terms, servos.at_output)
    first_reading = v if servos.encoder_step is None else q
    state = ControllerState(np.zeros(shape), (np.zeros(shape),) * (len(weights) - 1), np.zeros(shape), v, first_reading)
    rows, seen = _flatten_state(x, state, has_integral), read_encoder(x, terms, servos.at_output).position
    encoder_row = next(k for k, row in enumerate(rows) if row is seen)
    states = np.array([np.broadcast_to(row, shape) for row in rows])
    if program is not None:
        repeats = servos.count_equal_steps(every) if any(term.has_known_states() for term in terms) else 1
        path = np.empty((len(servos.goal) // every + 1, *shape))
        inputs = servos.wrap_inputs(program, terms, every, repeats)
        for (begin, end, places), of_span in zip(servos.list_spans(every), inputs, strict=True):
            given = parameters[..., places], states[..., places]
            part, states[..., places] = program.run(of_span, *given, every, repeats, [encoder_row])
            path[begin // every : end // every + 1, :, places] = part[:, 0]
            path[end // every + 1 :, :, places] = part[-1, 0]
        return path

    def simulate_step(inputs: Array, rows: Array) -> list[Any]:  # for a user's law that is not symbolic
        output, *past = rows[len(stack_rows(x)) :]
        past_outputs, (filtered, velocity, *integral) = past[: len(weights) - 1], past[len(weights) - 1 :]
        state = ControllerState(output, tuple(past_outputs), integral[0] if has_integral else 0.0, filtered, velocity)
        controller = Controller(dict(zip(names, gains, strict=True)), [*weights], speed)
        known = _name_known_states(x, terms, iter(inputs[count:]))
        options = state, ServoInputs(*inputs[:count]), controller, h, servos.at_output, known
        return _flatten_state(*step_servo(balance, unstack_rows(rows, x), *options), has_integral)

    return repeat_step(simulate_step, servos.list_inputs(terms, 1), states, every)[:, encoder_row]


def _name_known_states(x: Samples, terms: Sequence[Term], rows: Iterator[Any]) -> dict[str, Any]:
    """Return the known states of terms by id, from their rows; `x` has as many states."""
    known = [term.id for term in terms if term.has_known_states()]
    return {id: tuple(next(rows) for _ in x.memory[id]) for id in known}


def compute_gains(drive: ServoDrive, step: float) -> tuple[float, ...]:
    """Return the numbers of a controller in the order of `GAINS`.

    `limit` is the largest output, `speed_weight` the filter's weight of a new speed, `lead_time` the time by which the
    error is integrated before the output is computed [s], and `stop_output` the output above which the integral stops.
    """
    controller_period = step if drive.rate is None else 1.0 / drive.rate
    period = max(step, controller_period)
    share = 1.0 if drive.cutoff is None else 1.0 - math.exp(-2 * math.pi * drive.cutoff * controller_period)
    # the same lag with several controller periods per step
    speed_weight = period / (period + controller_period * (1.0 - share) / share)
    lead_time = controller_period if drive.integral == "before" and drive.rate is not None else 0.0
    limit, stop_output = drive.max_output, math.inf if drive.windup in ("clamp", "free") else drive.max_output
    max_integral = limit / drive.ki if drive.windup == "clamp" and drive.ki else math.inf
    return drive.kp, drive.ki, drive.kd, limit, speed_weight, period, lead_time, stop_output, max_integral


def _flatten_state(x: Samples, state: ControllerState, has_integral: bool) -> list[Any]:
    """Flatten samples and controller state to rows."""
    integral = [state.integral] if has_integral else []
    return [*stack_rows(x), state.held_output, *state.past_outputs, state.speed, state.velocity, *integral]


def compute_taps(steps: Array) -> Array:
    """Compute the weights (T, ...) of the last T outputs, newest first, from delays in steps, with interpolation."""
    whole = np.floor(steps + 1e-9)
    share = np.maximum(steps - whole, 0.0)
    count = 2 ** math.ceil(math.log2(int(whole.max()) + 1 + bool(share.any())))  # a power of two: few programs
    place = np.arange(count).reshape(-1, *(1,) * steps.ndim)
    return np.asarray(np.where(place == whole, 1 - share, 0.0) + np.where(place == whole + 1, share, 0.0))


def step_servo(
    balance: TorqueBalance,
    x: Samples,
    state: ControllerState,
    inputs: ServoInputs,
    controller: Controller,
    h: ArrayLike,
    at_output: bool,
    known: Mapping[str, Any],
) -> tuple[Samples, ControllerState]:
    """Advance servos and controllers by one step of h [s], in symbols or arrays.

    `known` has the known states of terms, by id.
    """
    encoder = read_encoder(x, balance.terms, at_output)
    torque, state = compute_control(encoder, state, inputs, controller)
    measured = {BackEmf.id: (inputs.is_on,), TemperatureDependentFriction.id: (inputs.temperature, 0.0), **known}
    memory: Any = {id: measured.get(id, memory) for id, memory in x.memory.items()}
    load = x.load._replace(torque=inputs.load_torque)
    after = step(balance, replace(x, torque=torque, memory=memory, load=load), h)
    return after, state


def compute_control(
    x: Samples, state: ControllerState, inputs: ServoInputs, controller: Controller
) -> tuple[Any, ControllerState]:
    """Return the commanded torque over a step and the controller's state, in symbols or arrays."""
    gains, taps, acts_on_speed = controller
    is_sampled = inputs.has_sample > 0
    position = x.position + inputs.sample_time * x.velocity if may_be_true(inputs.sample_time != 0.0) else x.position
    reading = x.velocity
    if "encoder_step" in gains:
        counts = np.rint((position - gains["origin"]) / gains["encoder_step"])
        reading = position = gains["origin"] + gains["encoder_step"] * counts
        measured = np.where(gains["is_sampled"] > 0, (position - state.velocity) / gains["period"], x.velocity)
    else:
        measured = x.velocity - inputs.previous_weight * (x.velocity - state.velocity)
    measured = measured - inputs.goal_speed if may_be_true(inputs.goal_speed != 0.0) else measured
    filtered_speed = np.where(is_sampled, state.speed + gains["speed_weight"] * (measured - state.speed), state.speed)
    error = inputs.goal - (filtered_speed if acts_on_speed else position)
    damping = 0.0 if acts_on_speed else gains["kd"] * filtered_speed
    output, new_integral = compute_output(error, damping, state.integral, gains)
    integral = np.where(is_sampled, new_integral, state.integral)
    integral = np.where(inputs.is_on > 0, integral, 0.0)  # reset without power
    held_output = np.where(is_sampled, output * inputs.scale, state.held_output)
    mean_output = held_output
    if may_be_true(inputs.share != 1.0):
        mean_output = state.held_output + inputs.share * (held_output - state.held_output)
    outputs = (mean_output, *state.past_outputs)
    torque: Any = inputs.is_on * sum(weight * output for weight, output in zip(taps, outputs, strict=True))
    reading = np.where(is_sampled, reading, state.velocity)
    return torque, ControllerState(held_output, outputs[:-1], integral, filtered_speed, reading)


def compute_output(error: Any, damping: Any, integral: Any, gains: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return the output of a controller at a sample and the integral after it, in symbols, arrays or numbers."""
    bound = gains["max_integral"]
    lead_integral = np.maximum(np.minimum(integral + gains["lead_time"] * error, bound), -bound)
    unlimited = gains["kp"] * error + gains["ki"] * lead_integral - damping
    output = np.maximum(np.minimum(unlimited, gains["limit"]), -gains["limit"])
    is_winding = (np.abs(unlimited) > gains["stop_output"]) & (unlimited * error > 0)
    new_integral = integral + np.where(is_winding, 0.0, gains["period"] * error)
    return output, np.maximum(np.minimum(new_integral, bound), -bound)


def _compile_step(
    terms: Sequence[Term],
    acts_on_speed: bool,
    taps: int,
    has_load: bool,
    has_integral: bool,
    longest: float,
    at_output: bool,
    count: int,
    names: tuple[str, ...],
) -> Recurrence | None:
    """Compile a step of servos; return None if a law is not symbolic."""
    from pendulum_env.physics.compiled import compile_recurrence  # slow import

    h: Any = make_symbol("h", largest=round_up(longest))
    inputs = ServoInputs(*(make_symbol(text) for text in ServoInputs._fields[:count]))
    gains: dict[str, Any] = {text: make_symbol(text) for text in names}
    weights = [make_symbol(f"tap_{k}") for k in range(taps)]
    past_outputs = tuple(make_symbol(f"past_output_{k}") for k in range(taps - 1))
    integral: Any = make_symbol("integral") if has_integral else 0.0
    held_output, speed, reading = map(make_symbol, ("held_output", "speed", "reading"))
    state = ControllerState(held_output, past_outputs, integral, speed, reading)
    try:
        balance, x, nonlinear = write_balance(terms, has_load)
        controller = Controller(gains if has_integral else gains | {"ki": 0.0}, weights, acts_on_speed)
        rows: Iterable[Any] = (make_symbol(f"known_{k}") for k in range(sum(map(len, x.memory.values()))))
        known = _name_known_states(x, terms, iter(rows))
        after, state_after = step_servo(balance, x, state, inputs, controller, h, at_output, known)
        shared = [*gains.values(), *(x.load[:2] if has_load else ()), *weights, h]
        constants: Any = [*balance.theta, *nonlinear, *shared]
        states = (_flatten_state(x, state, has_integral), _flatten_state(after, state_after, has_integral))
        all_inputs: Any = [*inputs[:count], *(symbol for symbols in known.values() for symbol in symbols)]
        return compile_recurrence(all_inputs, constants, *states)
    except Exception:  # a user's law may raise any error with symbols
        return None
