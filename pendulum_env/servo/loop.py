"""Simulate servos in closed loop, from the goals of whole recordings.

A closed loop is stable, so a simulation needs no restarts from measurements. Within each integration step, the
controller samples the simulated motion and holds its output until the next sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pendulum_env._typing import Array, ArrayLike, Index
from pendulum_env.physics import KnownLoad, Samples, Term
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.friction import TemperatureDependentFriction
from pendulum_env.physics.simulation import StepPrograms, TorqueBalance, stack_rows, step, unstack_rows, write_balance
from pendulum_env.physics.symbols import make_symbol, may_be_true, repeat
from pendulum_env.physics.term import ROOM, round_up
from pendulum_env.physics.terms import move_to_motor, read_encoder
from pendulum_env.servo.drive import ServoDrive

if TYPE_CHECKING:
    from pendulum_env.physics.compiled import Recurrence

GAINS = ("kp", "ki", "kd", "most", "seen", "turn", "first", "halt", "room")  # see `compute_gains`
# if controllers read counts: step [rad] and a position of the encoder, and whether the speed is a difference of counts
COUNTS = ("encoder_step", "origin", "is_sampled")


@dataclass(frozen=True)
class Looks:
    """Sampling times of a controller ("looks") relative to N steps of the integrator.

    Steps and controller periods have different lengths and phases. The output of a look acts until the next look. Looks
    within a step are averaged with these durations as weights.

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
        """Return the times of the looks (K,) [s]."""
        return np.arange(math.ceil(self.count * self.step * self.rate - 1e-6)) / self.rate

    @cached_property
    def _step_of(self) -> Index:
        return np.floor(self.time / self.step + 1e-6).astype(np.intp)

    @cached_property
    def _duration(self) -> Array:
        """Return the time from each look to the next one or to the end of its step (K,) [s]."""
        return np.minimum(self.time + 1.0 / self.rate, (self._step_of + 1) * self.step) - self.time

    @cached_property
    def due(self) -> Array:
        """Return 1 for steps with a look and 0 for others (N,)."""
        return (self.share > 0).astype(float)

    @cached_property
    def share(self) -> Array:
        """Return the share of each step after its first look (N,)."""
        return np.bincount(self._step_of, self._duration, self.count) / self.step

    @cached_property
    def lead(self) -> Array:
        """Return the mean time of the looks from the start of their step (N,) [s]."""
        return self.average(np.maximum(self.time - self._step_of * self.step, 0.0))

    @cached_property
    def old(self) -> Array:
        """Return the weight of the previous velocity in the measured one (N,).

        States have the velocity at the start of a step; a difference of positions is the velocity half a period ago.
        """
        steps = np.flatnonzero(self.due)
        elapsed = np.full(self.count, max(self.step, 1.0 / self.rate))
        elapsed[steps[1:]] = np.diff(steps) * self.step
        return (0.5 / self.rate - self.lead) / elapsed

    def average(self, values: Array) -> Array:
        """Return the means (N,) per step of values at the looks (K,); 0 for steps without a look."""
        weighted = np.bincount(self._step_of, self._duration * values, self.count)
        return np.asarray(weighted / np.maximum(self.share * self.step, 1e-300))


@dataclass(frozen=True)
class Servos:
    """Inputs of B servos over N steps of the integrator.

    Attributes:
        drives: drive of each servo (B,).
        step: step of the integrator [s].
        goal: goal of the controller per step (N, B) [rad, or rad/s].
        supply: bus voltage per step (N, B) [V].
        on: whether the motor has power (N, B).
        position, velocity: initial state (B,) [rad, rad/s].
        start: time of the first sample (B,) [s].
        load: known loads (B,), with their torque per step (N, B).
        temperature: temperature per step (N, B) [deg C]; None if not measured.
        encoder_step: step of the encoder that position controllers read [rad], from the initial position; None: they
            read the exact position. The speed of a continuous controller is exact.
    """

    drives: tuple[ServoDrive, ...]
    step: float
    goal: Array
    supply: Array
    on: Array
    position: Array
    velocity: Array
    start: Array
    load: KnownLoad
    temperature: Array | None = None
    encoder_step: float | None = None

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
    def looks(self) -> list[Looks]:
        """Return the looks of each controller; continuous controllers look at the start of each step."""
        return [Looks(drive.rate or 1.0 / self.step, self.step, len(self.goal)) for drive in self.drives]

    @cached_property
    def inputs(self) -> Array:
        """Return the inputs per step (N, C, B), in the order of `ServoInputs`.

        C is 6 if all controllers are continuous, 10 if one acts on the derivative of its error, else 9.
        """
        scale = np.column_stack([drive.scale(supply) for drive, supply in zip(self.drives, self.supply.T, strict=True)])
        warm = np.full_like(self.goal, ROOM) if self.temperature is None else self.temperature
        outside = np.broadcast_to(self.load.torque, self.goal.shape)
        times = [np.ones_like(self.goal)]
        if self.is_sampled or self.has_derivative:
            acts = [drive.rate is None for drive in self.drives]  # continuous controllers
            names = ("due", "share", "lead", "old")
            times = [np.column_stack([getattr(look, name) for look in self.looks]) for name in names]
            times[3] = np.where(acts, 0.0, times[3])
        if self.has_derivative:
            latest = np.maximum.accumulate(np.where(times[0] > 0, np.arange(len(self.goal))[:, None], 0))
            change = np.diff(np.take_along_axis(self.goal, latest, axis=0), axis=0, prepend=self.goal[:1])
            turns = [max(self.step, 1.0 / look.rate) for look in self.looks]
            times.append(np.where([drive.derivative == "error" for drive in self.drives], change / turns, 0.0))
        return np.stack([self.goal, scale, self.on, times[0], warm, outside, *times[1:]], axis=1)

    @cached_property
    def _wrapped_inputs(self) -> dict[int, Array]:
        return {}

    def wrap_inputs(self, step: Recurrence) -> Array:
        """Return the inputs in the layout of a compiled step, memoised by its width."""
        if step.width not in self._wrapped_inputs:
            self._wrapped_inputs[step.width] = step.wrap_inputs(self.inputs)
        return self._wrapped_inputs[step.width]


class ControllerState(NamedTuple):
    """State of a controller: held and past outputs, integral of the error, filtered speed, velocity at the last look.

    A difference of positions equals the mean of the velocities at both looks if the acceleration is constant.
    """

    held: Any
    before: tuple[Any, ...]
    integral: Any
    speed: Any
    velocity: Any


class ServoInputs(NamedTuple):
    """Inputs of a servo over a step: goal, scale of the output, power, look, temperature [deg C], load torque [N m].

    A look (`due`) acts over the last `share` of the step. It reads the position `lead` [s] after the start of the step,
    and the velocity of the previous look has the weight `old`. `goal_speed` is 0 unless the controller acts on the
    derivative of the error.
    """

    goal: Any
    scale: Any
    on: Any
    due: Any
    temperature: Any = ROOM
    load_torque: Any = 0.0
    share: Any = 1.0
    lead: Any = 0.0
    old: Any = 0.0
    goal_speed: Any = 0.0


def simulate_servos(terms: Sequence[Term], theta: Array, servos: Servos, every: int = 1) -> Array:
    """Simulate B servos with V models each.

    Args:
        terms: terms of the models, with nonlinear parameters as scalars or (V, 1) arrays.
        theta: linear parameters (P, V).
        servos: goals and other inputs of the servos.
        every: steps between returned positions.

    Returns:
        Encoder positions at the start and after each `every` steps (N / every + 1, V, B) [rad].
    """
    h, shape = servos.step, (theta.shape[1], len(servos.drives))
    weights = _compute_taps(terms, servos, shape)
    speed = servos.drives[0].acts_on_speed
    if any(drive.acts_on_speed != speed for drive in servos.drives):
        raise ValueError("servos under position and under velocity control cannot be simulated at once")
    if any((drive.encoder == "output") != servos.at_output for drive in servos.drives):
        raise ValueError("servos with encoders at the motor and at the output cannot be simulated at once")
    loaded, integrates = bool(servos.load), any(drive.ki for drive in servos.drives)
    gains = np.array([compute_gains(drive, servos.step) for drive in servos.drives]).T
    names: tuple[str, ...] = GAINS
    if servos.encoder_step is not None:
        is_sampled = [float(drive.rate is not None) for drive in servos.drives]
        encoder = np.full(len(servos.drives), servos.encoder_step), servos.position, is_sampled
        names, gains = (*GAINS, *COUNTS), np.vstack([gains, *encoder])
    count = servos.inputs.shape[1]
    options = speed, len(weights), loaded, integrates, h, servos.at_output, count, names
    program = servos.programs.find(_compile_step, terms, *options)
    nonlinear = [value for term in terms for value in term.free_values]
    theta = theta[:, :, None]
    constants = [*theta, *nonlinear, *gains[:, None], *(servos.load[:2] if loaded else ()), *weights, h]
    parameters = np.array([np.broadcast_to(value, shape) for value in constants])
    q, v, t = (np.broadcast_to(part, shape) for part in (servos.position, servos.velocity, servos.start))
    x = Samples(t, q, v, np.zeros(shape), load=servos.load._replace(torque=servos.inputs[0, -1]))
    balance = TorqueBalance(terms, theta, loaded)
    x = move_to_motor(replace(x, memory=balance.start(x)), terms, servos.at_output)
    seen_first = v if servos.encoder_step is None else q
    state = ControllerState(np.zeros(shape), (np.zeros(shape),) * (len(weights) - 1), np.zeros(shape), v, seen_first)
    rows, seen = _flatten_state(x, state, integrates), read_encoder(x, terms, servos.at_output).position
    shown = next(k for k, row in enumerate(rows) if row is seen)
    states = np.array([np.broadcast_to(row, shape) for row in rows])
    if program is not None:
        return np.asarray(program(servos.wrap_inputs(program), parameters, states, every, kept=[shown])[:, 0])

    def simulate_step(given: Array, now: Array) -> list[Any]:  # for a user's law that is not symbolic
        held, *late = now[len(stack_rows(x)) :]
        before, (seen, last, *integral) = late[: len(weights) - 1], late[len(weights) - 1 :]
        then = ControllerState(held, tuple(before), integral[0] if integrates else 0.0, seen, last)
        begin = unstack_rows(now, x)
        named = dict(zip(names, gains, strict=True))
        after = step_servo(balance, begin, then, ServoInputs(*given), named, [*weights], speed, h, servos.at_output)
        return _flatten_state(*after, integrates)

    return repeat(simulate_step, servos.inputs, states, every)[:, shown]


def compute_gains(drive: ServoDrive, step: float) -> tuple[float, ...]:
    """Return the numbers of a controller in the order of `GAINS`.

    `most` is the largest output, `seen` the filter's weight of a new speed, `turn` the period [s], `first` the time by
    which the error is integrated before the output is computed [s], `halt` the output above which the integral stops,
    and `room` the largest integral.
    """
    period = step if drive.rate is None else 1.0 / drive.rate
    turn = max(step, period)
    share = 1.0 if drive.cutoff is None else 1.0 - math.exp(-2 * math.pi * drive.cutoff * period)
    seen = turn / (turn + period * (1.0 - share) / share)  # the same lag with several periods per step
    first = period if drive.integral == "before" and drive.rate is not None else 0.0
    halt = math.inf if drive.windup in ("clamp", "free") else drive.max_output
    room = drive.max_output / drive.ki if drive.windup == "clamp" and drive.ki else math.inf
    return drive.kp, drive.ki, drive.kd, drive.max_output, seen, turn, first, halt, room


def _flatten_state(x: Samples, state: ControllerState, integrates: bool) -> list[Any]:
    """Flatten samples and controller state to rows."""
    integral = [state.integral] if integrates else []
    return [*stack_rows(x), state.held, *state.before, state.speed, state.velocity, *integral]


def _compute_taps(terms: Sequence[Term], servos: Servos, shape: tuple[int, int]) -> Array:
    """Compute the weights (T, V, B) of the outputs of the last T steps, from the delays of terms and drives."""
    late = sum((np.asarray(term.delay, dtype=float) for term in terms), np.zeros(1)).reshape(-1, 1)
    steps = (late + np.array([drive.delay for drive in servos.drives])) / servos.step
    return compute_taps(np.broadcast_to(steps, shape))


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
    given: ServoInputs,
    gains: Mapping[str, Any],
    taps: Sequence[Any],
    speed: bool,
    h: ArrayLike,
    at_output: bool,
) -> tuple[Samples, ControllerState]:
    """Advance servos and controllers by one step of h [s], in symbols or arrays."""
    torque, state = compute_control(read_encoder(x, balance.terms, at_output), state, given, gains, taps, speed)
    measured = {BackEmf.id: (given.on,), TemperatureDependentFriction.id: (given.temperature, 0.0)}
    memory: Any = {id: measured.get(id, memory) for id, memory in x.memory.items()}
    load = x.load._replace(torque=given.load_torque)
    after = step(balance, replace(x, torque=torque, memory=memory, load=load), h)
    return after, state


def compute_control(
    x: Samples, state: ControllerState, given: ServoInputs, gains: Mapping[str, Any], taps: Sequence[Any], speed: bool
) -> tuple[Any, ControllerState]:
    """Return the commanded torque over a step and the controller's state, in symbols or arrays."""
    looks = given.due > 0
    position = x.position + given.lead * x.velocity if may_be_true(given.lead != 0.0) else x.position
    seen_now = x.velocity
    if "encoder_step" in gains:
        counts = np.rint((position - gains["origin"]) / gains["encoder_step"])
        seen_now = position = gains["origin"] + gains["encoder_step"] * counts
        measured = np.where(gains["is_sampled"] > 0, (position - state.velocity) / gains["turn"], x.velocity)
    else:
        measured = x.velocity - given.old * (x.velocity - state.velocity)
    measured = measured - given.goal_speed if may_be_true(given.goal_speed != 0.0) else measured
    seen = np.where(looks, state.speed + gains["seen"] * (measured - state.speed), state.speed)
    error = given.goal - (seen if speed else position)
    output, grown = compute_output(error, 0.0 if speed else gains["kd"] * seen, state.integral, gains)
    integral = np.where(looks, grown, state.integral)
    integral = np.where(given.on > 0, integral, 0.0)  # reset without power
    held = np.where(looks, output * given.scale, state.held)
    acting = state.held + given.share * (held - state.held) if may_be_true(given.share != 1.0) else held
    line = (acting, *state.before)
    torque: Any = given.on * sum(weight * past for weight, past in zip(taps, line, strict=True))
    last = np.where(looks, seen_now, state.velocity)
    return torque, ControllerState(held, line[: len(state.before)], integral, seen, last)


def compute_output(error: Any, damping: Any, integral: Any, gains: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return the output of a controller at a look and the integral after it, in symbols, arrays or numbers."""
    summed = np.maximum(np.minimum(integral + gains["first"] * error, gains["room"]), -gains["room"])
    wanted = gains["kp"] * error + gains["ki"] * summed - damping
    output = np.maximum(np.minimum(wanted, gains["most"]), -gains["most"])
    winds = (np.abs(wanted) > gains["halt"]) & (wanted * error > 0)
    grown = integral + np.where(winds, 0.0, gains["turn"] * error)
    return output, np.maximum(np.minimum(grown, gains["room"]), -gains["room"])


def _compile_step(
    terms: Sequence[Term],
    speed: bool,
    taps: int,
    loaded: bool,
    integrates: bool,
    longest: float,
    at_output: bool,
    count: int,
    names: tuple[str, ...],
) -> Recurrence | None:
    """Compile a step of servos; return None if a law is not symbolic."""
    from pendulum_env.physics.compiled import compile_recurrence  # slow import

    h: Any = make_symbol("h", most=round_up(longest))
    given = ServoInputs(*(make_symbol(text) for text in ServoInputs._fields[:count]))
    gains: dict[str, Any] = {text: make_symbol(text) for text in names}
    weights = [make_symbol(f"tap_{k}") for k in range(taps)]
    before = tuple(make_symbol(f"before_{k}") for k in range(taps - 1))
    integral: Any = make_symbol("integral") if integrates else 0.0
    state = ControllerState(make_symbol("held"), before, integral, make_symbol("speed"), make_symbol("velocity_seen"))
    try:
        balance, x, nonlinear = write_balance(terms, loaded)
        used = gains if integrates else gains | {"ki": 0.0}
        after, later = step_servo(balance, x, state, given, used, weights, speed, h, at_output)
        shared = [*gains.values(), *(x.load[:2] if loaded else ()), *weights, h]
        constants: Any = [*balance.theta, *nonlinear, *shared]
        rows = (_flatten_state(x, state, integrates), _flatten_state(after, later, integrates))
        return compile_recurrence(given[:count], constants, *rows)
    except Exception:  # a user's law may raise any error with symbols
        return None
