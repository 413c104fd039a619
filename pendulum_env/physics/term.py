"""Physical terms; one definition serves regressors, simulation and report.

The torque balance is linear in the parameters theta once the nonlinear parameters (a Stribeck velocity, a cogging
order) are fixed:

    torque = sum_k theta_k (mass_k q'' + force_k + dry_k sgn q')

A `Column` is the bracket behind one theta_k, a `Term` is one physical effect: its columns, its law in words, and the
nonlinear parameters it is built with. Texts about it stand beside the law in a `Description`.
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
from pendulum_env.physics.symbols import make_symbol, may_be_true, repeat
from pendulum_env.units import JointUnits

if TYPE_CHECKING:
    from pendulum_env.physics.compiled import Recurrence

Memory = tuple[Array, ...]  # state variables of a term: each a scalar per pendulum, or a series of N of them
Kind = Literal["inertial", "potential", "dissipative", "actuation", "time-varying", "transmission", "sensor"]


class KnownLoad(NamedTuple):
    """Known load on the joint; scalars, or one for each of N samples or pendulums. See `LOAD`."""

    inertia: ArrayLike = 0.0  # [kg m^2] about the axis
    gravity: ArrayLike = 0.0  # [N m], torque that holds it out level
    torque: ArrayLike = 0.0  # [N m], measured at the output, that acts on the joint

    def __bool__(self) -> bool:
        return may_be_true(self.inertia) or may_be_true(self.gravity) or may_be_true(self.torque)

    def get_torque(self, time: Array) -> Array:
        """Return its torque at every sample (N,) [N m]."""
        return np.broadcast_to(np.asarray(self.torque, dtype=float), time.shape)

    def select(self, index: Any) -> KnownLoad:
        """Select samples of the parts that change from sample to sample."""
        return KnownLoad(*(quantity if np.ndim(quantity) == 0 else np.asarray(quantity)[index] for quantity in self))


T = TypeVar("T", bound="Term")
UNLOADED = KnownLoad()
ROOM = 25.0  # [deg C], default temperature of a joint


@dataclass(frozen=True)
class Samples:
    """Arguments of a term: scalars, N samples in time order, or a batch of pendulums (all four broadcast)."""

    time: Array  # [s]
    position: Array  # [rad], unwrapped, 0 hangs down
    velocity: Array  # [rad/s]
    torque: Array  # [N m], commanded
    memory: Mapping[str, Memory] = field(default_factory=dict)  # states of the terms that have any, by term id
    load: KnownLoad = UNLOADED  # what is known to hang on the joint, beside the model
    temperature: ArrayLike = ROOM  # [deg C], of the joint


Law = Callable[[Samples], ArrayLike]


def zero(x: Samples) -> ArrayLike:
    """Return zero: the default of a column's parts."""
    return 0.0


def one(x: Samples) -> ArrayLike:
    """Return one, as a scalar, so that a step of one pendulum stays cheap."""
    return 1.0


@dataclass(frozen=True)
class Column:
    """Factor of a parameter in the torque that a motion needs: mass q'' + force + dry sgn q' [N m per unit].

    Attributes:
        name: name of the parameter, `effect` or `effect.part`.
        unit: unit of the parameter.
        mass: weight of the acceleration; momentum is mass q', kinetic energy mass q'^2 / 2.
        force: torque that is a smooth function of time, position, velocity and commanded torque.
        dry: magnitude of set-valued dry friction; at rest it balances anything up to this.
        of_torque: whether it scales with the commanded torque: such a column can explain torque by torque, not motion.
        potential: stored energy U of a column whose `force` is dU/dq + loss; it adds no torque by itself. Without it,
            all of the force's work is dissipated.
        loss: the part of the force whose work is dissipated, where there is a potential.
        least: smallest value that a body can have, whatever else it has; minus infinity where a fit beyond what a body
            can have tells of the data, as viscous and dry friction.
        most: largest value.
    """

    name: str
    unit: str
    mass: Law = zero
    force: Law = zero
    dry: Law = zero
    potential: Law | None = None
    loss: Law = zero
    of_torque: bool = False
    least: float = -np.inf
    most: float = np.inf

    def is_allowed(self, value: float) -> bool:
        """Return whether a value of the parameter is physical."""
        return self.least <= value <= self.most

    @property
    def is_known(self) -> bool:
        """Return whether the parameter is fixed."""
        return self.least == self.most

    def clamp(self, value: float) -> float:
        """Return the nearest value within the limits."""
        return min(max(value, self.least), self.most)

    def torque(self, x: Samples, acceleration: ArrayLike) -> ArrayLike:
        """Return the torque per unit of the parameter; sgn 0 is taken as 0, so mask samples in stick."""
        return self.mass(x) * acceleration + self.force(x) + self.dry(x) * np.sign(x.velocity)

    def power(self, x: Samples) -> ArrayLike:
        """Return the dissipated power per unit of the parameter: q' loss + dry |q'|."""
        lossy = self.force if self.potential is None else self.loss
        return lossy(x) * x.velocity + self.dry(x) * np.abs(x.velocity)


# Torque that a known load takes, dI q'' + dmgl sin q - tau_load. It is no term of any model: it belongs to the
# recording, so that the parameters are those of the joint without it.
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
    """Parameter that enters nonlinearly: it is searched for, not solved for."""

    name: str
    unit: str
    low: float
    high: float
    integer: bool = False
    follows: str = ""  # name of a linear parameter of another term that this one is to equal
    instant: bool = False  # whether it is a time at which something happens, which shows only in what is sampled then
    nominal: float | None = None  # value at which it stays, and is no parameter at all, unless data call for another
    is_frequency: bool = False  # whether its rad/s are of an oscillation, and no speed of the joint

    def get_unit(self, units: JointUnits) -> str:
        """Return its unit at a joint."""
        return self.unit if self.is_frequency else units.unit(self.unit)


@dataclass(frozen=True)
class Term:
    """Physical effect; its dataclass fields are its nonlinear parameters.

    This is the one base class of the physics: it holds the defaults that most effects share, so that a user's own
    effect needs `id`, `law`, `kind` and `columns` only. Overridden are `columns`, and where needed `fixed`; a term
    whose torque depends on the past overrides `start` and `advance` too, and finds its state in `Samples.memory`.

    Attributes:
        id: letters, digits and underscores; parameters are named `id` or `id.part`.
        law: added to the torque that the motion needs, as a text.
        kind: "inertial", "potential", "dissipative", "actuation", "time-varying", "transmission" or "sensor".
        columns: one `Column` for each linear parameter, with a `mass`, a `force` or a `dry`.
    """

    id: ClassVar[str]
    at: ClassVar[str] = ""  # the joint where it is, of an arm of several; its id then ends with it, `stribeck@elbow`;
    # of what loads two joints both, the second with its sign, `coupling@elbow,-wrist`
    slides: ClassVar[bool] = False  # whether that joint does
    law: ClassVar[str]  # added to the torque that the motion needs
    kind: ClassVar[Kind]
    nonlinear_parameters: ClassVar[tuple[NonlinearParameter, ...]] = ()
    by_angle: ClassVar[tuple[str, ...]] = ()  # its first columns that `list_angle_functions` lists
    needs: ClassVar[str] = ""  # quantity that a recording has to have beside motion and torque
    link: ClassVar[bool] = False  # whether its memory is position and velocity of a link behind the motor
    has_impacts: ClassVar[bool] = False  # whether it acts for less time than any smoothing of the motion takes
    forgets: ClassVar[float] = np.inf  # time after which a term with memory no longer knows where it started [s]
    typical_size: ClassVar[str] = ""  # that a rig might show, as `sin=0.15,cos=0.1`; by default the units tell it
    percent_of: ClassVar[tuple[str, ...]] = ()  # parts that are also given in per cent of the term of that name
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
    def mechanism(self) -> Mechanism:
        """Return the joints of a model that begins with this term."""
        return PENDULUM

    @property
    def fixed(self) -> tuple[Column, ...]:
        """Return columns with coefficient one: laws without a linear parameter of their own."""
        return ()

    @classmethod
    def has_state(cls) -> bool:
        """Return whether the term has states along a motion, including a dead time."""
        return cls.advance is not Term.advance or cls.has_own_trace()

    @classmethod
    def has_own_trace(cls) -> bool:
        """Return whether the term traces its states in its own way, not step by step."""
        return cls.trace is not Term.trace

    def list_angle_functions(self, at: str) -> tuple[str, ...]:
        """List the functions of the angle of a joint that it contains: `one`, `line`, `sine` or `cosine`.

        One whose parameter is known is none: the rest of that function belongs to whatever else explains it.
        """
        return tuple(name for name, column in zip(self.by_angle, self.columns, strict=False) if not column.is_known)

    @property
    def fault(self) -> str:
        """Return the objection to a combination of nonlinear parameters within their limits; empty if none."""
        return ""

    def derived(self, theta: Array) -> dict[str, tuple[float, str]]:
        """Compute derived parameters with units by short name; theta (P,) are the linear parameters."""
        return {}

    def bind(self: T, linear: Mapping[str, float]) -> T:
        """Return the term with nonlinear parameters within the bounds that linear ones set them, of a model by name."""
        return self

    @property
    def reductions(self) -> tuple[Term, ...]:
        """Return the simpler laws that this law becomes where a nonlinear parameter is zero."""
        return ()

    @property
    def open_ends(self) -> tuple[bool, bool]:
        """Return whether the term may act below and above the angles of a motion, as a stop that was never met."""
        return False, False

    @property
    def delay(self) -> float:
        """Return the delay of the torque command [s]."""
        return 0.0

    @property
    def lead(self) -> float:
        """Return the time T [s] of command = (1 + T d/dt) torque."""
        return 0.0

    def start(self, x: Samples) -> Memory:
        """Return the states of a joint that has been as in `x` for long; empty for a term without memory."""
        return ()

    def advance(self, memory: Memory, x: Samples, duration: ArrayLike) -> Memory:
        """Return the states after `duration` [s], position and velocity moving on as in `x`, the command held."""
        return memory

    def trace(self, x: Samples, command: Array, period: float) -> Memory:
        """Return the states along N recorded samples; see `trace_variants`."""
        return trace_variants([self], [x], [command], [period])[0][0]

    @classmethod
    def trace_each(cls, variants: Sequence[Term], x: Samples, command: Array, period: float) -> list[Memory]:
        """Return the states of each of V variants along N recorded samples."""
        return [variant.trace(x, command, period) for variant in variants]

    @property
    def nonlinear_values(self) -> dict[str, float]:
        """Return the values of the nonlinear parameters by name."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @classmethod
    def get_full_name(cls, part: str) -> str:
        """Return the full name of a nonlinear parameter, `stribeck.stribeck_velocity` or that `@elbow`."""
        effect, at, joint = cls.id.partition("@")
        return f"{effect}.{part}{at}{joint}"

    @classmethod
    def name_memory(cls, memory: Memory) -> dict[str, Memory]:
        """Return the states by id, as samples carry them; at an arm also by the id of a single joint."""
        return {cls.id.partition("@")[0]: memory, cls.id: memory}

    @property
    def has_memory(self) -> bool:
        """Return whether the torque depends on the past."""
        return type(self).start is not Term.start

    @property
    def hides(self) -> bool:
        """Return whether the term has a state that is not measured."""
        return self.has_memory and not self.needs

    @property
    def free(self) -> tuple[NonlinearParameter, ...]:
        """Return the nonlinear parameters to be found: those that are not at their nominal value."""
        return tuple(p for p in self.nonlinear_parameters if np.any(getattr(self, p.name) != p.nominal))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Return the full names of the linear and of the free nonlinear parameters."""
        return (*(column.name for column in self.columns), *(self.get_full_name(p.name) for p in self.free))


def derive_kind(kind: type[T], factory: Callable[..., type[T]], *arguments: Any, **members: Any) -> type[T]:
    """Derive a kind of term with some other members: `factory(kind, *arguments)` makes it again.

    No module has it by its name; another process makes it again, and finds the same one if the factory remembers it.
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


def write_symbols(term: Term, place: int = 0) -> tuple[Term, dict[str, ArrayLike]]:
    """Write a term in symbols, and the values of its free nonlinear parameters by symbol."""
    values: dict[str, ArrayLike] = {f"{place}.{p.name}": term.nonlinear_values[p.name] for p in term.free}
    symbols: dict[str, Any] = {p.name: make_symbol(f"{place}.{p.name}") for p in term.free}
    nominal: dict[str, Any] = {p.name: p.nominal for p in term.nonlinear_parameters}  # rows of a batch agree
    return replace(term, **nominal | symbols), values


def list_loads(at: str) -> dict[str, float]:
    """List the joints that a term loads, each with the ratio between its motion and the term's."""
    return {joint.removeprefix("-"): -1.0 if joint.startswith("-") else 1.0 for joint in at.split(",")}


def round_up(duration: ArrayLike) -> float:
    """Round a duration [s] up to whole milliseconds, so that similar programs are compiled once."""
    return float(np.ceil(1e3 * np.max(duration) - 1e-6) / 1e3)


def _step_memory(term: Term, given: Sequence[Any], memory: Sequence[Any], period: Any) -> list[Any]:
    """Return the states of a term after a period [s], unless nothing moves; in symbols or arrays."""
    *sample, at_rest = given
    moved = term.advance(tuple(memory), Samples(*sample), period)
    return [np.where(at_rest, old, new) for old, new in zip(memory, moved, strict=True)]


def _compile_advance(term: Term, count: int, period: Array) -> tuple[Recurrence, list[ArrayLike]] | None:
    """Compile the evolution of the states of a term along a motion, with its constants; None if it is no formula."""
    from pendulum_env.physics.compiled import compile_recurrence  # here, as it takes long to load

    given, states = ("time", "position", "velocity", "torque", "at_rest"), [f"memory_{k}" for k in range(count)]
    try:
        symbolic, values = write_symbols(term)
        after = _step_memory(
            symbolic,
            [*map(make_symbol, given)],
            [*map(make_symbol, states)],
            make_symbol("period", most=round_up(period)),
        )
        return compile_recurrence(given, [*values, "period"], states, after), [*values.values(), period]
    except Exception:  # a user's law may do anything that NumPy does
        return None


def trace_variants(
    variants: Sequence[Term], runs: Sequence[Samples], commands: Sequence[Array], periods: Sequence[float]
) -> list[list[Memory]]:
    """Trace the states of V variants of one effect along the recorded motion of several recordings.

    All variants and all recordings advance together: nonlinear parameters are stacked into arrays (V, 1), and blocks of
    the recordings run side by side, each led in from a little before, long enough to forget how it began.

    Args:
        variants: terms of one class.
        runs: samples of the motion, (N,) of each recording.
        commands: torque held from each sample to the next (N,) [N m].
        periods: between samples [s].

    Returns:
        For each recording and each variant its state variables, each (N,), at the samples.
    """
    names = variants[0].nonlinear_values
    fields = {name: np.array([variant.nonlinear_values[name] for variant in variants]) for name in names}
    stacked = type(variants[0])(**{name: values[:, None] for name, values in fields.items()})
    counts = [len(command) for command in commands]
    longest = max(counts)
    lead = longest if np.isinf(stacked.forgets) else int(np.ceil(stacked.forgets / min(periods)))
    length = max(lead, int(np.ceil(longest / 64))) if lead < longest else longest
    begins = [np.arange(0, count, length) for count in counts]
    blocks = [len(begin) for begin in begins]
    steps = length if max(blocks) == 1 else length + lead
    offsets = np.arange(-(steps - length), length)[:, None]
    # (steps, blocks) each: index into all recordings in a row
    at = np.concatenate(
        [
            np.clip(begin + offsets, 0, count - 1) + first
            for begin, count, first in zip(begins, counts, np.cumsum([0, *counts[:-1]]), strict=True)
        ],
        axis=1,
    )
    time, position, velocity = (
        np.concatenate([np.asarray(getattr(x, name)) for x in runs])[at] for name in ("time", "position", "velocity")
    )
    held = np.concatenate(commands)[at]
    period = np.repeat(periods, blocks)
    half = 0.5 * (velocity[1:] + velocity[:-1])  # carries each sample to the next
    resting = np.diff(at, axis=0) == 0  # led in from before the first sample: nothing moves
    shape = (len(variants), sum(blocks))
    first_samples = Samples(time[0], position[0] + np.zeros(shape), velocity[0] + np.zeros(shape), held[0])
    memory = stacked.start(first_samples)
    states = np.array([np.broadcast_to(row, shape) for row in memory])
    inputs = np.stack([time[:-1], position[:-1], half, held[:-1], resting], axis=1)
    if (advance := _compile_advance(stacked, len(memory), period)) is not None:
        program, constants = advance
        history = program(inputs, np.array([np.broadcast_to(row, shape) for row in constants]), states)
    else:
        history = repeat(lambda given, rows: _step_memory(stacked, given, rows, period), inputs, states)
    kept = np.moveaxis(history[steps - length :], 0, -1)  # (states, V, blocks, length)
    results = []
    for block, count in zip(np.split(kept, np.cumsum(blocks)[:-1], axis=2), counts, strict=True):
        series = block.reshape(len(memory), len(variants), -1)[:, :, :count]
        results.append([tuple(series[:, v]) for v in range(len(variants))])
    return results
