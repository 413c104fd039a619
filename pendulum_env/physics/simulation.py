"""Simulate batches of pendulums with set-valued dry friction.

A step is the explicit midpoint rule with a constant direction of friction, as long as the joint keeps its direction. If
the velocity reaches zero within a step, the step is split there: the joint sticks if dry friction can balance the net
torque, and otherwise moves in the direction of the net torque for the remaining time. The scheme is of second order
with exact stick. The implicit step of Moreau (v = 0 if |v*| <= h fc / I, else v* - h fc sgn v* / I) is of first order.
Source of the set-valued law: Acary and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pendulum_env._typing import Array, ArrayLike, Mask
from pendulum_env.physics.symbols import Symbol, find_longest, make_symbol, may_be_true, repeat_step, set_label
from pendulum_env.physics.term import (
    LOAD,
    UNLOADED,
    KnownLoad,
    Law,
    Memory,
    Samples,
    Term,
    return_one,
    return_zero,
    round_up,
    write_symbols,
)

if TYPE_CHECKING:
    from pendulum_env.physics.compiled import Recurrence

LONGEST_STEP = 1e-3  # [s], longest integration step; longer periods have substeps
LEAST_INERTIA = 1e-9  # [kg m^2], least moment of inertia in a simulation
UNBOUNDED = 1e6  # [rad, rad/s], bound of the state of a diverged simulation, which avoids NaN


class Trajectory(NamedTuple):
    """Simulated motion at the start of each period and at the end of the last one."""

    position: Array  # (N + 1, B) [rad]
    velocity: Array  # (N + 1, B) [rad/s]


class TorqueBalance:
    """Torque balance of a batch of pendulums: weighted masses, forces and dry friction of all columns."""

    def __init__(self, terms: Sequence[Term], theta: Array, has_load: bool = False) -> None:
        """Set the terms and the linear parameters theta, (P,) or (P, B), in the order of the columns.

        `has_load` includes the known load of the samples.
        """
        self.terms, self.theta, self.has_load = tuple(terms), theta, has_load
        self._terms_with_states = [term for term in terms if term.has_memory]
        weighted = list(zip([column for term in terms for column in term.columns], theta, strict=True))
        weighted += [(column, np.float64(1.0)) for term in terms for column in term.fixed]
        weighted += [(LOAD, np.float64(1.0))] if has_load else []
        self._mass, self._force, self._dry = (
            [(c, law) for column, c in weighted if (law := getattr(column, part)) is not return_zero]
            for part in ("mass", "force", "dry")
        )
        mass = _sum_constant(self._mass)  # constant for most models
        self._steady_mass = None if mass is None else np.maximum(mass, LEAST_INERTIA)
        self._steady_dry = _sum_constant(self._dry)

    def __reduce__(self) -> tuple[type[TorqueBalance], tuple[Sequence[Term], Array, bool]]:
        return TorqueBalance, (self.terms, self.theta, self.has_load)  # functions of columns cannot be pickled

    @property
    def has_states(self) -> bool:
        """Return whether a term has states."""
        return bool(self._terms_with_states)

    def start(self, x: Samples) -> dict[str, Memory]:
        """Return the steady states of all terms for the samples x."""
        return {term.id: term.start(x) for term in self._terms_with_states}

    def advance(self, x: Samples, velocity: Array, duration: ArrayLike) -> Mapping[str, Memory]:
        """Return the states of all terms after `duration` [s] of motion from x at a constant velocity (B,)."""
        if not self._terms_with_states:
            return x.memory
        x = replace(x, velocity=velocity)
        return {term.id: term.advance(x.memory[term.id], x, duration) for term in self._terms_with_states}

    @staticmethod
    def _sum(parts: list[tuple[ArrayLike, Law]], x: Samples) -> ArrayLike:
        total: ArrayLike = 0.0
        for coefficient, law in parts:
            total = total + coefficient * law(x)
        return total

    def net(self, x: Samples) -> ArrayLike:
        """Return the torque minus all forces except dry friction [N m]."""
        return x.torque - self._sum(self._force, x)

    def mass(self, x: Samples) -> ArrayLike:
        """Return the moment of inertia [kg m^2], at least `LEAST_INERTIA`."""
        return np.maximum(self._sum(self._mass, x), LEAST_INERTIA) if self._steady_mass is None else self._steady_mass

    def dry(self, x: Samples) -> ArrayLike:
        """Return the magnitude of dry friction [N m]; it may be negative in a bad fit."""
        return self._sum(self._dry, x) if self._steady_dry is None else self._steady_dry

    def evaluate_at(self, x: Samples, stage: str) -> tuple[Any, Any]:
        """Return `net` and `dry` at a stage of a step, and label symbols with it."""
        set_label(x.position, f"position_at_{stage}")
        set_label(x.velocity, f"velocity_at_{stage}")
        return set_label(self.net(x), f"net_at_{stage}"), set_label(self.dry(x), f"dry_at_{stage}")


def make_start_samples(balance: TorqueBalance, position: ArrayLike, velocity: ArrayLike) -> Samples:
    """Return the samples at the start of a run, scalars or (B,), with steady states of all terms."""
    rest: Any = np.zeros(np.shape(position))[()]
    x = Samples(rest, np.float64(position), np.float64(velocity), rest)  # type: ignore[arg-type]
    return replace(x, memory=balance.start(x))


def _sum_constant(parts: list[tuple[ArrayLike, Law]]) -> ArrayLike | None:
    """Return the sum of the coefficients if all laws are constant, else None."""
    return sum(c for c, _ in parts) if all(law is return_one for _, law in parts) else None


def _oppose_motion(net: ArrayLike, dry: ArrayLike, direction: Array) -> ArrayLike:
    """Return the torque after dry friction [N m], which opposes the motion or holds a joint at rest."""
    sliding = net - dry * direction
    if not may_be_true(direction == 0):
        return sliding
    at_rest = np.sign(net) * np.maximum(np.abs(net) - np.maximum(dry, 0.0), 0.0)
    return np.where(direction == 0, at_rest, sliding)


def count_substeps(period: ArrayLike, longest_step: float = LONGEST_STEP) -> int:
    """Return the number of integration steps per period [s]."""
    return max(1, int(np.ceil(find_longest(period) / longest_step - 1e-9)))


def move_half_way(balance: TorqueBalance, x: Samples, duration: ArrayLike) -> tuple[Array, Samples]:
    """Return the direction of motion over a step of `duration` [s], and the samples at its middle.

    For a joint at rest, this is the direction of the net torque, or 0 if friction holds the joint.
    """
    v, h = x.velocity, duration
    direction = np.sign(v)
    start = _oppose_motion(*balance.evaluate_at(x, "start"), direction)
    if may_be_true(direction == 0):
        direction = np.where(direction == 0, np.sign(start), direction)
    inertia = set_label(balance.mass(x), "inertia_at_start")
    middle_v = v + 0.5 * h * start / inertia
    middle_v = np.where(middle_v * direction < 0, 0.0, middle_v)
    memory = balance.advance(x, 0.5 * (v + middle_v), 0.5 * h)
    return direction, Samples(x.time + 0.5 * h, x.position + 0.5 * h * v, middle_v, x.torque, memory, x.load)


def step(balance: TorqueBalance, x: Samples, duration: ArrayLike) -> Samples:
    """Advance time, position, velocity and states, each (B,), by `duration` [s] under a constant torque.

    Compiled simulations and exports call this function with symbols in place of arrays. Therefore it uses only
    operators and functions of `symbols`, and guards branches by `may_be_true`.
    """
    q, v, h = x.position, x.velocity, duration
    direction, middle = move_half_way(balance, x, h)
    inertia = set_label(balance.mass(middle), "inertia_at_middle")
    net, dry = balance.evaluate_at(middle, "middle")
    a = (net - dry * direction) / inertia
    if may_be_true(direction == 0):
        a = np.where(direction == 0, 0.0, a)
    new_q, new_v = q + h * (v + 0.5 * h * a), v + h * a

    is_stopped = new_v * direction < 0
    if may_be_true(is_stopped):
        # v + a t = 0 within the step: stop, then stick or move for the remaining time
        elapsed = np.where(is_stopped, np.clip(-v / np.where(is_stopped, a, 1.0), 0.0, h), h)
        stop_q = q + v * elapsed + 0.5 * a * elapsed**2
        at_rest = np.zeros_like(new_v)
        rest = Samples(x.time + elapsed, stop_q, at_rest, x.torque, middle.memory, x.load)
        restart = _oppose_motion(*balance.evaluate_at(rest, "rest"), at_rest) / inertia
        remaining = h - elapsed
        new_q = np.where(is_stopped, stop_q + 0.5 * restart * remaining**2, new_q)
        new_v = np.where(is_stopped, restart * remaining, new_v)
    memory = balance.advance(middle, 0.5 * (middle.velocity + new_v), 0.5 * h)
    return Samples(x.time + h, clip_state(new_q), clip_state(new_v), x.torque, memory, x.load)


def clip_state(values: Array) -> Array:
    """Clip values to +-`UNBOUNDED`, and replace NaN."""
    return np.fmin(np.fmax(values, -UNBOUNDED), UNBOUNDED)


def delay_torque(torque: Array, previous: Array, periods: float) -> Array:
    """Delay a held command (N, B) by a number of periods; `previous` (M, B) are previous commands, oldest first."""
    whole = int(np.floor(periods))
    share = periods - whole
    n_missing = max(0, whole + 1 - len(previous))
    oldest = previous[:1] if len(previous) else np.zeros_like(torque[:1])
    line = np.concatenate([np.repeat(oldest, n_missing, axis=0), previous, torque])
    first = len(line) - len(torque) - whole
    return (1 - share) * line[first : first + len(torque)] + share * line[first - 1 : first - 1 + len(torque)]


class CommandDelay:
    """Delay line of the torque command, by the delays of the terms."""

    def __init__(self, terms: Sequence[Term], period: float, substeps: int) -> None:
        """Make a delay line without previous commands; `period` is in seconds."""
        self._substeps, self._h = substeps, period / substeps
        self._past: Array | None = None  # commands of the last substeps, oldest first
        self.set_delay(terms)

    def set_delay(self, terms: Sequence[Term]) -> None:
        """Set the delay of other terms, and keep previous commands."""
        self._periods = sum(term.delay for term in terms) / self._h  # delay in substeps

    def delay_command(self, torque: ArrayLike) -> Iterable[Any]:
        """Return the delayed torque of each substep of a period with the command `torque`, () or (B,)."""
        if self._periods == 0:
            return itertools.repeat(torque, self._substeps)
        commands = np.repeat(np.asarray(torque, dtype=float)[None], self._substeps, axis=0)
        previous = np.zeros_like(commands[:1]) if self._past is None else self._past
        self._past = np.concatenate([previous, commands])[-int(self._periods) - 1 :]
        return iter(delay_torque(commands, previous, self._periods))

    def clear(self, is_cleared: Mask) -> None:
        """Clear the previous commands of the pendulums in the mask `is_cleared` (B,)."""
        self._past = None if self._past is None else np.where(is_cleared, 0.0, self._past)


def simulate(
    terms: Sequence[Term],
    theta: Array,
    period: ArrayLike,
    torque: Array,
    position: ArrayLike,
    velocity: ArrayLike,
    start: ArrayLike = 0.0,
    *,
    before: Array | None = None,
    memory: Mapping[str, Memory] | None = None,
    longest_step: float = LONGEST_STEP,
    load: KnownLoad = UNLOADED,
    observe: Callable[[Samples], None] | None = None,
    compiler: Callable[..., Recurrence | None] | None = None,
) -> Trajectory:
    """Simulate B pendulums under a torque command that is held over each period.

    Args:
        terms: terms of the model, with P linear parameters in total.
        theta: linear parameters, (P,) for all pendulums or (P, B).
        period: time between commands [s], scalar or, without delays, (B,).
        torque: command [N m], (N,) for all pendulums or (N, B). Fewer columns, B / V for V models, are repeated.
        position: initial position, scalar or (B,) [rad].
        velocity: initial velocity, scalar or (B,) [rad/s].
        start: time of the first command, scalar or (B,) [s].
        before: previous commands, (M,) or (M, B), for terms that delay the torque; default zero.
        memory: initial states by id of the term; by default the steady states.
        longest_step: longest integration step [s].
        load: known load, with inertia and gravity () or (B,), and torque () or its mean over each period (N, B).
        observe: function called after the run with the samples at the start of each period and at the end.
        compiler: function with the arguments and the result of `compile_step`, the default.
    """
    torque = np.asarray(torque, dtype=float)
    torque = torque[:, None] if torque.ndim == 1 else torque
    scalars = (np.shape(x) for x in (position, velocity, start, period, load.inertia, load.gravity))
    batch = np.broadcast_shapes(*scalars, np.shape(theta)[1:], (1,))
    columns = np.broadcast_shapes(torque.shape[1:], np.shape(load.torque)[1:])
    if batch[0] % columns[0]:
        batch = columns = np.broadcast_shapes(batch, columns)
    balance = TorqueBalance(terms, np.asarray(theta, dtype=float), bool(load))
    count = count_substeps(period, longest_step)
    h = period / count
    commands, input_interval = _spread_commands(terms, torque, before, count, h)
    inputs = np.broadcast_to(commands, (len(commands), *columns))[:, None]
    if balance.has_load:
        outside = np.repeat(np.broadcast_to(load.torque, (len(torque), *columns)), count // input_interval, axis=0)
        inputs = np.stack([inputs[:, 0], outside], axis=1)
    repeats = batch[-1] // columns[-1]
    q, v, t = (np.broadcast_to(np.asarray(a, dtype=float), batch) for a in (position, velocity, start))
    first_inputs = np.tile(inputs[0], repeats) if len(inputs) else np.zeros((inputs.shape[1], 1))
    x = _apply_command(Samples(t, q, v, np.zeros(1), load=load), first_inputs)
    x = replace(x, memory={id: (memory or {}).get(id, state) for id, state in balance.start(x).items()})
    states = np.array([np.broadcast_to(row, batch) for row in stack_rows(x)])
    program = (compiler or compile_step)(terms, balance.has_load, round_up(h))
    output_states = range(1, 3) if observe is None else range(len(states))
    if program is not None:
        nonlinear = [value for term in terms for value in term.free_values]
        constants = [*balance.theta, *nonlinear, *(load[:2] if balance.has_load else ()), h]
        parameters = np.array([np.broadcast_to(value, batch) for value in constants])
        shape = -1, repeats, *columns
        path = program(inputs, parameters.reshape(shape), states.reshape(shape), count, input_interval, output_states)
        path = path.reshape(len(path), len(output_states), *batch)
    else:

        def take_step(input_row: Array, current: Array) -> Sequence[ArrayLike]:
            return stack_rows(step(balance, _apply_command(unstack_rows(current, x), np.tile(input_row, repeats)), h))

        path = repeat_step(take_step, np.repeat(inputs, input_interval, axis=0), states, count)[:, output_states]
    if observe is not None:
        for k, state in enumerate(path):
            current = unstack_rows(state, x)
            row_index = max(0, k * count - 1) // input_interval
            observe(_apply_command(current, np.tile(inputs[row_index], repeats)) if len(inputs) else current)
    first = output_states.index(1)
    return Trajectory(path[:, first], path[:, first + 1])


def _apply_command(x: Samples, inputs: Array) -> Samples:
    """Return the samples with the command and, if given, the load torque of a step, (1 or 2, B)."""
    command, *load_torque = inputs
    return replace(x, torque=command, load=x.load._replace(torque=load_torque[0]) if load_torque else x.load)


def _spread_commands(
    terms: Sequence[Term], torque: Array, before: Array | None, count: int, h: ArrayLike
) -> tuple[Array, int]:
    """Return the torque with the delay of the terms, and the number of steps of h [s] per torque."""
    delay = sum(term.delay for term in terms)
    if delay <= 0:
        return torque, count
    commands = np.repeat(torque, count, axis=0)
    previous = np.zeros((0, *torque.shape[1:])) if before is None else np.asarray(before, dtype=float)
    previous = previous[:, None] if previous.ndim == 1 else previous
    return delay_torque(commands, np.repeat(previous, count, axis=0), float(delay / h)), 1


def stack_rows(x: Samples) -> list[Any]:
    """Return the rows of a step's state: time, position, velocity and the states of terms."""
    return [x.time, x.position, x.velocity, *(row for memory in x.memory.values() for row in memory)]


def unstack_rows(state: Iterable[Array], like: Samples) -> Samples:
    """Return the samples of the rows of `stack_rows`, with torque and load of the samples `like`."""
    row = iter(state)
    t, q, v = next(row), next(row), next(row)
    memory = {id: tuple(next(row) for _ in memory) for id, memory in like.memory.items()}
    return Samples(t, q, v, like.torque, memory, like.load)


def compile_step(terms: Sequence[Term], has_load: bool = False, longest: ArrayLike = LONGEST_STEP) -> Recurrence | None:
    """Compile a step of terms, for steps of at most `longest` [s]; return None if a law is not symbolic.

    Each call writes the step again, because a law may depend on global values; equal steps are compiled once.
    `StepPrograms` keeps the steps instead.
    """
    from pendulum_env.physics.compiled import compile_recurrence  # slow import

    try:
        balance, x, nonlinear = write_balance(terms, has_load)
        duration: Any = make_symbol("h", largest=round_up(longest))
        after = step(balance, x, duration)
        constants: Any = [*balance.theta, *nonlinear, *(x.load[:2] if has_load else ()), duration]
        inputs: Any = [x.torque, *(x.load[2:] if has_load else ())]
        return compile_recurrence(inputs, constants, stack_rows(x), stack_rows(after))
    except Exception:  # a user's law may raise any error with symbols
        return None


class StepPrograms:
    """Cache of compiled steps, valid while no law changes."""

    def __init__(self) -> None:
        self._programs: dict[Hashable, Recurrence | None] = {}

    def __reduce__(self) -> tuple[type[StepPrograms], tuple[()]]:
        return StepPrograms, ()  # compiled programs cannot be pickled

    def find(
        self, compiler: Callable[..., Recurrence | None], terms: Sequence[Term], *arguments: Hashable
    ) -> Recurrence | None:
        """Return the step of `compiler(terms, *others)`, cached by the terms' classes and free parameters."""
        key = (tuple((type(term), tuple(parameter.name for parameter in term.free)) for term in terms), *arguments)
        if key not in self._programs:
            self._programs[key] = compiler(terms, *arguments)
        return self._programs[key]


def write_balance(terms: Sequence[Term], has_load: bool = False) -> tuple[TorqueBalance, Samples, list[Symbol]]:
    """Write the torque balance of terms in symbols.

    Returns:
        Balance, samples of symbols, and symbols of the free nonlinear parameters.

    Raises:
        Exception: of any type, if a law is not symbolic.
    """
    symbolic = [write_symbols(term, place) for place, term in enumerate(terms)]
    theta: Any = [make_symbol(f"theta_{k}") for k in range(sum(len(term.columns) for term, _ in symbolic))]
    balance = TorqueBalance([term for term, _ in symbolic], theta, has_load)
    x: Any = Samples(*(make_symbol(text) for text in ("time", "position", "velocity", "torque")))  # type: ignore[arg-type]
    if has_load:
        load: Any = KnownLoad(*(make_symbol(f"load_{part}") for part in KnownLoad._fields))  # type: ignore[arg-type]
        x = replace(x, load=load)
    memory = {
        id: tuple(make_symbol(f"memory.{id}.{k}") for k in range(len(memory)))
        for id, memory in balance.start(x).items()
    }
    return balance, replace(x, memory=memory), [symbol for _, symbols in symbolic for symbol in symbols]
