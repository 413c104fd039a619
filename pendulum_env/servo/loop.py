"""Servos simulated with their controller in the loop: from the goal alone, whole recordings at once.

A closed loop does not run away, so that nothing has to start anew from what was measured. In each step of the
integrator the controller looks at the simulated motion, and what it asks for is held until it looks again.
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
from pendulum_env.physics.simulation import (
    PreparedStep,
    StepPrograms,
    TorqueBalance,
    stack_rows,
    step,
    unstack_rows,
    write_balance,
)
from pendulum_env.physics.symbols import make_symbol, may_be_true, repeat
from pendulum_env.physics.term import ROOM, round_up
from pendulum_env.physics.terms import move_to_motor, read_encoder
from pendulum_env.servo.drive import ServoDrive

if TYPE_CHECKING:
    from pendulum_env.physics.compiled import Recurrence

GAINS = ("kp", "ki", "kd", "most", "seen", "turn", "first", "halt", "room")  # of each servo


@dataclass(frozen=True)
class Looks:
    """Times at which a controller looks at goal and motion, within N steps of an integrator.

    A step is longer or shorter than the period of the controller, and does not begin with it. What the controller asks
    for at a look acts from that look to the next one. The looks within a step count by these times.

    Attributes:
        rate: of the controller [Hz].
        step: of the integrator [s].
        count: number of steps N.
    """

    rate: float
    step: float
    count: int

    @cached_property
    def time(self) -> Array:
        """Times of the looks (K,) [s]."""
        return np.arange(math.ceil(self.count * self.step * self.rate - 1e-6)) / self.rate

    @cached_property
    def _step_of(self) -> Index:
        return np.floor(self.time / self.step + 1e-6).astype(np.intp)

    @cached_property
    def _duration(self) -> Array:
        """Time from each look to the next one or to the end of its step (K,) [s]."""
        return np.minimum(self.time + 1.0 / self.rate, (self._step_of + 1) * self.step) - self.time

    @cached_property
    def due(self) -> Array:
        """1 for steps with a look, 0 for others (N,)."""
        return (self.share > 0).astype(float)

    @cached_property
    def share(self) -> Array:
        """Share of each step that comes after its first look (N,)."""
        return np.bincount(self._step_of, self._duration, self.count) / self.step

    @cached_property
    def lead(self) -> Array:
        """Mean time of the looks from the begin of their step (N,) [s]."""
        return self.average(np.maximum(self.time - self._step_of * self.step, 0.0))

    @cached_property
    def old(self) -> Array:
        """Share of the last velocity in the measured one (N,).

        Velocities are those at the begin of a step; the speed between two positions is that of half a period ago.
        """
        steps = np.flatnonzero(self.due)
        elapsed = np.full(self.count, max(self.step, 1.0 / self.rate))
        elapsed[steps[1:]] = np.diff(steps) * self.step
        return (0.5 / self.rate - self.lead) / elapsed

    def average(self, values: Array) -> Array:
        """Return means over the looks of each step of values at the looks (K,); 0 for a step without a look (N,)."""
        weighted = np.bincount(self._step_of, self._duration * values, self.count)
        return np.asarray(weighted / np.maximum(self.share * self.step, 1e-300))


@dataclass(frozen=True)
class Servos:
    """B servos that follow goals, over N steps of the integrator.

    Attributes:
        drives: of each.
        step: of the integrator [s].
        goal: of each step, as the controller sees it (N, B) [rad, or rad/s].
        supply: voltage of the bus over each step (N, B) [V]; a duty is a share of it.
        on: whether the motor is powered (N, B).
        position, velocity: at the start (B,) [rad, rad/s].
        start: time of the first sample (B,) [s].
        load: what is known to hang on each (B,); its torque, over each step (N, B).
        temperature: of each over each step (N, B) [deg C]; None if it was not measured.
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

    @property
    def at_output(self) -> bool:
        """Return whether the encoders are at the output, behind the gear."""
        return self.drives[0].encoder == "output"

    @cached_property
    def programs(self) -> StepPrograms:
        """Compiled steps of models that simulate the servos."""
        return StepPrograms()

    @property
    def has_derivative(self) -> bool:
        """Return whether a controller acts on the derivative of its error."""
        return any(drive.kd > 0 and drive.derivative == "error" for drive in self.drives)

    @property
    def is_sampled(self) -> bool:
        """Return whether a controller looks at certain times only."""
        return any(drive.rate is not None for drive in self.drives)

    @cached_property
    def looks(self) -> list[Looks]:
        """Looks of each controller; one that acts all the time looks at the begin of each step."""
        return [Looks(drive.rate or 1.0 / self.step, self.step, len(self.goal)) for drive in self.drives]

    @cached_property
    def inputs(self) -> Array:
        """Inputs of each step, in the order of `ServoInputs` (N, C, B).

        C is 6 without controllers that look, 10 with one that acts on the derivative of its error, else 9.
        """
        scale = np.column_stack([drive.scale(supply) for drive, supply in zip(self.drives, self.supply.T, strict=True)])
        warm = np.full_like(self.goal, ROOM) if self.temperature is None else self.temperature
        outside = np.broadcast_to(self.load.torque, self.goal.shape)
        times = [np.ones_like(self.goal)]
        if self.is_sampled or self.has_derivative:
            acts = [drive.rate is None for drive in self.drives]  # all the time
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
        """Return the inputs as a compiled step reads them, memoised by its width."""
        if step.width not in self._wrapped_inputs:
            self._wrapped_inputs[step.width] = step.wrap_inputs(self.inputs)
        return self._wrapped_inputs[step.width]


class ControllerState(NamedTuple):
    """State of a controller: held and past outputs, integral, and measured speed.

    `velocity` is the true one at its last look: where the joint speeds up evenly, two positions tell the mean of both.
    """

    held: Any
    before: tuple[Any, ...]
    integral: Any
    speed: Any
    velocity: Any


class ServoInputs(NamedTuple):
    """Inputs of a servo over a step: goal, scale of its output, on or off, due to update, temperature, load.

    A controller that is due acts over the last `share` of the step. It reads the position `lead` [s] after the begin,
    and a share `old` of its speed is that of the last look. `goal_speed` is 0 unless it acts on the derivative of the
    error.
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
    """Simulate B servos from their goals under V models.

    Args:
        terms: of the models, whose nonlinear parameters are numbers, or (V, 1) arrays of those of each.
        theta: linear parameters (P, V).
        servos: with their goals.
        every: steps between positions that are returned.

    Returns:
        Positions at the encoders at the start and after every so many steps (N / every + 1, V, B) [rad].
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
    count = servos.inputs.shape[1]
    options = speed, len(weights), loaded, integrates, h, servos.at_output, count
    program = servos.programs.find(terms, _compile_step, *options)
    theta = theta[:, :, None]
    constants = [*theta, *program.nonlinear, *gains[:, None], *(servos.load[:2] if loaded else ()), *weights, h]
    parameters = np.array([np.broadcast_to(value, shape) for value in constants])
    q, v, t = (np.broadcast_to(part, shape) for part in (servos.position, servos.velocity, servos.start))
    x = Samples(t, q, v, np.zeros(shape), load=servos.load._replace(torque=servos.inputs[0, -1]))
    balance = TorqueBalance(terms, theta, loaded)
    x = move_to_motor(replace(x, memory=balance.start(x)), terms, servos.at_output)
    state = ControllerState(np.zeros(shape), (np.zeros(shape),) * (len(weights) - 1), np.zeros(shape), v, v)
    rows, seen = _flatten_state(x, state, integrates), read_encoder(x, terms, servos.at_output).position
    shown = next(k for k, row in enumerate(rows) if row is seen)
    states = np.array([np.broadcast_to(row, shape) for row in rows])
    if program.step is not None:
        return np.asarray(program.step(servos.wrap_inputs(program.step), parameters, states, every, kept=[shown])[:, 0])

    def simulate_step(given: Array, now: Array) -> list[Any]:  # a law of a user's is no formula
        held, *late = now[len(stack_rows(x)) :]
        before, (seen, last, *integral) = late[: len(weights) - 1], late[len(weights) - 1 :]
        then = ControllerState(held, tuple(before), integral[0] if integrates else 0.0, seen, last)
        begin = unstack_rows(now, x)
        named = dict(zip(GAINS, gains, strict=True))
        after = step_servo(balance, begin, then, ServoInputs(*given), named, [*weights], speed, h, servos.at_output)
        return _flatten_state(*after, integrates)

    return repeat(simulate_step, servos.inputs, states, every)[:, shown]


def compute_gains(drive: ServoDrive, step: float) -> tuple[float, ...]:
    """Return gains of a servo, its limit, the filter's share of a new speed, its period [s], and how it integrates.

    The last three are the time by which the error is added before the output [s], the output beyond which the integral
    does not grow, and the largest integral.
    """
    period = step if drive.rate is None else 1.0 / drive.rate
    turn = max(step, period)
    share = 1.0 if drive.cutoff is None else 1.0 - math.exp(-2 * math.pi * drive.cutoff * period)
    seen = turn / (turn + period * (1.0 - share) / share)  # as late, also if a step holds several periods
    first = period if drive.integral == "before" and drive.rate is not None else 0.0
    halt = math.inf if drive.windup in ("clamp", "free") else drive.max_output
    room = drive.max_output / drive.ki if drive.windup == "clamp" and drive.ki else math.inf
    return drive.kp, drive.ki, drive.kd, drive.max_output, seen, turn, first, halt, room


def _flatten_state(x: Samples, state: ControllerState, integrates: bool) -> list[Any]:
    """Flatten all that changes from step to step."""
    return [
        *stack_rows(x),
        state.held,
        *state.before,
        state.speed,
        state.velocity,
        *([state.integral] if integrates else []),
    ]


def _compute_taps(terms: Sequence[Term], servos: Servos, shape: tuple[int, int]) -> Array:
    """Compute the weights (T, V, B) of the outputs of the last T steps."""
    late = sum((np.asarray(term.delay, dtype=float) for term in terms), np.zeros(1)).reshape(-1, 1)
    steps = (late + np.array([drive.delay for drive in servos.drives])) / servos.step
    return compute_taps(np.broadcast_to(steps, shape))


def compute_taps(steps: Array) -> Array:
    """Compute the weights (T, ...) of the outputs of the last T steps, the newest first, by linear interpolation."""
    whole = np.floor(steps + 1e-9)
    share = np.maximum(steps - whole, 0.0)
    count = 2 ** math.ceil(math.log2(int(whole.max()) + 1 + bool(share.any())))  # few programs for many delays
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
    """Advance servos and their controllers by one step, in symbols or arrays."""
    torque, state = compute_control(read_encoder(x, balance.terms, at_output), state, given, gains, taps, speed)
    measured = {BackEmf.id: (given.on,), TemperatureDependentFriction.id: (given.temperature, 0.0)}
    memory: Any = {id: measured.get(id, memory) for id, memory in x.memory.items()}
    load = x.load._replace(torque=given.load_torque)
    after = step(balance, replace(x, torque=torque, memory=memory, load=load), h)
    return after, state


def compute_control(
    x: Samples, state: ControllerState, given: ServoInputs, gains: Mapping[str, Any], taps: Sequence[Any], speed: bool
) -> tuple[Any, ControllerState]:
    """Return the torque that a motor is asked for over a step, and the controller's state; symbols or arrays."""
    looks = given.due > 0
    measured = x.velocity - given.old * (x.velocity - state.velocity)
    measured = measured - given.goal_speed if may_be_true(given.goal_speed != 0.0) else measured
    seen = np.where(looks, state.speed + gains["seen"] * (measured - state.speed), state.speed)
    position = x.position + given.lead * x.velocity if may_be_true(given.lead != 0.0) else x.position
    error = given.goal - (seen if speed else position)
    output, grown = compute_output(error, 0.0 if speed else gains["kd"] * seen, state.integral, gains)
    integral = np.where(looks, grown, state.integral)
    integral = np.where(given.on > 0, integral, 0.0)  # begins anew with power
    held = np.where(looks, output * given.scale, state.held)
    acting = state.held + given.share * (held - state.held) if may_be_true(given.share != 1.0) else held
    line = (acting, *state.before)
    torque: Any = given.on * sum(weight * past for weight, past in zip(taps, line, strict=True))
    return torque, ControllerState(
        held, line[: len(state.before)], integral, seen, np.where(looks, x.velocity, state.velocity)
    )


def compute_output(error: Any, damping: Any, integral: Any, gains: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return the output of a controller at a look, and its integral after it; symbols, arrays or numbers."""
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
) -> PreparedStep:
    """Compile a step of servos."""
    from pendulum_env.physics.compiled import compile_recurrence  # here, as it takes long to load

    h: Any = make_symbol("h", most=round_up(longest))
    given = ServoInputs(*(make_symbol(text) for text in ServoInputs._fields[:count]))
    gains: dict[str, Any] = {text: make_symbol(text) for text in GAINS}
    weights = [make_symbol(f"tap_{k}") for k in range(taps)]
    before = tuple(make_symbol(f"before_{k}") for k in range(taps - 1))
    integral: Any = make_symbol("integral") if integrates else 0.0
    state = ControllerState(make_symbol("held"), before, integral, make_symbol("speed"), make_symbol("velocity_seen"))
    try:
        balance, x, nonlinear = write_balance(terms, loaded)
        used = gains if integrates else gains | {"ki": 0.0}
        after, later = step_servo(balance, x, state, given, used, weights, speed, h, at_output)
        shared = [*gains.values(), *(x.load[:2] if loaded else ()), *weights, h]
        constants: Any = [*balance.theta, *map(make_symbol, nonlinear), *shared]
        inputs, known, states = (
            [one.label for one in each] for each in (given[:count], constants, _flatten_state(x, state, integrates))
        )
        return PreparedStep(
            compile_recurrence(inputs, known, states, _flatten_state(after, later, integrates)),
            list(nonlinear.values()),
        )
    except Exception:  # a user's law may do anything that NumPy does
        return PreparedStep(None, [])
