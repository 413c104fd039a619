"""Model of an arm of servos: the model of each joint's servo, in the unit of its drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from msgspec import Struct

from pendulum_env._typing import JSON
from pendulum_env.physics import Column, Model, ModelError, Term
from pendulum_env.physics.joints import Links, place_effect
from pendulum_env.physics.library import find_term
from pendulum_env.physics.mechanism import LinkedMechanism, Mechanism
from pendulum_env.physics.model_file import ModelFile, build_terms
from pendulum_env.reading import Number, Text, convert
from robots.servo_arms.links import (
    SERIES,
    LinkTable,
    LinkTorque,
    find_table,
    list_names,
    make_link_torque,
    remove_weight,
)

SCHEMA = "pendulum-ident/servo-arm@1"


@dataclass(frozen=True)
class MeasuredLinks(Links):
    """Links of an arm whose joints are simulated one by one; parameters are those of the joints' terms."""

    id = "measured_links"
    law = ""

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Return no columns."""
        return ()


@dataclass(frozen=True, eq=False, repr=False)
class ServoArmModel(Model):
    """Model of an arm of servos; estimates have names such as `viscous@elbow`.

    Attributes:
        servos: model of the servo at each joint.
    """

    servos: Mapping[str, Model] = field(default_factory=dict)

    @classmethod
    def join(cls, servos: Mapping[str, Model], body: Mechanism) -> ServoArmModel:
        """Join the models of the servos at the joints of a body."""
        assert isinstance(body, LinkedMechanism)
        terms: list[Term] = [MeasuredLinks(body)]
        for at, model in servos.items():
            terms += [place_effect(type(term), at)(**term.nonlinear_values) for term in model.terms]
        estimates = {f"{name}@{at}": one for at, model in servos.items() for name, one in model.estimates.items()}
        first = next(iter(servos.values()))
        return cls(tuple(terms), estimates, first.torque_unit, servos=servos)

    def json(self) -> JSON:
        """Return a dictionary for JSON: that of a model, with the models of the servos."""
        content = super().json()
        servos = {at: model.json() for at, model in self.servos.items()}
        tables = {at: table for at, model in self.servos.items() if (table := find_table(model.terms)) is not None}
        shares = {at: table.shares.round(9).tolist() for at, table in tables.items()}
        return content | {"schema": SCHEMA, "joints": list(self.servos), "servos": servos, "link_shares": shares}

    @classmethod
    def from_json_of_body(cls, content: JSON, body: LinkedMechanism) -> ServoArmModel:
        """Make a model of a body from a dictionary of `json`; raises a UserError if it is invalid."""
        file = convert(content, _ServoArmFile)
        if file.joints != body.joints:
            raise ModelError(f"is of an arm with joints {', '.join(file.joints)}, not {', '.join(body.joints)}")
        models = {}
        for at, servo in file.servos.items():
            data = convert(servo, ModelFile)
            names = tuple(name.partition(".")[2] for name in data.theta if name.startswith(f"{LinkTorque.id}."))
            if foreign := [name for name in names if name not in list_names(body.names)]:
                raise ModelError(
                    f"{LinkTorque.id}.{foreign[0]} at '{at}' is of other links than this robot has: give the robot "
                    "file that it was made with"
                )
            shares = np.array(file.link_shares.get(at, []), ndmin=2)
            if shares.shape != (len(names) + 1, len(body.names)):
                shares = np.empty((0, 0))  # of an earlier version
            table = LinkTable(names, np.zeros(1), np.zeros((1, SERIES * len(names))), shares)
            weight = make_link_torque(LinkTorque, table)
            terms = build_terms(data, lambda id: weight if id == LinkTorque.id else remove_weight(find_term(id)))  # noqa: B023
            models[at] = Model.from_content(data, terms)
        return replace(cls.join(models, body), log_format=file.log_format)


class _ServoArmFile(Struct):
    """Content of the model file of an arm of servos."""

    joints: tuple[Text, ...]
    servos: dict[str, Any]
    log_format: dict[str, Any] = {}
    link_shares: dict[str, list[list[Number]]] = {}
