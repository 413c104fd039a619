"""A model of an arm: a rigid body, terms at its joints, and the values of their parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pendulum_env._typing import JSON
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Coupling, Links, at_joint, body_of, coupled
from pendulum_env.physics import Model, ModelError, Term, library
from pendulum_env.physics.model import ARM_SCHEMA, read_estimate
from pendulum_env.physics.table import Table, read_table
from pendulum_env.physics.term import loads
from pendulum_env.reading import Unreadable, Value, read_json

HINT = "an arm's model is what `identify --robot` or `diagnose --robot` write with -o"


@dataclass(frozen=True, eq=False)
class ArmModel(Model):
    """A model whose first term are the links of an arm, with base parameters; the others are at its joints.

    Estimates are named as in `viscous@elbow`, shape parameters as in `stribeck.stribeck_velocity@elbow`. What takes the
    motion of one joint, `torque` and `simulate`, is of no use here.
    """

    @property
    def body(self) -> Body:
        """The links."""
        links = self.terms[0]
        assert isinstance(links, Links)
        return links.body

    def json(self) -> JSON:
        """Plain dictionary for JSON; base parameters also say what they combine."""
        return {
            "schema": ARM_SCHEMA,
            "robot": self.body.name,
            "joints": list(self.body.joints),
            "held": dict(self.body.held),
            "rotors": self.body.rotors,
            "weightless": not self.body.model.gravity.linear.any(),
            "base": {parameter.name: parameter.text for parameter in self.body.base},
            "terms": [
                {"id": own.id.partition("@")[0], "joint": own.at, "shape": own.shape}
                | ({"extent": own.extent._asdict()} if isinstance(own, Table) else {})
                for own in self.terms[1:]
            ],
            "theta": {name: estimate.json() for name, estimate in self.estimates.items()},
        } | ({"log_format": dict(self.log_format)} if self.log_format else {})

    @classmethod
    def load(cls, path: str | Path, body: Body) -> ArmModel:  # type: ignore[override]  # which a file does not tell
        """Read a model of a body.

        Raises:
            ModelError: if the file is missing, is no model of an arm, or is one of another arm.
        """
        try:
            return cls.of_body(read_json(path, HINT), body)
        except (Unreadable, ModelError) as error:
            raise ModelError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None

    @classmethod
    def of_body(cls, content: JSON, body: Body) -> ArmModel:
        """Model of a body from a dictionary that `json` made; raises ModelError, or Unreadable, as `load`."""
        data = Value("the model", "", content)
        if data["schema"].text() != ARM_SCHEMA:
            raise ModelError(f"is no model of an arm; {HINT}")
        joints = [joint.text() for joint in data["joints"].items(1000)]
        if tuple(joints) != body.joints:
            raise ModelError(f"is of an arm with joints {', '.join(joints)}, not {', '.join(body.joints)}")
        base = data["base"].content
        if base != {parameter.name: parameter.text for parameter in body.base}:
            raise ModelError(
                "is of other links than this robot has: give the file that it was made with, --rotors as then"
            )
        theta = data["theta"]
        known = theta.content if isinstance(theta.content, dict) else {}
        terms = [
            _term(item, body, f"coupling.inertia@{item['joint'].text()}" in known) for item in data["terms"].items(1000)
        ]
        model = cls.build((Links(body), *terms), 0.0)
        log_format = data.get("log_format")
        return replace(
            model,
            estimates={name: read_estimate(theta[name], own.unit) for name, own in model.estimates.items()},
            log_format={} if log_format is None else log_format.table(),
        )


def model_of(model: Model) -> Model:
    """A model as that of an arm, if links are the first of its terms."""
    if body_of(model.terms) is None:
        return model
    return ArmModel(model.terms, model.estimates, correlation=model.correlation)


@dataclass(frozen=True)
class Asked:
    """How a model was made: which joints of the robot move, where others are held, and so on; how logs were read."""

    joints: tuple[str, ...] | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    rotors: bool | None = None
    weightless: bool = False
    log_format: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_model(cls, path: str | Path) -> Asked:
        """As the file of a model tells; nothing if it is none."""
        try:
            data = Value("the model", "", read_json(path, HINT))
            still, rotors, light, read = (data.get(name) for name in ("held", "rotors", "weightless", "log_format"))
            places = still.content if still is not None and isinstance(still.content, dict) else {}
            held = {name: Value("the model", f"held.{name}", position).number() for name, position in places.items()}
            joints = tuple(joint.text() for joint in data["joints"].items(1000)) if held else None
            log_format = {} if read is None else read.table()
        except Unreadable:
            return cls()  # who loads it says why
        has_rotors = rotors.content if rotors is not None and isinstance(rotors.content, bool) else None
        return cls(joints, held, has_rotors, light is not None and light.content is True, log_format)


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
