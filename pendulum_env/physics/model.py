"""Models: ordered terms with parameter values."""

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import singledispatch
from pathlib import Path
from typing import Any, Self

import numpy as np

from pendulum_env._typing import JSON, Array, ArrayLike
from pendulum_env.lookup import find
from pendulum_env.notebook import Shown
from pendulum_env.physics import model_file
from pendulum_env.physics.base import BASE
from pendulum_env.physics.estimate import Estimate, derive_estimates, shorten_name
from pendulum_env.physics.mechanism import PENDULUM, Mechanism
from pendulum_env.physics.simulation import Trajectory, simulate
from pendulum_env.physics.table import Table, TableCurve, refuse_contained
from pendulum_env.physics.term import Column, Samples, Term
from pendulum_env.physics.terms import set_nonlinear_values
from pendulum_env.settings import Blank, format_setting
from pendulum_env.units import JointUnits

NO_INERTIA = "the model lacks the term inertia: add it"


@dataclass(frozen=True, repr=False)
class Model(Mapping[str, Estimate], Shown):
    """Terms and parameters of the torque balance; `model["gravity"]` is an estimate.

    A model is a mapping of its estimates by full name, such as `dead_time.dead_time`. Indexing also accepts the
    displayed short name, `dead_time`.

    Attributes:
        terms: ordered terms, with nonlinear parameters as their fields.
        estimates: all parameters by name; linear ones have the name of their column, nonlinear ones `id.name`.
        torque_unit: `N m`, or the unit of the recorded current in place of torque.
        is_prismatic: whether the joint of a pendulum is linear; `mechanism` has the joints of other models.
        torque_constant: constant that converted a current to the fitted torque; None without one. The standard errors
            of the estimates include its error.
        correlation: correlation matrix of the estimates, in their order; empty if unknown.
        log_format: options with which the fitted recordings were read, as keys of a study: `columns`, `unwrap`,
            `load`, `drive`.
    """

    terms: tuple[Term, ...] = BASE
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    torque_unit: str = "N m"
    is_prismatic: bool = False
    torque_constant: Estimate | None = None
    correlation: tuple[tuple[float, ...], ...] = ()
    log_format: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def build(cls, terms: Sequence[Term], theta: ArrayLike, std: ArrayLike = 0.0, **nonlinear_std: float) -> Self:
        """Build a model from linear parameters and standard errors in the order of the columns.

        Args:
            terms: ordered terms.
            theta: linear parameters (P,).
            std: standard errors of theta, scalar or (P,).
            nonlinear_std: standard errors of nonlinear parameters by `id.name`; default 0.
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
        """Return the columns of the regressor, in order."""
        return tuple(column for term in self.terms for column in term.columns)

    def __getitem__(self, name: str) -> Estimate:
        short_names = {shorten_name(full): estimate for full, estimate in self.estimates.items()}
        return find("parameter", name, {**short_names, **self.estimates})

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
        """Return the ids of the effects: the terms that are not base terms."""
        base = {term.id for term in BASE}
        return tuple(term.id for term in self.terms if term.id not in base)

    @property
    def tables(self) -> dict[str, tuple[Table, TableCurve]]:
        """Return the tables of the model with their curves, by id."""
        tables = [term for term in self.terms if isinstance(term, Table)]
        names, covariance, curves = list(self.estimates), self.assumed_covariance if tables else np.empty((0, 0)), {}
        for term in tables:
            place = [names.index(column.name) for column in term.columns]
            theta = np.array([self.estimates[names[k]].value for k in place])
            curves[term.id] = term, term.curve(theta, covariance[np.ix_(place, place)])
        return curves

    @property
    def readable(self) -> dict[str, Estimate]:
        """Return the estimates for display, with the largest value of a table in place of its coefficients.

        Nonlinear parameters that follow a parameter of another term are left out.
        """
        tables = self.tables
        hidden = {column.name for term, _ in tables.values() for column in term.columns}
        hidden |= {term.get_full_name(p.name) for term in self.terms for p in term.nonlinear_parameters if p.follows}
        readable = {name: estimate for name, estimate in self.estimates.items() if name not in hidden}
        for id, (term, curve) in tables.items():
            k = int(np.argmax(np.abs(curve.value)))
            entry, value, std = self.estimates[term.columns[0].name], float(curve.value[k]), float(curve.std[k])
            readable[f"{id} (largest)"] = replace(entry, value=value, std=std, at_bound=False)
        return readable

    @property
    def covariance(self) -> Array | None:
        """Return the covariance (P + S, P + S) of the estimates, in order, or None if the correlation is unknown."""
        if not self.correlation:
            return None
        std = np.array([estimate.std for estimate in self.estimates.values()])
        covariance = np.array(self.correlation) * np.outer(std > 0, std > 0)
        i, j = np.nonzero(covariance)  # zero times an infinite error is NaN
        covariance[i, j] *= std[i] * std[j]
        return covariance

    @property
    def assumed_covariance(self) -> Array:
        """Return the covariance (P + S, P + S), with zero for unknown correlations."""
        std = np.array([estimate.std for estimate in self.estimates.values()])
        return np.diag(std**2) if self.covariance is None else self.covariance

    def _select_determined(self) -> tuple[list[str], Array]:
        """Return the names of the D estimates with a finite standard error, and their covariance (D, D)."""
        is_finite = np.isfinite([estimate.std for estimate in self.estimates.values()])
        names = [name for name, known in zip(self.estimates, is_finite, strict=True) if known]
        return names, self.assumed_covariance[np.ix_(is_finite, is_finite)]

    def with_covariance(self, names: Sequence[str], covariance: Array) -> Self:
        """Return the model with the correlations of a covariance (Q, Q) of the named parameters."""
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))  # rounding
        has_error = np.outer(std > 0, std > 0)
        correlation = np.where(has_error, covariance, 0.0) / np.maximum(np.outer(std, std), 1e-300)
        place = [list(self.estimates).index(name) for name in names]
        full = np.eye(len(self.estimates))
        full[np.ix_(place, place)] = np.clip(correlation.round(9), -1.0, 1.0)  # equal after writing and reading
        np.fill_diagonal(full, 1.0)
        return replace(self, correlation=tuple(tuple(row) for row in full.tolist()))

    def with_errors(self, names: Sequence[str], covariance: Array) -> Self:
        """Return the model with the standard errors and correlations of a covariance (Q, Q) of the named parameters."""
        errors = zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)
        wider = {name: replace(self.estimates[name], std=std) for name, std in errors}
        return replace(self, estimates={**self.estimates, **wider}).with_covariance(names, covariance)

    def add_errors(self, *changes: Mapping[str, float]) -> Self:
        """Return the model with d d' added to its covariance for each independent change d of parameters, by name.

        Infinite standard errors stay infinite, without correlations.
        """
        names, covariance = self._select_determined()
        steps = np.array([[change.get(name, 0.0) for name in names] for change in changes])
        return self.with_errors(names, covariance + steps.T @ steps) if steps.any() else self

    @property
    def is_undetermined(self) -> bool:
        """Return whether no fitted parameter has a value; known ones and those at a bound do not count."""
        estimates = self.estimates.values()
        return any(each.is_unknown for each in estimates) and all(each.is_unknown or not each.std for each in estimates)

    @property
    def derived(self) -> dict[str, Estimate]:
        """Compute derived parameters, such as `backlash.k`, with standard errors to first order."""
        return derive_estimates(self.terms, self.estimates, self.assumed_covariance, self.units())

    def refuse_present(self, id: str) -> None:
        """Raise a `ModelError` if the model has a term of this id."""
        if id in {term.id for term in self.terms}:
            raise model_file.ModelError(f"the model has '{id}' already: each effect can be added once")

    def add(self, term: Term, theta: ArrayLike = 0.0) -> Self:
        """Return the model with an added term with linear parameters `theta`."""
        self.refuse_present(term.id)
        refuse_contained(self.terms, term)
        addition = Model.build([term], theta)
        estimates = addition.convert_units(self.units()).estimates
        return replace(self, terms=(*self.terms, term), estimates={**self.estimates, **estimates}, correlation=())

    @property
    def mechanism(self) -> Mechanism:
        """Return the mechanism: the joint of a pendulum, or several joints with links."""
        return self.terms[0].mechanism if self.terms else PENDULUM

    def with_values(self, values: Mapping[str, float]) -> Self:
        """Return the model with other values of some parameters, by name."""
        for name, value in values.items():
            find("parameter of the model", name, self.estimates)
            if not np.isfinite(value):
                raise model_file.ModelError(f"{name} of a model cannot be {value:g}: give a number")
        estimates = {name: Estimate(float(value), 0.0, self.estimates[name].unit) for name, value in values.items()}
        terms = set_nonlinear_values(self.terms, values)
        model = replace(self, terms=terms, estimates={**self.estimates, **estimates}, correlation=())
        if "inertia" in values and model.lacks_inertia:
            raise model_file.ModelError(f"inertia of a model cannot be {values['inertia']:g}: give a positive number")
        return model

    def units(self, joint: str = "") -> JointUnits:
        """Return the units of quantities at a joint."""
        return self.mechanism.units(joint, JointUnits(self.torque_unit, self.is_prismatic))

    def convert_units(self, units: JointUnits) -> Self:
        """Return the model with other units of torque or joint; the values are unchanged."""
        pairs = [(term, p) for term in self.terms for p in term.nonlinear_parameters]
        special = {term.get_full_name(p.name): p.get_unit(units) for term, p in pairs}
        estimates = {id: replace(e, unit=special.get(id) or units.unit(e.unit)) for id, e in self.estimates.items()}
        return replace(self, estimates=estimates, torque_unit=units.torque_unit, is_prismatic=units.is_prismatic)

    def get_parameters(self, id: str) -> dict[str, Estimate]:
        """Return the parameters of the term `id` by name."""
        (term,) = (term for term in self.terms if term.id == id)
        return {name: self.estimates[name] for name in term.parameter_names}

    def mark_biased(self) -> Self:
        """Return the model with all estimates marked as biased by a missing effect or noise; known values are none."""
        estimates = {name: replace(e, is_biased=e.std > 0 or e.at_bound) for name, e in self.estimates.items()}
        return replace(self, estimates=estimates)

    def mark_unknown(self, names: Container[str]) -> Self:
        """Return the model with some parameters marked as unknown, because the data do not determine them."""
        estimates = {name: replace(e, is_unknown=True) if name in names else e for name, e in self.estimates.items()}
        return replace(self, estimates=estimates)

    # Names of 1.0.0, kept for one release
    at, of, per, biased, correlated = with_values, get_parameters, convert_units, mark_biased, with_covariance
    withholding = mark_unknown

    def torque(self, x: Samples, acceleration: ArrayLike) -> ArrayLike:
        """Return the torque of the model for a motion [N m]; undefined in stick, so mask these samples."""
        linear = sum(c * column.torque(x, acceleration) for c, column in zip(self.theta, self.columns, strict=True))
        return linear + sum(column.torque(x, acceleration) for term in self.terms for column in term.fixed)

    @property
    def has_known_inertia(self) -> bool:
        """Return whether the inertia is positive and determined by the data; True with links."""
        inertia = self.estimates.get("inertia")
        if inertia is None:
            return any(term.kind == "inertial" for term in self.terms)  # the links
        return not (inertia.is_unknown or self.lacks_inertia)

    @property
    def lacks_inertia(self) -> bool:
        """Return whether the determined inertia is negative, or 0 without the inertia of links beside it."""
        inertia = self.estimates.get("inertia")
        if inertia is None or inertia.is_unknown:
            return False
        return inertia.value < 0 or (inertia.value == 0 and not any(term.has_links for term in self.terms))

    def refuse_unknown_inertia(self) -> None:
        """Refuse a missing or unknown inertia, before a simulation."""
        if self.has_known_inertia:
            return
        if "inertia" not in self.estimates:
            raise model_file.ModelError(NO_INERTIA)
        estimate = replace(self.estimates["inertia"], is_unknown=False)
        raise model_file.ModelError(
            f"the inertia is unknown, the best fit has {estimate}: record faster reversals, or give its value "
            f"({format_setting('fixed', {'inertia': Blank('VALUE')})})"
        )

    def simulate(
        self, period: float, torque: Array, position: ArrayLike, velocity: ArrayLike, start: ArrayLike = 0.0
    ) -> Trajectory:
        """Simulate motion under a held torque command; see `pendulum_env.physics.simulation.simulate`."""
        self.refuse_unknown_inertia()
        return simulate(self.terms, self.theta, period, torque, position, velocity, start)

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        description = model_file.describe_terms(self.terms)
        names, covariance = self._select_determined()
        data: JSON = {
            "schema": model_file.SCHEMA,
            "terms": [term.id for term in self.terms],
            "theta": {name: estimate.json() for name, estimate in self.estimates.items()},
            "tables": description["tables"],
            "torque_unit": "" if self.torque_unit == "N m" else self.torque_unit,
            "slides": self.is_prismatic,
            "torque_constant": None if self.torque_constant is None else self.torque_constant.json(),
            "log_format": dict(self.log_format),
            "limits": description["limits"],
            "covariance": {"parameters": names, "matrix": covariance.tolist()} if names and self.correlation else {},
        }
        return {key: value for key, value in data.items() if value or key in ("terms", "theta")}

    @classmethod
    def from_json(cls, data: JSON) -> Self:
        """Make a model from a dictionary of `json`.

        Raises:
            ModelError: if a term is unknown, or a parameter is missing or invalid.
        """
        try:
            content = model_file.parse_model(data)
            return cls.from_content(content, model_file.build_terms(content))
        except ValueError as error:
            raise model_file.ModelError(str(error)) from None

    @classmethod
    def from_content(cls, content: model_file.ModelFile, terms: Sequence[Term]) -> Self:
        """Make a model of some terms from the content of a model file; raises a ValueError as `from_json`."""
        model = cls.build(terms, 0.0)
        estimates = model_file.read_estimates(
            content, {name: estimate.unit for name, estimate in model.estimates.items()}
        )
        model_file.refuse_excess_friction(model.terms, estimates)
        constant, covariance = content.torque_constant, content.covariance
        model = replace(
            replace(model, estimates=estimates).convert_units(JointUnits(content.torque_unit or "N m", content.slides)),
            torque_constant=None if constant is None else constant.estimate(constant.unit or "N m/A"),
            log_format=content.log_format or {},
        )
        if model.lacks_inertia:
            value = estimates["inertia"].value
            raise model_file.ModelError(f"'theta.inertia.value' is {value:g}: expected a number above zero")
        if covariance is None:
            return model
        determined = [name for name, estimate in estimates.items() if np.isfinite(estimate.std)]
        return model.with_covariance(determined, covariance.read(determined))

    def save(self, path: str | Path) -> None:
        """Write the model as a JSON file."""
        model_file.write_model(path, self.json())

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a model file.

        Raises:
            ModelError: if the file is missing or is not a model; the message names the file.
        """
        content = model_file.read_model(path)
        try:
            return cls.from_json(content)
        except model_file.ModelError as error:
            raise model_file.ModelError(f"{path}: {error}") from None


@singledispatch
def complete_model(mechanism: Mechanism, model: Model) -> Model:
    """Return a model of a mechanism in its own class, by the function that is registered for its type."""
    return model


@singledispatch
def load_model(mechanism: Mechanism, path: str | Path) -> Model:
    """Read a model of a mechanism, by the function that is registered for its type; raises as `Model.load`."""
    return Model.load(path)
