"""Model of an arm: rigid body, terms at joints, and parameter values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msgspec import Struct

from estimators.data.preparation import list_preparations
from pendulum_env._typing import JSON
from pendulum_env.errors import UserError
from pendulum_env.physics import Model, ModelError
from pendulum_env.physics.joints import FRICTION, Links, find_kind, list_joint_effects
from pendulum_env.physics.model import complete_model, load_model
from pendulum_env.physics.model_file import ARM_SCHEMA, OLD_ARM_SCHEMA, ModelFile, build_terms
from pendulum_env.physics.table import TABLES
from pendulum_env.reading import Text, convert, read_json
from pendulum_env.robot_file import HINT, RobotOptions
from pendulum_env.settings import format_setting
from robots.arms.body import Body, find_body


@dataclass(frozen=True, eq=False, repr=False)
class ArmModel(Model):
    """Model of an arm: `Links` as its first term, then terms at joints.

    Estimates have names such as `viscous@elbow`, nonlinear parameters such as `stribeck.stribeck_velocity@elbow`. The
    methods of one joint, `torque` and `simulate`, do not apply.
    """

    @property
    def body(self) -> Body:
        """Return the body of the links."""
        return find_body(self.terms)

    @property
    def mechanism(self) -> Body:
        """Return the body of the links."""
        return self.body

    def json(self) -> JSON:
        """Return a dictionary for JSON: that of a model, with the robot and the combinations of base parameters."""
        content = super().json()
        return content | {
            "schema": ARM_SCHEMA,
            "terms": [id for id in content["terms"] if id != Links.id],
            "robot": self.body.name,
            "joints": list(self.body.joints),
            "held": dict(self.body.held),
            "rotors": self.body.rotors,
            "weightless": not self.body.model.gravity.linear.any(),
            "base": {parameter.name: parameter.text for parameter in self.body.base},
        }

    @classmethod
    def load(cls, path: str | Path, body: Body) -> ArmModel:  # type: ignore[override]  # the file lacks the body
        """Read a model of a body.

        Raises:
            ModelError: if the file is missing, or is not a model of this arm.
        """
        try:
            content = read_json(path, HINT)
            schema = content.get("schema") if isinstance(content, dict) else None
            others = {name: make for item in list_preparations() for name, make in item.models.items()}
            return others.get(str(schema), cls.from_json_of_body)(content, body)
        except UserError as error:
            raise ModelError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None

    @classmethod
    def from_json_of_body(cls, content: JSON, body: Body) -> ArmModel:
        """Make a model of a body from a dictionary of `json`; raises a UserError as `load`."""
        schema = content.get("schema") if isinstance(content, dict) else None
        if schema not in (ARM_SCHEMA, OLD_ARM_SCHEMA):
            raise ModelError(f"is no model of an arm; {HINT}")
        arm = convert(content, _ArmFile)
        if arm.joints != body.joints:
            raise ModelError(f"is of an arm with joints {', '.join(arm.joints or ())}, not {', '.join(body.joints)}")
        if arm.base != {parameter.name: parameter.text for parameter in body.base}:
            raise ModelError(
                "is of other links than this robot has: give the file that it was made with, and "
                f"{format_setting('rotors', True)} as then"
            )
        data = convert(content if schema == ARM_SCHEMA else _convert_old_terms(content), ModelFile)
        library = list_joint_effects() | TABLES | {term.id: type(term) for term in FRICTION}
        terms = build_terms(data, lambda id: find_kind(id, body, library))
        return cls.from_content(data, (Links(body), *terms))


class _ArmFile(RobotOptions, frozen=True, kw_only=True):
    """Content of the model file of an arm, in addition to that of each model."""

    base: dict[str, Any]


class _OldTerm(Struct):
    """Term at a joint in a model file of version 1.0."""

    id: Text
    joint: Text
    shape: dict[str, Any]
    extent: dict[str, Any] | None = None


class _OldTerms(Struct):
    """Terms and parameters in a model file of version 1.0."""

    terms: list[_OldTerm]
    theta: dict[str, Any]


def _convert_old_terms(content: JSON) -> JSON:
    """Return the content of a model file of version 1.0 in the present form."""
    file = convert(content, _OldTerms)
    values = {f"{term.id}.{name}@{term.joint}": {"value": x} for term in file.terms for name, x in term.shape.items()}
    tables = {f"{term.id}@{term.joint}": term.extent for term in file.terms if term.extent is not None}
    terms = [f"{term.id}@{term.joint}" for term in file.terms]
    return content | {"terms": terms, "theta": values | file.theta, "tables": tables}


@complete_model.register
def _complete_model(mechanism: Body, model: Model) -> Model:
    """Return a model of an arm as an `ArmModel`."""
    return ArmModel(model.terms, model.estimates, correlation=model.correlation)


@load_model.register
def _load_model(mechanism: Body, path: str | Path) -> Model:
    """Read the model of an arm; raises as `ArmModel.load`."""
    return ArmModel.load(path, mechanism)
