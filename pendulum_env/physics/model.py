"""A model: an ordered list of terms and the values of their parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pendulum_env._typing import JSON, Array, ArrayLike
from pendulum_env.files import write_whole
from pendulum_env.physics import library
from pendulum_env.physics.base import BASE
from pendulum_env.physics.simulation import Trajectory, simulate
from pendulum_env.physics.term import Column, Samples, Term
from pendulum_env.words import plus_minus

SCHEMA = "pendulum-ident/model@1"


class ModelError(ValueError):
    """A model or model file that makes no sense; the message says where and what to do."""


@dataclass(frozen=True)
class Estimate:
    """Value of a parameter with its standard error, both in `unit`; the error is 0 where nothing was estimated."""

    value: float
    std: float
    unit: str

    def __str__(self) -> str:
        return f"{plus_minus(self.value, self.std)} {self.unit}"

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {"value": self.value, "std": self.std, "unit": self.unit}


@dataclass(frozen=True)
class Model:
    """Terms and parameters of the torque balance.

    Attributes:
        terms: ordered terms; a term's shape parameters are fields of the term.
        estimates: every parameter by name: linear ones by the name of their column, shape parameters as `id.shape`.
    """

    terms: tuple[Term, ...] = BASE
    estimates: Mapping[str, Estimate] = field(default_factory=dict)

    @classmethod
    def build(cls, terms: Sequence[Term], theta: ArrayLike, std: ArrayLike = 0.0, **shape_std: float) -> Model:
        """Model from linear parameters theta (P,) and their standard errors, in the order of the terms' columns.

        Args:
            terms: ordered terms.
            theta: linear parameters (P,).
            std: their standard errors, scalar or (P,).
            shape_std: standard errors of shape parameters by `id.shape`, where known.
        """
        columns = [column for term in terms for column in term.columns]
        values = np.broadcast_to(np.asarray(theta, dtype=float), (len(columns),))
        errors = np.broadcast_to(np.asarray(std, dtype=float), (len(columns),))
        estimates = {
            c.name: Estimate(float(v), float(s), c.unit) for c, v, s in zip(columns, values, errors, strict=True)
        }
        for term in terms:
            for shape in term.free:
                name = f"{term.id}.{shape.name}"
                estimates[name] = Estimate(term.shape[shape.name], shape_std.get(name, 0.0), shape.unit)
        return cls(tuple(terms), estimates)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the regressor in order."""
        return tuple(column for term in self.terms for column in term.columns)

    @property
    def theta(self) -> Array:
        """Linear parameters (P,) in the order of the columns."""
        return np.array([self.estimates[column.name].value for column in self.columns])

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the terms beyond the base."""
        base = {term.id for term in BASE}
        return tuple(term.id for term in self.terms if term.id not in base)

    def add(self, term: Term, theta: ArrayLike = 0.0) -> Model:
        """Model with one more term, its linear parameters at `theta`; fit it to recordings to get real values.

        Raises:
            ModelError: if the model has a term of that id already.
        """
        if term.id in {old.id for old in self.terms}:
            raise ModelError(f"the model has '{term.id}' already: each effect can be added once")
        added = Model.build([term], theta)
        return Model((*self.terms, term), {**self.estimates, **added.estimates})

    def at(self, theta: Mapping[str, float]) -> Model:
        """The same terms with some linear parameters, by name, at other values.

        Raises:
            ModelError: if a parameter is unknown.
        """
        linear = {column.name: column for column in self.columns}
        for name in theta:
            if name not in linear:
                raise ModelError(f"the model has no linear parameter '{name}': it has {', '.join(linear)}")
            if not np.isfinite(theta[name]) or (name == "inertia" and theta[name] <= 0):
                raise ModelError(f"{name} of a model cannot be {theta[name]:g}: give a positive number")
        new = {name: Estimate(float(value), 0.0, linear[name].unit) for name, value in theta.items()}
        return Model(self.terms, {**self.estimates, **new})

    def torque(self, x: Samples, acceleration: ArrayLike) -> ArrayLike:
        """Torque that the model needs for a motion [N m]; samples in stick have no answer, mask them."""
        linear = sum(c * column.torque(x, acceleration) for c, column in zip(self.theta, self.columns, strict=True))
        return linear + sum(column.torque(x, acceleration) for term in self.terms for column in term.fixed)

    def simulate(
        self, period: float, torque: Array, position: ArrayLike, velocity: ArrayLike, start: ArrayLike = 0.0
    ) -> Trajectory:
        """Motion in free run under a held torque command; see `pendulum_env.physics.simulation.simulate`."""
        return simulate(self.terms, self.theta, period, torque, position, velocity, start)

    def _repr_html_(self) -> str:
        from pendulum_env.notebook import show_model  # only a notebook asks for it

        return show_model(self)

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "schema": SCHEMA,
            "terms": [term.id for term in self.terms],
            "theta": {name: estimate.json() for name, estimate in self.estimates.items()},
        }

    @classmethod
    def from_json(cls, data: JSON) -> Model:
        """Model from a dictionary that `json` made.

        Raises:
            ModelError: if a term is unknown or a parameter is missing or not a finite number.
        """
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            raise ModelError(f"this is not a model: 'schema' should be {SCHEMA}")
        estimates: dict[str, Estimate] = {}
        terms: list[Term] = []
        try:
            for id in data["terms"]:
                kind = library.term(id)
                told = [s for s in kind.shapes if s.usual is None or f"{id}.{s.name}" in data["theta"]]
                shape = {s.name: float(data["theta"][f"{id}.{s.name}"]["value"]) for s in told}
                for s in told:
                    value = shape[s.name]
                    if not np.isfinite(value):
                        continue  # refused below, with all others
                    if not (s.low <= value <= s.high and (value.is_integer() or not s.integer)):
                        allowed = f"{'a whole number ' if s.integer else ''}from {s.low:g} to {s.high:g}"
                        raise ModelError(f"'{id}.{s.name}' is {value:g}, it has to be {allowed} {s.unit}")
                terms.append(kind(**shape))
            parameters = Model.build(terms, 0.0).estimates
            for name, default in parameters.items():
                entry = data["theta"][name]
                estimates[name] = Estimate(float(entry["value"]), float(entry.get("std", 0.0)), default.unit)
        except KeyError as error:
            raise ModelError(f"the model lacks {error}: every term needs its parameters under 'theta'") from None
        except (TypeError, AttributeError):
            raise ModelError(
                "the model is not laid out as 'terms' (ids) and 'theta' (name: value, std, unit)"
            ) from None
        except ValueError as error:
            raise ModelError(str(error)) from None
        if len({term.id for term in terms}) != len(terms):
            raise ModelError("the model names a term twice: each may appear once")
        if not np.isfinite([[e.value, e.std] for e in estimates.values()]).all():
            raise ModelError("the model holds a parameter that is not a finite number")
        return cls(tuple(terms), estimates)

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
            data = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise ModelError(f"{path}: cannot be read ({error.strerror})") from None
        except (json.JSONDecodeError, UnicodeDecodeError):
            raise ModelError(
                f"{path}: is not JSON; a model file is what `identify -o` or `diagnose -o` writes"
            ) from None
        try:
            return cls.from_json(data)
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from None
