"""Model of an arm: rigid body, terms at joints, and parameter values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msgspec import Struct, structs

from pendulum_env._typing import JSON
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import FRICTION, Links, find_kind, find_links, joint_effects
from pendulum_env.errors import FileError, UserError
from pendulum_env.physics import Model, ModelError, Term
from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.physics.model_file import ARM_SCHEMA, check_value, read_estimate
from pendulum_env.physics.table import TABLES, Table, read_table
from pendulum_env.reading import Number, Text, convert, read_json
from pendulum_env.settings import format_setting

HINT = "identify or diagnose the arm to have one"


@dataclass(frozen=True, eq=False, repr=False)
class ArmModel(Model):
    """Model of an arm: `Links` as its first term, then terms at joints.

    Estimates are named `viscous@elbow`, nonlinear parameters `stribeck.stribeck_velocity@elbow`. The
    methods of one joint, `torque` and `simulate`, do not apply.
    """

    @property
    def body(self) -> Body:
        """Return the body of the links."""
        return find_links(self.terms)

    def json(self) -> JSON:
        """Return a dictionary for JSON, with the combinations of base parameters."""
        return {
            "schema": ARM_SCHEMA,
            "robot": self.body.name,
            "joints": list(self.body.joints),
            "held": dict(self.body.held),
            "rotors": self.body.rotors,
            "weightless": not self.body.model.gravity.linear.any(),
            "base": {parameter.name: parameter.text for parameter in self.body.base},
            "terms": [
                {"id": term.id.partition("@")[0], "joint": term.at, "shape": term.nonlinear_values}
                | ({"extent": term.extent._asdict()} if isinstance(term, Table) else {})
                for term in self.terms[1:]
            ],
            "theta": {name: estimate.json() for name, estimate in self.estimates.items()},
            **({"log_format": dict(self.log_format)} if self.log_format else {}),
        }

    @classmethod
    def load(cls, path: str | Path, body: Body) -> ArmModel:  # type: ignore[override]  # the file lacks the body
        """Read a model of a body.

        Raises:
            ModelError: if the file is missing, or is not a model of this arm.
        """
        try:
            return cls.from_json_of_body(read_json(path, HINT), body)
        except UserError as error:
            raise ModelError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None

    @classmethod
    def from_json_of_body(cls, content: JSON, body: Body) -> ArmModel:
        """Make a model of a body from a dictionary of `json`; raises a UserError as `load`."""
        if not isinstance(content, dict) or content.get("schema") != ARM_SCHEMA:
            raise ModelError(f"is no model of an arm; {HINT}")
        data = convert(content, _ArmModelFile)
        if data.joints != body.joints:
            raise ModelError(f"is of an arm with joints {', '.join(data.joints or ())}, not {', '.join(body.joints)}")
        if data.base != {parameter.name: parameter.text for parameter in body.base}:
            raise ModelError(
                "is of other links than this robot has: give the file that it was made with, and "
                f"{format_setting('rotors', True)} as then"
            )
        terms = [_build_term(k, data, body) for k in range(len(data.terms))]
        for k, term in enumerate(terms):
            if term.id in {other.id for other in terms[:k]}:
                raise ModelError(f"'terms[{k}]' is {term.id} again: each term may appear once")
        model = cls.build((Links(body), *terms), 0.0)
        return replace(
            model,
            estimates={
                name: read_estimate(data.theta, name, estimate.unit) for name, estimate in model.estimates.items()
            },
            log_format=data.log_format,
        )


class ModelOptions(Struct, frozen=True):
    """Options of a model file: moving and held joints, rotors, gravity and log format."""

    joints: tuple[Text, ...] | None = None
    held: dict[str, Number] = {}
    rotors: bool | None = None
    weightless: bool = False
    log_format: dict[str, Any] = {}

    @classmethod
    def read_from_model(cls, path: str | Path | None) -> ModelOptions:
        """Read the options from a model file; empty without one, or if the file is not a model."""
        if not path:
            return cls()
        try:
            found = convert(read_json(path, HINT), cls)
        except FileError:
            return cls()  # `load` raises the error
        return found if found.held else structs.replace(found, joints=None)


class _ArmTerm(Struct):
    """Term at a joint in the model file of an arm."""

    id: Text
    joint: Text
    shape: dict[str, Any]
    extent: dict[str, Any] | None = None


class _ArmModelFile(ModelOptions, frozen=True, kw_only=True):
    """Content of the model file of an arm."""

    robot: Text | None = None
    base: dict[str, Any]
    terms: list[_ArmTerm]
    theta: dict[str, Any]


def make_arm_model(model: Model) -> Model:
    """Convert a model to an `ArmModel` if its first term is `Links`."""
    if not isinstance(model.body, Body):
        return model
    return ArmModel(model.terms, model.estimates, correlation=model.correlation)


def load_model(path: str | Path, body: Mechanism) -> Model:
    """Read the model of a pendulum or of an arm; raises ModelError as `Model.load` and `ArmModel.load`."""
    return ArmModel.load(path, body) if isinstance(body, Body) else Model.load(path)


def _build_term(k: int, data: _ArmModelFile, body: Body) -> Term:
    """Build term k of a model file, counted from 0."""
    item, place = data.terms[k], f"terms[{k}]"
    known = joint_effects() | TABLES | {term.id: type(term) for term in FRICTION}
    try:
        kind = find_kind(f"{item.id}@{item.joint}", body, known)
    except UserError as error:
        raise ModelError(f"'{place}': {error}") from None
    if issubclass(kind, Table):
        return read_table(kind, item.extent, f"{place}.extent")
    values = {}
    for parameter in kind.nonlinear_parameters:
        if parameter.name not in item.shape:
            raise ModelError(f"'{place}.shape' lacks '{parameter.name}'")
        at = f"{place}.shape.{parameter.name}"
        values[parameter.name] = check_value(parameter, convert(item.shape[parameter.name], float, at), at)
    term = kind(**values)
    if term.fault:
        raise ModelError(f"'{place}' makes no sense: {term.fault}")
    return term
