"""Content of model files, and its checks."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import asdict

from pendulum_env._typing import JSON, Array
from pendulum_env.errors import FileError, UserError
from pendulum_env.files import format_json, write_whole
from pendulum_env.lookup import UnknownName
from pendulum_env.physics import library
from pendulum_env.physics.estimate import Estimate
from pendulum_env.physics.limits import collect_limits, limit_term, make_limits, write_limits
from pendulum_env.physics.table import Table, read_table
from pendulum_env.physics.term import NonlinearParameter, Term
from pendulum_env.reading import Number, Text, convert, read_json
from pendulum_env.settings import format_setting

SCHEMA = "pendulum-ident/model@1"
ARM_SCHEMA = "pendulum-ident/arm-model@2"  # model with links, read by `robots.arms`
OLD_ARM_SCHEMA = "pendulum-ident/arm-model@1"  # the same of version 1.0, with terms as mappings


class ModelError(UserError):
    """Invalid model or model file; the message has the place and the remedy."""


class ParameterFile(Struct):
    """Parameter in a model file."""

    value: Number
    std: Annotated[float, Meta(ge=0.0, le=1e100)] | None = 0.0  # null if undetermined; the square is finite
    unit: str | None = None
    biased: bool | None = None
    unknown: bool | None = None

    def estimate(self, unit: str) -> Estimate:
        """Return the estimate in the given unit."""
        std = np.inf if self.std is None else self.std
        return Estimate(self.value, std, unit, is_biased=bool(self.biased), is_unknown=bool(self.unknown))


class Covariance(Struct):
    """Covariance of all parameters with a finite standard error in a model file."""

    parameters: list[str]
    matrix: list[list[Annotated[float, Meta(ge=-1e200, le=1e200)]]]  # squares of large errors

    def read(self, names_to_read: Sequence[str]) -> Array:
        """Return the covariance (Q, Q) of the parameters `names_to_read`; the file may have more."""
        names = self.parameters
        is_square = [len(row) for row in self.matrix] == [len(names)] * len(names)
        if not (set(names_to_read) <= set(names) and is_square and min(np.diag(self.matrix)) >= 0):
            raise ModelError("'covariance' is no covariance of all parameters: leave the whole key out")
        place = [names.index(name) for name in names_to_read]
        return np.array(self.matrix)[np.ix_(place, place)]


class ModelFile(Struct):
    """Content of a model file."""

    terms: list[Text]
    theta: dict[str, Any]  # parameters by name, as `ParameterFile`
    tables: dict[str, Any] | None = None
    torque_unit: Text | None = None
    slides: bool = False
    torque_constant: ParameterFile | None = None
    covariance: Covariance | None = None
    log_format: dict[str, Any] | None = None
    limits: dict[str, tuple[Number | None, Number | None]] | None = None  # bounds of known and bounded parameters


def read_estimate(theta: Mapping[str, Any], name: str, unit: str) -> Estimate:
    """Read a parameter of a model file in the given unit."""
    if theta.get(name) is None:
        raise FileError(f"'theta' lacks '{name}'")
    return convert(theta[name], ParameterFile, f"theta.{name}").estimate(unit)


def parse_model(content: Any) -> ModelFile:
    """Parse the content of a model file; raise a ModelError for other content."""
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema in (ARM_SCHEMA, OLD_ARM_SCHEMA):
        raise ModelError(
            f"this is a model of an arm, not of a pendulum: give the arm, {format_setting('robot', 'ARM.urdf')}"
        )
    if schema != SCHEMA:
        raise ModelError(f"this is not a model: 'schema' should be {SCHEMA}")
    return convert(content, ModelFile)


def build_terms(data: ModelFile, find: Callable[[str], type[Term]] = library.find_term) -> tuple[Term, ...]:
    """Build the terms of a model file, with nonlinear parameters and limits; `find` returns the kind of an id."""
    limits = make_limits({}, data.limits or {})
    terms = tuple(limit_term(_build_term(id, data, find), limits) for id in data.terms)
    if len({term.id for term in terms}) != len(terms):
        raise ModelError("the model names a term twice: each may appear once")
    return terms


def read_estimates(data: ModelFile, units: Mapping[str, str]) -> dict[str, Estimate]:
    """Read the parameters of a model file in the given units, by name."""
    return {name: read_estimate(data.theta, name, unit) for name, unit in units.items()}


def describe_terms(terms: Sequence[Term]) -> JSON:
    """Return the extents of tables and the limits of parameters, as in a model file."""
    extents = {term.id: asdict(term.extent) for term in terms if isinstance(term, Table)}
    tables = {
        id: {key: value for key, value in extent.items() if key != "merged" or value} for id, extent in extents.items()
    }
    return {"tables": tables, "limits": write_limits(collect_limits(terms))}


def read_model(path: str | Path) -> Any:
    """Read the JSON of a model file; raise a ModelError that names the file."""
    try:
        return read_json(path, "a model is what `Model.save` or `identify -o` writes, and comes before the recordings")
    except FileError as error:
        raise ModelError(str(error)) from None


def write_model(path: str | Path, content: JSON) -> None:
    """Write the JSON of a model file."""
    write_whole(path, format_json(content))


def _build_term(id: str, data: ModelFile, find: Callable[[str], type[Term]]) -> Term:
    """Build a term of a model file with its nonlinear parameters, or a table with its extent."""
    try:
        kind = find(id)
    except UnknownName as error:
        raise ModelError(f"{error}. An effect of your own needs its file: --plugin FILE.py, or `load_plugin`") from None
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


def refuse_excess_friction(terms: Sequence[Term], estimates: Mapping[str, Estimate]) -> None:
    """Refuse a link with more dry or viscous friction than the whole joint."""
    linear = {name: e.value for name, e in estimates.items() if name != "gravity"}  # gravity may be uncertain
    for term in terms:
        bound = term.bind(linear).nonlinear_values
        for name, value in term.nonlinear_values.items():
            if value - bound[name] > 1e-9 * abs(bound[name]):
                place = f"theta.{term.get_full_name(name)}.value"
                raise ModelError(
                    f"'{place}' is {value:g}: expected at most {bound[name]:g}, with which the link has all the "
                    f"{'Coulomb' if name == 'friction' else name} friction"
                )


def check_value(parameter: NonlinearParameter, number: float, place: str) -> float:
    """Return the value of a nonlinear parameter of a model file; refuse a value out of range at its `place`."""
    if not parameter.is_allowed(number):
        kind = "a whole number" if parameter.integer else "a number"
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        raise ModelError(f"'{place}' is {number:g}: expected {kind} {parameter.format_range()}{unit}")
    return number
