"""A model of an arm: a rigid body, terms at its joints, and the values of their parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pendulum_env._typing import JSON, Array, ArrayLike
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Coupling, Links, at_joint, coupled
from pendulum_env.files import write_whole
from pendulum_env.physics import Estimate, Model, ModelError, Term, library
from pendulum_env.physics.model import ARM_SCHEMA
from pendulum_env.physics.table import Table, read_table
from pendulum_env.physics.term import loads
from pendulum_env.reading import Unreadable, Value, read_json

HINT = "an arm's model is what `identify --robot` or `diagnose --robot` write with -o"


@dataclass(frozen=True, eq=False)
class ArmModel:
    """Base parameters of a body and terms at its joints.

    Attributes:
        body: the links.
        terms: at joints, in the order of their parameters.
        estimates: every parameter by name: base parameters first, then `viscous@elbow`, and shape parameters such as
            `stribeck.stribeck_velocity@elbow`.
        log_format: how the recordings that it was fitted to were read, as that of `Model`.
    """

    body: Body
    terms: tuple[Term, ...]
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    log_format: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def build(
        cls,
        body: Body,
        terms: Sequence[Term],
        theta: ArrayLike,
        std: ArrayLike = 0.0,
        shape_std: Mapping[str, float] | None = None,
    ) -> ArmModel:
        """Model from linear parameters theta (P,) and their standard errors, base parameters first.

        Args:
            body: the links.
            terms: at joints.
            theta: linear parameters (P,).
            std: their standard errors, scalar or (P,).
            shape_std: standard errors of shape parameters by `id.shape@joint`, where known.
        """
        whole = Model.build((Links(body), *terms), theta, std, **(shape_std or {}))
        return cls(body, tuple(terms), whole.estimates)

    @property
    def theta(self) -> Array:
        """Linear parameters (P,), base parameters first."""
        return np.array([self.estimates[name].value for name in parameter_names(self.body, self.terms)])

    def of(self, id: str) -> dict[str, Estimate]:
        """Parameters of one of the terms, by name."""
        (term,) = (own for own in self.terms if own.id == id)
        names = Model.build([term], np.zeros(len(term.columns))).estimates
        return {name: self.estimates[name] for name in names}

    def biased(self) -> ArmModel:
        """The same model, known to lack something that no term explains."""
        return replace(self, estimates={name: replace(e, is_biased=True) for name, e in self.estimates.items()})

    def json(self) -> JSON:
        """Plain dictionary for JSON; base parameters also say what they combine."""
        told = {"log_format": dict(self.log_format)} if self.log_format else {}
        return {
            "schema": ARM_SCHEMA,
            "robot": self.body.name,
            "joints": list(self.body.joints),
            "held": dict(self.body.held),
            "rotors": self.body.rotors,
            "base": {parameter.name: parameter.text for parameter in self.body.base},
            "terms": [
                {"id": own.id.partition("@")[0], "joint": own.at, "shape": own.shape}
                | ({"extent": own.extent._asdict()} if isinstance(own, Table) else {})
                for own in self.terms
            ],
            "theta": {name: estimate.json() for name, estimate in self.estimates.items()},
        } | told

    def save(self, path: str | Path) -> None:
        """Write JSON, whole or not at all."""
        write_whole(path, json.dumps(self.json(), indent=1) + "\n")

    @classmethod
    def load(cls, path: str | Path, body: Body) -> ArmModel:
        """Read a model of a body.

        Raises:
            ModelError: if the file is missing, is no model of an arm, or is one of another arm.
        """
        try:
            data = Value("the model", "", read_json(path, HINT))
            if data["schema"].text() != ARM_SCHEMA:
                raise ModelError(f"is no model of an arm; {HINT}")
            joints = [joint.text() for joint in data["joints"].items(1000)]
            if tuple(joints) != body.joints:
                raise ModelError(f"is of an arm with joints {', '.join(joints)}, not {', '.join(body.joints)}")
            base = data["base"].content
            if base != {parameter.name: parameter.text for parameter in body.base}:
                raise ModelError("is of an arm with other links, or with rotors where this has none, or without")
            theta = data["theta"]
            told = theta.content if isinstance(theta.content, dict) else {}
            terms = tuple(
                _term(item, body, f"coupling.inertia@{item['joint'].text()}" in told)
                for item in data["terms"].items(1000)
            )
            names = parameter_names(body, terms)
            values = [theta[name]["value"].number() for name in names]
            errors = [theta[name]["std"].number(0.0) for name in names]
            shapes = [own.full(shape.name) for own in terms for shape in own.free]
            shape_std = {name: theta[name]["std"].number(0.0) for name in shapes}
            biased = any(theta[name].get("biased") is not None for name in names)
            log_format = data.get("log_format")
            read = {} if log_format is None else log_format.table()
        except (Unreadable, ModelError) as error:
            raise ModelError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None
        model = replace(cls.build(body, terms, np.array(values), np.array(errors), shape_std), log_format=read)
        return model.biased() if biased else model


@dataclass(frozen=True)
class Asked:
    """How a model was made: which joints of the robot move, where others are held, rotors, and how logs were read."""

    joints: tuple[str, ...] | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    rotors: bool | None = None
    log_format: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_model(cls, path: str | Path) -> Asked:
        """As the file of a model tells; nothing if it is none."""
        try:
            data = Value("the model", "", read_json(path, HINT))
            still, rotors, read = (data.get(name) for name in ("held", "rotors", "log_format"))
            told = still.content if still is not None and isinstance(still.content, dict) else {}
            held = {name: Value("the model", f"held.{name}", position).number() for name, position in told.items()}
            joints = tuple(joint.text() for joint in data["joints"].items(1000)) if held else None
            log_format = {} if read is None else read.table()
        except Unreadable:
            return cls()  # who loads it says why
        has_rotors = rotors.content if rotors is not None and isinstance(rotors.content, bool) else None
        return cls(joints, held, has_rotors, log_format)


def parameter_names(body: Body, terms: Sequence[Term]) -> tuple[str, ...]:
    """Names of the linear parameters, base parameters first."""
    return (*body.names, *(column.name for own in terms for column in own.columns))


def _term(item: Value, body: Body, is_heavy: bool) -> Term:
    joint, shape = item["joint"].text(), item["shape"]
    for place in loads(joint):
        if place not in body.joints:
            raise ModelError(f"has a term at joint '{place}', the robot has {', '.join(body.joints)}")
    if item["id"].text() == Coupling.id:
        return coupled(joint, is_heavy)()
    kind = library.term(item["id"].text())
    values = {known.name: shape[known.name].number(known.low, known.high) for known in kind.shapes}
    there = at_joint(kind, joint, body.slides[body.joints.index(joint)])
    return read_table(there, item["extent"]) if issubclass(there, Table) else there(**values)
