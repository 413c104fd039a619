"""Physical terms, used by regressors, simulation and report.

The torque balance is linear in the parameters theta for given nonlinear parameters, such as a Stribeck velocity:

    torque = sum_k theta_k (mass_k q'' + force_k + dry_k sgn q')

A `Column` is the factor of theta_k. A `Term` is a physical effect: its columns, its law as text, and its nonlinear
parameters. `Description` has further texts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, TypeVar

import numpy as np

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.physics.description import DESCRIPTIONS, Description
from pendulum_env.physics.mechanism import PENDULUM, Mechanism
from pendulum_env.physics.symbols import Symbol, make_symbol, make_symbols, may_be_true, repeat_step
from pendulum_env.units import JointUnits

if TYPE_CHECKING:
    from pendulum_env.physics.compiled import Recurrence

Memory = tuple[Array, ...]  # states of a term, each a scalar, (B,) or (N,)
Kind = Literal["inertial", "potential", "dissipative", "actuation", "time-varying", "transmission", "sensor"]


class KnownLoad(NamedTuple):
    """Known load on the joint, scalars or arrays per sample or pendulum; see `LOAD`."""

    inertia: ArrayLike = 0.0  # [kg m^2] about the axis
    gravity: ArrayLike = 0.0  # [N m], torque that holds the load horizontal
    torque: ArrayLike = 0.0  # [N m], measured torque that acts on the output

    def __bool__(self) -> bool:
        return may_be_true(self.inertia) or may_be_true(self.gravity) or may_be_true(self.torque)

    def get_torque(self, time: Array) -> Array:
        """Return the torque at each sample (N,) [N m]."""
        return np.broadcast_to(np.asarray(self.torque, dtype=float), time.shape)

    def select(self, index: Any) -> KnownLoad:
        """Select samples of all parts that are arrays."""
        return KnownLoad(*(quantity if np.ndim(quantity) == 0 else np.asarray(quantity)[index] for quantity in self))


T = TypeVar("T", bound="Term")
UNLOADED = KnownLoad()
ROOM = 25.0  # [deg C], default temperature of a joint


@dataclass(frozen=True)
class Samples:
    """Arguments of a law: scalars, N samples in time order, or a batch; all fields broadcast."""

    time: Array  # [s]
    position: Array  # [rad], unwrapped, 0 hangs down
    velocity: Array  # [rad/s]
    torque: Array  # [N m], commanded
    memory: Mapping[str, Memory] = field(default_factory=dict)  # states of terms by id
    load: KnownLoad = UNLOADED  # known load, not part of the model
    temperature: ArrayLike = ROOM  # [deg C], temperature of the joint


Law = Callable[[Samples], ArrayLike]


def return_zero(x: Samples) -> ArrayLike:
    """Return zero, the default of a column's laws."""
    return 0.0


def return_one(x: Samples) -> ArrayLike:
    """Return one, as a scalar for speed."""
    return 1.0


@dataclass(frozen=True)
class Column:
    """Factor of a linear parameter in the torque balance: mass q'' + force + dry sgn q' [N m per unit].

    Attributes:
        name: name of the parameter, `effect` or `effect.part`.
        unit: unit of the parameter.
        mass: factor of the acceleration; momentum is mass q', kinetic energy mass q'^2 / 2.
        force: torque as a smooth function of time, position, velocity and commanded torque.
        dry: magnitude of set-valued dry friction; at rest, friction is any torque up to it.
        of_torque: whether the column is proportional to the commanded torque.
        is_of_body: whether a physical value is never negative. Fits keep it from being negative, unless the user bounds
            it, or friction of free form is at the joint. Without this bound, a negative fit is evidence about the data.
        is_of_weight: whether the column needs the weight of a pendulum; a joint with links has none.
        potential: stored energy U with force = dU/dq + loss, without further torque; None: all work of the force is
            dissipated.
        loss: dissipative part of the force, for a column with a potential.
        least: smallest physical value of the parameter; minus infinity for a column `is_of_body`.
        most: largest physical value of the parameter.
    """

    name: str
    unit: str
    mass: Law = return_zero
    force: Law = return_zero
    dry: Law = return_zero
    potential: Law | None = None
    loss: Law = return_zero
    of_torque: bool = False
    is_of_body: bool = False
    is_of_weight: bool = False
    least: float = -np.inf
    most: float = np.inf

    def is_allowed(self, value: float) -> bool:
        """Return whether a value of the parameter is physical."""
        return self.least <= value <= self.most

    @property
    def is_known(self) -> bool:
        """Return whether the parameter is fixed."""
        return self.least == self.most

    @property
    def is_constant(self) -> bool:
        """Return whether the torque is constant while the joint moves in one direction: its law is `return_one`."""
        return return_one in (self.force, self.dry)

    def clamp(self, value: float) -> float:
        """Return the nearest value within the limits."""
        return min(max(value, self.least), self.most)

    def torque(self, x: Samples, acceleration: ArrayLike) -> ArrayLike:
        """Return the torque per unit of the parameter, with sgn 0 = 0; mask samples in stick."""
        return self.mass(x) * acceleration + self.force(x) + self.dry(x) * np.sign(x.velocity)

    def power(self, x: Samples) -> ArrayLike:
        """Return the dissipated power per unit of the parameter: q' loss + dry |q'|."""
        lossy = self.force if self.potential is None else self.loss
        return lossy(x) * x.velocity + self.dry(x) * np.abs(x.velocity)


# Torque of a known load, dI q'' + dmgl sin q - tau_load. It belongs to the recording: the parameters of a model are
# those of the unloaded joint.
LOAD = Column(
    "load",
    "1",
    mass=lambda x: x.load.inertia,
    force=lambda x: x.load.gravity * np.sin(x.position) - x.load.torque,
    potential=lambda x: x.load.gravity * (1.0 - np.cos(x.position)),
    loss=lambda x: -1.0 * x.load.torque,
)


@dataclass(frozen=True)
class NonlinearParameter:
    """Parameter that enters the torque nonlinearly."""

    name: str
    unit: str
    low: float
    high: float
    integer: bool = False
    follows: str = ""  # name of a linear parameter of another term with the same value
    instant: bool = False  # whether the value is a time, visible only in the samples near it
    is_position: bool = False  # whether the value is a position of the joint, from any zero
    nominal: float | None = None  # default value, at which the parameter is not counted or fitted
    is_frequency: bool = False  # whether rad/s is the frequency of an oscillation
    can_be_zero: bool = False  # whether a plant may have the value 0 below `low`, which switches the effect off

    def is_allowed(self, value: float) -> bool:
        """Return whether a plant may have the value."""
        is_inside = self.low <= value <= self.high or (self.can_be_zero and value == 0)
        return is_inside and (not self.integer or value == round(value))

    def format_range(self) -> str:
        """Format the allowed range: `from 0.0001 to 2, or 0`."""
        return f"from {self.low:g} to {self.high:g}{', or 0' * self.can_be_zero}"

    def get_unit(self, units: JointUnits) -> str:
        """Return the unit at a joint with the given units."""
        return self.unit if self.is_frequency else units.unit(self.unit)


@dataclass(frozen=True)
class Term:
    """Physical effect; the dataclass fields are its nonlinear parameters.

    A subclass needs `id`, `law`, `kind` and `columns` or `fixed`. A term with states also overrides `start` and
    `advance`, and reads its states from `Samples.memory`.

    Attributes:
        id: letters, digits and underscores; parameters are named `id` or `id.part`.
        law: torque of the effect as text, added to the left-hand side of the torque balance.
        kind: "inertial", "potential", "dissipative", "actuation", "time-varying", "transmission" or "sensor".
        columns: one `Column` per linear parameter, with a `mass`, a `force` or a `dry`.
    """

    id: ClassVar[str]
    at: ClassVar[str] = (
        ""  # name of the joint, the end of the id, `stribeck@elbow`; of a term at two joints both names,
    )
    # the second with its sign, `coupling@elbow,-wrist`
    mechanism: ClassVar[Mechanism] = PENDULUM  # of a model with this term as its first
    is_prismatic: ClassVar[bool] = False  # whether the joint is linear
    law: ClassVar[str]
    kind: ClassVar[Kind]
    nonlinear_parameters: ClassVar[tuple[NonlinearParameter, ...]] = ()
    by_angle: ClassVar[tuple[str, ...]] = ()  # angle functions of the first columns, for `list_angle_functions`
    needs: ClassVar[str] = ""  # further quantity that a recording must have
    link: ClassVar[bool] = False  # whether the states are position and velocity of a link behind the motor
    is_decentralised: ClassVar[bool] = True  # whether the torque depends on the motion and torque of one joint alone,
    # so that the effect is possible at a joint of a linked mechanism
    is_revolute_only: ClassVar[bool] = False  # whether the law is one of a turn, impossible at a linear joint
    has_impacts: ClassVar[bool] = False  # whether the torque acts for less time than the motion is smoothed
    typical_size: ClassVar[str] = ""  # typical size, `sin=0.15,cos=0.1`; by default from the units
    is_weight: ClassVar[bool] = False  # whether the torque is part of the joint's weight: gravity may have any sign
    has_links: ClassVar[bool] = False  # whether the torque has the inertia of links: that of the rotor may be 0
    is_restoring: ClassVar[bool] = False  # whether the torque must not fall with the angle
    can_hide_scale: ClassVar[bool] = False  # whether the torque may be a share of the torque that moves the joint, so
    # that the scale of all parameters is unknown
    is_free_form: ClassVar[bool] = False  # whether the law is any function, so that base friction may have any sign
    is_common: ClassVar[bool] = False  # whether a diagnosis reports its smallest detectable size
    percent_of: ClassVar[tuple[str, ...]] = ()  # parts also derived in per cent of the base term
    description: ClassVar[Description] = Description()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "description" in vars(cls):
            DESCRIPTIONS[cls.id] = cls.description

    @property
    def columns(self) -> tuple[Column, ...]:
        """Return the columns of the linear parameters."""
        return ()

    @property
    def fixed(self) -> tuple[Column, ...]:
        """Return columns with coefficient one, without a linear parameter."""
        return ()

    @classmethod
    def has_state(cls) -> bool:
        """Return whether the term has states along a motion; a dead time counts."""
        return cls.advance is not Term.advance or cls.has_own_trace()

    @classmethod
    def has_own_trace(cls) -> bool:
        """Return whether the term overrides `trace`."""
        return cls.trace is not Term.trace

    def list_angle_functions(self, at: str) -> tuple[str, ...]:
        """List the functions of a joint's angle that the term contains: `return_one`, `line`, `sine` or `cosine`.

        Functions with a known parameter are omitted, because other terms may then explain a rest of the same form.
        """
        return tuple(name for name, column in zip(self.by_angle, self.columns, strict=False) if not column.is_known)

    @property
    def fault(self) -> str:
        """Return the fault of the combination of nonlinear parameters as text, or an empty text."""
        return ""

    def derived(self, theta: Array) -> dict[str, tuple[float, str]]:
        """Compute derived parameters with units by short name, from the linear parameters theta (P,)."""
        return {}

    def bind(self: T, linear: Mapping[str, float]) -> T:
        """Return the term with nonlinear parameters clipped to bounds from the model's linear parameters, by name."""
        return self

    @property
    def reductions(self) -> tuple[Term, ...]:
        """Return the simpler terms that this term equals if a nonlinear parameter is zero."""
        return ()

    @property
    def ends(self) -> tuple[float, float] | None:
        """Return the angles [rad] below and above which a stop acts, infinite without a stop; None for other terms."""
        return None

    @property
    def open_ends(self) -> tuple[bool, bool]:
        """Return whether the term may act below and above the tested angles, as a stop without contact."""
        if self.ends is None:
            return False, False
        lower, upper = self.ends
        return not np.isfinite(lower), not np.isfinite(upper)

    @property
    def delay(self) -> float:
        """Return the delay of the torque command [s]."""
        return 0.0

    @property
    def lead(self) -> float:
        """Return the time constant T [s] of command = (1 + T d/dt) torque."""
        return 0.0

    @property
    def delays_torque(self) -> bool:
        """Return whether the torque acts after its command, by a lag or a delay."""
        return bool(self.lead or self.delay)

    def start(self, x: Samples) -> Memory:
        """Return the steady states for the samples x; empty for a term without states."""
        return ()

    def advance(self, memory: Memory, x: Samples, duration: ArrayLike) -> Memory:
        """Return the states after `duration` [s] of motion from x, at constant velocity and command."""
        return memory

    def list_known_states(self, time: Array) -> list[Array]:
        """Return the states at some instants if they are known functions of time; empty for other terms."""
        return []

    def trace(self, x: Samples, command: Array, period: float) -> Memory:
        """Return the states along N recorded samples, (N,) each; see `trace_variants`."""
        return trace_variants([self], [x], [command], [period])[0][0]

    @property
    def nonlinear_values(self) -> dict[str, float]:
        """Return the values of the nonlinear parameters by name."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @classmethod
    def get_full_name(cls, part: str) -> str:
        """Return the full name of a nonlinear parameter, `stribeck.stribeck_velocity`, at a joint with `@elbow`."""
        effect, at, joint = cls.id.partition("@")
        return f"{effect}.{part}{at}{joint}"

    @classmethod
    def name_memory(cls, memory: Memory) -> dict[str, Memory]:
        """Return the states by id, as in `Samples.memory`; at a named joint, by the id with and without the joint."""
        return {cls.id.partition("@")[0]: memory, cls.id: memory}

    @property
    def has_memory(self) -> bool:
        """Return whether the term has states."""
        return type(self).start is not Term.start

    @classmethod
    def has_known_states(cls) -> bool:
        """Return whether the states are known functions of time."""
        return cls.list_known_states is not Term.list_known_states

    @property
    def has_hidden_state(self) -> bool:
        """Return whether the term has unmeasured states."""
        return self.has_memory and not self.needs

    @property
    def free(self) -> tuple[NonlinearParameter, ...]:
        """Return the nonlinear parameters that differ from their nominal value."""
        return tuple(p for p in self.nonlinear_parameters if np.any(getattr(self, p.name) != p.nominal))

    @property
    def free_values(self) -> list[ArrayLike]:
        """Return the values of the free nonlinear parameters."""
        return [getattr(self, parameter.name) for parameter in self.free]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Return the full names of linear and free nonlinear parameters."""
        return (*(column.name for column in self.columns), *(self.get_full_name(p.name) for p in self.free))


def derive_kind(kind: type[T], factory: Callable[..., type[T]], *arguments: Any, **members: Any) -> type[T]:
    """Derive a kind of term with other members; pickling calls `factory(kind, *arguments)`.

    The class is not an attribute of a module. A cached factory returns the same class in each process.
    """
    common: dict[str, Any] = {
        "__doc__": kind.__doc__,
        "__module__": kind.__module__,
        "__reduce__": lambda self: (_rebuild_term, (kind(), factory, arguments, self.nonlinear_values)),
    }
    return type(kind.__name__, (kind,), common | members)


def _rebuild_term(
    bare: Term, factory: Callable[..., type[Term]], arguments: tuple[Any, ...], values: dict[str, float]
) -> Term:
    return factory(type(bare), *arguments)(**values)


def write_symbols(term: Term, place: int = 0) -> tuple[Term, list[Symbol]]:
    """Return the term with symbols as free nonlinear parameters, and these symbols."""
    symbols: dict[str, Any] = {p.name: make_symbol(f"{place}.{p.name}") for p in term.free}
    nominal: dict[str, Any] = {p.name: p.nominal for p in term.nonlinear_parameters}  # equal in all rows of a batch
    return replace(term, **nominal | symbols), [*symbols.values()]


def list_loads(at: str) -> dict[str, float]:
    """Return the joints of a term's `at`, with the sign of each joint's motion in that of the term."""
    return {joint.removeprefix("-"): -1.0 if joint.startswith("-") else 1.0 for joint in at.split(",")}


def round_up(duration: ArrayLike) -> float:
    """Round a duration [s] up to whole milliseconds, which reduces the number of compiled programs."""
    return float(np.ceil(1e3 * np.max(duration) - 1e-6) / 1e3)


def _compile_advance(term: Term, count: int, period: Array) -> Recurrence | None:
    """Compile the step of a term's states along a motion; return None if it is not symbolic."""
    from pendulum_env.physics.compiled import compile_recurrence  # slow import

    inputs: list[Any] = [make_symbol(text) for text in ("time", "position", "velocity", "torque")]
    memory: Memory = tuple(make_symbols("memory", count))
    duration: Any = make_symbol("period", largest=round_up(period))
    try:
        symbolic, nonlinear = write_symbols(term)
        after: Any = symbolic.advance(memory, Samples(*inputs), duration)
        return compile_recurrence(inputs, [*nonlinear, duration], memory, after)  # type: ignore[arg-type]
    except Exception:  # a user's law may raise any error with symbols
        return None


def trace_variants(
    variants: Sequence[Term], runs: Sequence[Samples], commands: Sequence[Array], periods: Sequence[float]
) -> list[list[Memory]]:
    """Compute the states of V variants of an effect along the motion of several recordings.

    Nonlinear parameters are stacked into arrays (V, 1), and all recordings advance in parallel.

    Args:
        variants: terms of one class.
        runs: samples (N,) of each recording.
        commands: torque [N m] held from each sample to the next (N,), of each recording.
        periods: sample time of each recording [s].

    Returns:
        States by recording and variant, (N,) each.
    """
    names = variants[0].nonlinear_values
    fields = {name: np.array([variant.nonlinear_values[name] for variant in variants]) for name in names}
    stacked = type(variants[0])(**{name: values[:, None] for name, values in fields.items()})
    counts = np.array([len(command) for command in commands])
    # (longest N, recordings): index into the concatenated recordings, the last sample again after their end
    index = np.minimum(np.arange(counts.max())[:, None], counts - 1) + np.cumsum(counts) - counts
    time, position, velocity = (
        np.concatenate([np.asarray(getattr(x, name)) for x in runs])[index] for name in ("time", "position", "velocity")
    )
    torque, period = np.concatenate(commands)[index], np.array(periods)
    mean_velocity = 0.5 * (velocity[1:] + velocity[:-1])  # mean velocity between samples
    shape = len(variants), len(runs)
    memory = stacked.start(Samples(time[0], position[0] + np.zeros(shape), velocity[0] + np.zeros(shape), torque[0]))
    states = np.array([np.broadcast_to(row, shape) for row in memory])
    inputs = np.stack([time[:-1], position[:-1], mean_velocity, torque[:-1]], axis=1)
    if (program := _compile_advance(stacked, len(memory), period)) is not None:
        constants = [np.broadcast_to(row, shape) for row in (*stacked.free_values, period)]
        history = program(inputs, np.array(constants), states)
    else:
        history = repeat_step(lambda x, rows: stacked.advance(tuple(rows), Samples(*x), period), inputs, states)
    # history (longest N, states, variants, recordings)
    return [
        [tuple(history[:count, :, variant, run].T) for variant in range(len(variants))]
        for run, count in enumerate(counts)
    ]
