"""A model: an ordered list of terms and the values of their parameters."""

from __future__ import annotations

import json
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from msgspec import Meta, Struct

from pendulum_env import notebook
from pendulum_env._typing import JSON, Array, ArrayLike
from pendulum_env.errors import FileError, UserError
from pendulum_env.files import write_whole
from pendulum_env.formatting import format_estimate
from pendulum_env.lookup import find
from pendulum_env.physics import library
from pendulum_env.physics.base import BASE
from pendulum_env.physics.limits import collect_limits, limit_term, read_limits, write_limits
from pendulum_env.physics.mechanism import PENDULUM, Mechanism
from pendulum_env.physics.simulation import Trajectory, simulate
from pendulum_env.physics.table import Table, TableCurve, read_table, refuse_held
from pendulum_env.physics.term import Column, NonlinearParameter, Samples, Term
from pendulum_env.physics.terms import set_nonlinear_values
from pendulum_env.reading import Number, Text, convert, read_json
from pendulum_env.settings import Blank, format_setting
from pendulum_env.units import JointUnits, to_shown_unit

SCHEMA = "pendulum-ident/model@1"
ARM_SCHEMA = "pendulum-ident/arm-model@1"  # of several joints, which `pendulum_env.arms` reads


class ModelError(UserError):
    """Model or model file that is invalid; the message has the place and the remedy."""


SIGNIFICANT = 3.0  # standard errors by which a parameter differs from zero
NO_INERTIA = "the model lacks the term inertia: add it"


@dataclass(frozen=True, repr=False)
class Estimate:
    """Value of a parameter with its standard error, both in `unit`; the error is 0 where nothing was estimated.

    So it is at a bound: the fit would have gone further, and noise says nothing of a value that it did not choose.
    If the model lacks an effect, the value is biased by an unknown amount, and the error counts noise alone.
    """

    value: float
    std: float
    unit: str
    at_bound: bool = field(default=False, compare=False)
    is_biased: bool = field(default=False, compare=False)
    is_unknown: bool = field(default=False, compare=False)  # the data do not determine it

    @classmethod
    def from_bounds(cls, value: float, std: float, unit: str, least: float, most: float) -> Estimate:
        """Make an estimate kept within bounds; equal bounds make a known value."""
        at_bound = least < most and value in (least, most)
        return cls(value, 0.0 if at_bound or least == most else std, unit, at_bound)

    @property
    def is_significant(self) -> bool:
        """Return whether the value differs from zero by more than 3 standard errors."""
        return abs(self.value) > SIGNIFICANT * self.std

    @property
    def text(self) -> str:
        """Format the estimate for a table: `0.08951 ± 0.00012`, `0.3 (at its bound)`, `0.0895 (biased)`, `unknown`."""
        if self.is_unknown:
            return "unknown"
        if self.is_biased and not self.at_bound and self.std > 0:
            return f"{self.value:.3g} (biased)"
        return format_estimate(self.value, self.std) + (" (at its bound)" if self.at_bound else "")

    @property
    def shown(self) -> Estimate:
        """Convert to the displayed unit: an angle may be in degrees. Speeds and frequencies stay in rad/s."""
        factor, unit = to_shown_unit(1.0, self.unit, is_parameter=True)
        return replace(self, value=factor * self.value, std=factor * self.std, unit=unit)

    def __str__(self) -> str:
        own = self.shown
        return own.text if own.is_unknown or own.unit == "1" else f"{own.text} {own.unit}"

    def __repr__(self) -> str:
        return f"<{self}>"

    def __float__(self) -> float:
        return self.value

    def json(self) -> JSON:
        """Return a plain dictionary for JSON; flags mark a biased or unknown value."""
        data: JSON = {"value": self.value, "std": self.std, "unit": self.unit}
        return data | {key: True for key, so in (("biased", self.is_biased), ("unknown", self.is_unknown)) if so}


def shorten_name(name: str) -> str:
    """Shorten the name of a parameter for a reader: `dead_time` for `dead_time.dead_time`."""
    id, _, rest = name.partition(".")
    part, at, joint = rest.partition("@")
    return f"{id}{at}{joint}" if part == id else name


@dataclass(frozen=True, repr=False)
class Model(Mapping[str, Estimate]):
    """Terms and parameters of the torque balance; `model["gravity"]` is an estimate, printed with a line for each.

    A model is a mapping of its estimates by full name, as `dead_time.dead_time`. An estimate is also found by the short
    name that is printed, as `dead_time`.

    Attributes:
        terms: ordered terms; a term's nonlinear parameters are fields of the term.
        estimates: every parameter by name: linear ones by the name of their column, nonlinear ones as `id.name`.
        torque_unit: `N m`, or that of a current in whose stead every parameter is per unit of it.
        slides: whether the one joint slides; of an arm the body tells it.
        torque_constant: by which a current became the torque that the model was fitted to, if one did; the errors of
            the estimates include its own.
        correlation: of the errors of the estimates, rows and columns in their order; empty if unknown.
        log_format: how the recordings that it was fitted to were read, in the words of a study, so that the next one
            can be read alike: `columns`, `unwrap`, `load`, `drive`, as far as given.
    """

    terms: tuple[Term, ...] = BASE
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    torque_unit: str = "N m"
    slides: bool = False
    torque_constant: Estimate | None = None
    correlation: tuple[tuple[float, ...], ...] = ()
    log_format: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def build(cls, terms: Sequence[Term], theta: ArrayLike, std: ArrayLike = 0.0, **nonlinear_std: float) -> Self:
        """Build a model from linear parameters theta (P,) and their standard errors, in the order of the columns.

        Args:
            terms: ordered terms.
            theta: linear parameters (P,).
            std: their standard errors, scalar or (P,).
            nonlinear_std: standard errors of nonlinear parameters by `id.name`, where known.
        """
        columns = [column for term in terms for column in term.columns]
        values = np.broadcast_to(np.asarray(theta, dtype=float), (len(columns),))
        errors = np.broadcast_to(np.asarray(std, dtype=float), (len(columns),))
        estimates = {
            c.name: Estimate.from_bounds(float(v), float(s), c.unit, c.least, c.most)
            for c, v, s in zip(columns, values, errors, strict=True)
        }
        for term in terms:
            for parameter in term.free:
                name = term.get_full_name(parameter.name)
                ends = (-np.inf, np.inf) if parameter.integer else (parameter.low, parameter.high)
                value, error = term.nonlinear_values[parameter.name], nonlinear_std.get(name, 0.0)
                estimates[name] = Estimate.from_bounds(value, error, parameter.unit, *ends)
        return cls(tuple(terms), estimates)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Return the columns of the regressor in order."""
        return tuple(column for term in self.terms for column in term.columns)

    def __getitem__(self, name: str) -> Estimate:
        known = {shorten_name(full): own for full, own in self.estimates.items()}
        return find("parameter", name, {**known, **self.estimates})

    def __iter__(self) -> Iterator[str]:
        return iter(self.estimates)

    def __len__(self) -> int:
        return len(self.estimates)

    def __repr__(self) -> str:
        lines = [f"{shorten_name(name)}  {estimate}" for name, estimate in self.readable.items()]
        return "\n  ".join([f"<{type(self).__name__} with {len(self.terms)} terms>", *lines])

    @property
    def theta(self) -> Array:
        """Return the linear parameters (P,) in the order of the columns."""
        return np.array([self.estimates[column.name].value for column in self.columns])

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the ids of the terms beyond the base."""
        base = {term.id for term in BASE}
        return tuple(term.id for term in self.terms if term.id not in base)

    @property
    def tables(self) -> dict[str, tuple[Table, TableCurve]]:
        """Return the tables of the model by id, with their quantity and range."""
        tables = [term for term in self.terms if isinstance(term, Table)]
        names, covariance, found = list(self.estimates), self.assumed_covariance if tables else np.empty((0, 0)), {}
        for term in tables:
            place = [names.index(column.name) for column in term.columns]
            theta = np.array([self.estimates[names[k]].value for k in place])
            found[term.id] = term, term.curve(theta, covariance[np.ix_(place, place)])
        return found

    @property
    def readable(self) -> dict[str, Estimate]:
        """Return the estimates for a reader: a table's coefficients become its largest value, under its id."""
        tables = self.tables
        entries = {column.name for term, _ in tables.values() for column in term.columns}
        shown = {name: own for name, own in self.estimates.items() if name not in entries}
        for id, (term, curve) in tables.items():
            k = int(np.argmax(np.abs(curve.value)))
            entry = self.estimates[term.columns[0].name]
            shown[f"{id} (largest)"] = replace(
                entry, value=float(curve.value[k]), std=float(curve.std[k]), at_bound=False
            )
        return shown

    @property
    def covariance(self) -> Array | None:
        """Return the covariance (P + S, P + S) of the estimates in order; None if their correlation is unknown."""
        if not self.correlation:
            return None
        std = np.array([estimate.std for estimate in self.estimates.values()])
        return np.array(self.correlation) * np.outer(std, std)

    @property
    def assumed_covariance(self) -> Array:
        """Return the covariance, with zero for unknown correlations."""
        std = np.array([estimate.std for estimate in self.estimates.values()])
        return np.diag(std**2) if self.covariance is None else self.covariance

    def with_covariance(self, names: Sequence[str], covariance: Array) -> Model:
        """Return the model with the correlations of a covariance (Q, Q) of some parameters."""
        std = np.sqrt(np.diag(covariance))
        known = covariance / np.maximum(np.outer(std, std), 1e-300)
        place = [list(self.estimates).index(name) for name in names]
        full = np.eye(len(self.estimates))
        full[np.ix_(place, place)] = np.clip(known.round(9), -1.0, 1.0)  # the same when read from a covariance
        np.fill_diagonal(full, 1.0)
        return replace(self, correlation=tuple(tuple(row) for row in full.tolist()))

    @property
    def derived(self) -> dict[str, Estimate]:
        """Compute derived parameters, such as `backlash.k`, with standard errors to first order."""
        return _derive_all(self)

    def add(self, term: Term, theta: ArrayLike = 0.0) -> Model:
        """Return the model with one more term, its linear parameters at `theta`; fit it to recordings next."""
        if term.id in {old.id for old in self.terms}:
            raise ModelError(f"the model has '{term.id}' already: each effect can be added once")
        refuse_held(self.terms, term)
        added = Model.build([term], theta)
        new = added.convert_units(self.units()).estimates
        return replace(self, terms=(*self.terms, term), estimates={**self.estimates, **new}, correlation=())

    @property
    def body(self) -> Mechanism:
        """Return the mechanism: the joint of a pendulum, or the joints of an arm."""
        return self.terms[0].mechanism if self.terms else PENDULUM

    def with_values(self, values: Mapping[str, float]) -> Model:
        """Return the model with some parameters, by name, at other values."""
        for name, value in values.items():
            find("parameter of the model", name, self.estimates)
            if not np.isfinite(value) or (name == "inertia" and value <= 0):
                raise ModelError(f"{name} of a model cannot be {value:g}: give a positive number")
        new = {name: Estimate(float(value), 0.0, self.estimates[name].unit) for name, value in values.items()}
        terms = set_nonlinear_values(self.terms, values)
        return replace(self, terms=terms, estimates={**self.estimates, **new}, correlation=())

    def units(self, joint: str = "") -> JointUnits:
        """Return the units of quantities at a joint."""
        return self.body.units(joint, JointUnits(self.torque_unit, self.slides))

    def convert_units(self, units: JointUnits) -> Self:
        """Return the model with the units of another joint or torque unit, such as `A`."""
        own = {
            term.get_full_name(one.name): one.get_unit(units)
            for term in self.terms
            for one in term.nonlinear_parameters
        }
        named = {name: replace(e, unit=own.get(name) or units.unit(e.unit)) for name, e in self.estimates.items()}
        return replace(self, estimates=named, torque_unit=units.torque_unit, slides=units.slides)

    def get_parameters(self, id: str) -> dict[str, Estimate]:
        """Return the parameters of one of the terms, by name."""
        (term,) = (own for own in self.terms if own.id == id)
        names = [column.name for column in term.columns] + [
            term.get_full_name(parameter.name) for parameter in term.free
        ]
        return {name: self.estimates[name] for name in names}

    def mark_biased(self, names: Container[str] | None = None) -> Self:
        """Mark estimates, by default all, as biased by an effect that the model lacks."""
        estimates = {
            name: replace(e, is_biased=True) if names is None or name in names else e
            for name, e in self.estimates.items()
        }
        return replace(self, estimates=estimates)

    def withhold(self, names: Container[str]) -> Self:
        """Return the model with some parameters marked unknown, since the data do not determine them."""
        estimates = {name: replace(e, is_unknown=True) if name in names else e for name, e in self.estimates.items()}
        return replace(self, estimates=estimates)

    # Names of earlier releases, kept for one more
    at, of, per, biased, correlated = with_values, get_parameters, convert_units, mark_biased, with_covariance
    withholding = withhold

    def torque(self, x: Samples, acceleration: ArrayLike) -> ArrayLike:
        """Return the torque that the model needs for a motion [N m]; undefined in stick, mask these samples."""
        linear = sum(c * column.torque(x, acceleration) for c, column in zip(self.theta, self.columns, strict=True))
        return linear + sum(column.torque(x, acceleration) for term in self.terms for column in term.fixed)

    @property
    def has_known_inertia(self) -> bool:
        """Return whether the inertia is positive and not marked as unknown; True for an arm."""
        own = self.estimates.get("inertia")
        if own is None:
            return any(term.kind == "inertial" for term in self.terms)  # the links of an arm
        return not own.is_unknown and own.value > 0

    def refuse_unknown_inertia(self) -> None:
        """Refuse to simulate a model whose inertia is missing or unknown."""
        if self.has_known_inertia:
            return
        if "inertia" not in self.estimates:
            raise ModelError(NO_INERTIA)
        best = replace(self.estimates["inertia"], is_unknown=False)
        raise ModelError(
            f"the inertia is unknown, the best fit has {best}: record faster reversals, or give its value "
            f"({format_setting('fixed', {'inertia': Blank('VALUE')})})"
        )

    def simulate(
        self, period: float, torque: Array, position: ArrayLike, velocity: ArrayLike, start: ArrayLike = 0.0
    ) -> Trajectory:
        """Simulate free motion under a held torque command; see `pendulum_env.physics.simulation.simulate`."""
        self.refuse_unknown_inertia()
        return simulate(self.terms, self.theta, period, torque, position, velocity, start)

    def _repr_html_(self) -> str:
        return notebook.render_html(self)

    def json(self) -> JSON:
        """Return a plain dictionary for JSON."""
        data: JSON = {
            "schema": SCHEMA,
            "terms": [term.id for term in self.terms],
            "theta": {name: estimate.json() for name, estimate in self.estimates.items()},
        }
        if extents := {term.id: term.extent._asdict() for term in self.terms if isinstance(term, Table)}:
            data["tables"] = extents
        if self.torque_unit != "N m":
            data["torque_unit"] = self.torque_unit
        if self.slides:
            data["slides"] = True
        if self.torque_constant is not None:
            data["torque_constant"] = self.torque_constant.json()
        if self.log_format:
            data["log_format"] = dict(self.log_format)
        if limits := collect_limits(self.terms):
            data["limits"] = write_limits(limits)
        if (covariance := self.covariance) is not None:
            data["covariance"] = {"parameters": list(self.estimates), "matrix": covariance.tolist()}
        return data

    @classmethod
    def from_json(cls, data: JSON) -> Model:
        """Make a model from a dictionary that `json` made.

        Raises:
            ModelError: if a term is unknown, or a parameter is missing or no number that a pendulum could have.
        """
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            if isinstance(data, dict) and data.get("schema") == ARM_SCHEMA:
                raise ModelError(
                    f"this is a model of an arm, not of a pendulum: give the arm, {format_setting('robot', 'ARM.urdf')}"
                )
            raise ModelError(f"this is not a model: 'schema' should be {SCHEMA}")
        try:
            return _build_model(convert(data, _ModelFile))
        except ValueError as error:
            raise ModelError(str(error)) from None

    def save(self, path: str | Path) -> None:
        """Write JSON, whole or not at all."""
        write_whole(path, json.dumps(self.json(), indent=1) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Read a model file.

        Raises:
            ModelError: if the file is missing, is no JSON or is no model; the message names the file.
        """
        try:
            return cls.from_json(read_json(path, "a model is written by `Model.save` or by `identify`"))
        except FileError as error:
            raise ModelError(str(error)) from None
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from None


class ParameterFile(Struct):
    """Parameter in a model file."""

    value: Number
    std: Annotated[float, Meta(ge=0.0, le=1e100)] | None = None  # large where data do not show it; its square is finite
    unit: str | None = None
    biased: bool | None = None
    unknown: bool | None = None

    def estimate(self, unit: str) -> Estimate:
        """Make an estimate in a unit."""
        return Estimate(self.value, self.std or 0.0, unit, is_biased=bool(self.biased), is_unknown=bool(self.unknown))


class _Covariance(Struct):
    """Covariance of all parameters in a model file."""

    parameters: list[str]
    matrix: list[list[Number]]


class _ModelFile(Struct):
    """Content of a model file."""

    terms: list[Text]
    theta: dict[str, Any]  # of each, as `ParameterFile`
    tables: dict[str, Any] | None = None
    torque_unit: Text | None = None
    slides: bool = False
    torque_constant: ParameterFile | None = None
    covariance: _Covariance | None = None
    log_format: dict[str, Any] | None = None
    limits: dict[str, tuple[Number | None, Number | None]] | None = None  # of known and bounded parameters


def read_estimate(theta: Mapping[str, Any], name: str, unit: str) -> Estimate:
    """Read a parameter of a model file, in its unit."""
    if theta.get(name) is None:
        raise FileError(f"'theta' lacks '{name}'")
    return convert(theta[name], ParameterFile, f"theta.{name}").estimate(unit)


def _build_model(data: _ModelFile) -> Model:
    """Build a model from the content of a file."""
    limits = read_limits(data.limits or {})
    terms = tuple(limit_term(_build_term(id, data), limits) for id in data.terms)
    if len({term.id for term in terms}) != len(terms):
        raise ModelError("the model names a term twice: each may appear once")
    estimates = {}
    for name, default in Model.build(terms, 0.0).estimates.items():
        estimates[name] = read_estimate(data.theta, name, default.unit)
    inertia = estimates.get("inertia")
    if inertia is not None and inertia.value <= 0 and not inertia.is_unknown:
        raise ModelError(f"'theta.inertia.value' is {inertia.value:g}: expected a number above zero")
    constant = data.torque_constant
    model = replace(
        Model(terms, estimates).convert_units(JointUnits(data.torque_unit or "N m", data.slides)),
        torque_constant=None if constant is None else constant.estimate(constant.unit or "N m/A"),
        log_format=data.log_format or {},
    )
    return (
        model if data.covariance is None else model.with_covariance(*_read_covariance(data.covariance, list(estimates)))
    )


def _derive_all(model: Model) -> dict[str, Estimate]:
    """Compute the derived quantities of a model, by name."""
    names, values = list(model.estimates), np.array([estimate.value for estimate in model.estimates.values()])
    covariance = model.assumed_covariance
    found, first = {}, 0
    for term in model.terms:
        place = [
            *range(first, first + len(term.columns)),
            *(names.index(term.get_full_name(s.name)) for s in term.free),
        ]
        first += len(term.columns)
        own = values[place]
        perturbations = np.diag(1e-6 * np.maximum(np.abs(own), 1e-9))
        moved = [_derive_quantities(term, own + perturbation) for perturbation in perturbations]
        for name, (value, unit) in _derive_quantities(term, own).items():
            slope = np.array([other[name][0] - value for other in moved]) / perturbations.diagonal()
            std = np.sqrt(max(0.0, float(slope @ covariance[np.ix_(place, place)] @ slope)))
            is_biased = any(model.estimates[names[k]].is_biased for k in place)
            found[term.get_full_name(name)] = Estimate(
                float(value), float(std), model.units().unit(unit), is_biased=is_biased
            )
        for part in term.percent_of:
            name, of = term.get_full_name(part), f"{part}@{term.at}" if term.at else part
            base, entry = model.estimates.get(of), model.estimates[name]
            if base is not None and base.value != 0:
                share, both = 100 * entry.value / base.value, [names.index(name), names.index(of)]
                slope = np.array([100.0, -share]) / base.value
                std = float(np.sqrt(slope @ covariance[np.ix_(both, both)] @ slope))
                unit = f"%{entry.unit.removeprefix(base.unit)}"
                found[term.get_full_name(f"{part}_share")] = Estimate(share, std, unit, is_biased=entry.is_biased)
    return found


def _derive_quantities(term: Term, values: Array) -> dict[str, tuple[float, str]]:
    """Compute derived quantities of a term from its parameters (P + S,), linear ones first."""
    count = len(term.columns)
    nonlinear = {parameter.name: float(value) for parameter, value in zip(term.free, values[count:], strict=True)}
    return replace(term, **nonlinear).derived(values[:count])


def _build_term(id: str, data: _ModelFile) -> Term:
    """Build the term of an id in a model file, with its nonlinear parameters, or its extent."""
    kind = library.find_term(id)
    if issubclass(kind, Table):
        tables = data.tables or {}
        if id not in tables:
            raise ModelError(f"'tables' lacks '{id}'")
        return read_table(kind, tables[id], f"tables.{id}")
    values = {}
    for parameter in kind.nonlinear_parameters:
        name = kind.get_full_name(parameter.name)
        if parameter.nominal is not None and data.theta.get(name) is None:
            continue
        number = read_estimate(data.theta, name, parameter.unit).value
        values[parameter.name] = check_value(parameter, number, f"theta.{name}.value")
    term = kind(**values)
    if term.fault:
        raise ModelError(f"'{kind.id}' makes no sense: {term.fault}")
    return term


def check_value(parameter: NonlinearParameter, number: float, place: str) -> float:
    """Return the value of a nonlinear parameter in a model file; refuse one out of its range, by its place."""
    if not (parameter.low <= number <= parameter.high and (number.is_integer() or not parameter.integer)):
        what = "a whole number" if parameter.integer else "a number"
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        raise ModelError(f"'{place}' is {number:g}: expected {what} from {parameter.low:g} to {parameter.high:g}{unit}")
    return number


def _read_covariance(data: _Covariance, known: Sequence[str]) -> tuple[list[str], Array]:
    """Read the known parameters and their covariance from a model file, which may hold more."""
    names = data.parameters
    is_square = [len(row) for row in data.matrix] == [len(names)] * len(names)
    if not (set(known) <= set(names) and is_square and min(np.diag(data.matrix)) >= 0):
        raise ModelError("'covariance' is no covariance of all parameters: leave the whole key out")
    matrix = np.array(data.matrix)
    place = [names.index(name) for name in known]
    return list(known), matrix[np.ix_(place, place)]
