"""Check a user's effect before it is registered: texts, columns and laws."""

import re
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from functools import partial
from typing import Any, TypeVar, get_args

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.errors import UserError, format_error
from pendulum_env.lookup import find
from pendulum_env.physics.base import BASE
from pendulum_env.physics.term import ROOM, Column, Kind, NonlinearParameter, Samples, Term, return_zero
from pendulum_env.reading import quote_value

T = TypeVar("T")
LAWS = ("mass", "force", "dry", "potential", "loss")
FORMER_NAMES = {  # names of release 1.0.0 and their replacements
    "shapes": "nonlinear_parameters",
    "typical": "typical_size",
    "grid": "set_hints",
    "looked_at": "set_hints",
    "possible": "set_hints",
    "title": "description",
}
STEP, CLOSE = 1e-5, 1e-4  # [rad], step to differentiate a potential; relative tolerance of a force


def check_effect(kind: type[Term]) -> None:
    """Check the class of an effect, with each law evaluated on synthetic motion.

    Raises:
        UserError: with the class and the invalid field or law. A law is invalid if it fails, has no torque, equals that
            of a base term, lacks or contradicts its potential, or is dissipative but gains energy.
    """
    if not (isinstance(kind, type) and issubclass(kind, Term)):
        raise UserError(f"{quote_value(kind)} is no effect: register a subclass of Term")
    name = kind.__name__
    for text in ("id", "law", "kind"):
        if not isinstance(value := getattr(kind, text, None), str):
            raise UserError(f"{text} of {name} is {quote_value(value)}: it has to be a text")
    for former, present in FORMER_NAMES.items():
        if hasattr(kind, former):
            raise UserError(f"{former} of {name} is a name of release 1.0.0: use {present}")
    if not re.fullmatch(r"[\w-]+", kind.id):
        raise UserError(f"id of {name} is {quote_value(kind.id)}: use letters, digits and underscores")
    find(f"kind of {name}", kind.kind, dict.fromkeys(get_args(Kind)))
    _check_all(kind.nonlinear_parameters, NonlinearParameter, f"nonlinear_parameters of {name}")
    for parameter in kind.nonlinear_parameters:
        if parameter.name not in {field.name for field in fields(kind)}:
            raise UserError(
                f"nonlinear parameter '{parameter.name}' of {name} is no field of the dataclass: declare "
                f"'{parameter.name}: float = ...', and put @register above @dataclass(frozen=True)"
            )
    check_variants(f"{name}()", lambda x: (kind(),))
    _check_torque(kind())


def check_variants(label: str, variants: Callable[[Samples], Iterable[Term]]) -> None:
    """Evaluate the laws of variants of an effect on synthetic motions; `variants` makes them from the motion."""
    for samples in (1000, 37):
        time: Array = np.arange(samples) / 100.0
        x = Samples(time, np.sin(time), np.cos(time), np.sin(3 * time))
        for term in _call_user_function(label, partial(lambda x: [*variants(x)], x)):
            _try_laws(term, x)


def _try_laws(term: Term, x: Samples) -> None:
    """Evaluate all laws of a term on samples, and advance its states by one step."""
    name = type(term).__name__
    if term.has_memory:
        memory = _call_user_function(f"start of {name}", lambda: term.start(x))
        after = _call_user_function(f"advance of {name}", lambda: term.advance(memory, x, 0.01))
        if len(after) != len(memory):
            raise UserError(f"advance of {name} returns {len(after)} state variables, and start {len(memory)}")
        x = replace(x, memory=term.name_memory(memory))
    for field in ("columns", "fixed"):
        columns = _call_user_function(f"{field} of {name}", partial(getattr, term, field))
        _check_all(columns, Column, f"{field} of {name}")
        for column in columns:
            if column.name.partition(".")[0] != term.id or not isinstance(column.unit, str):
                raise UserError(
                    f"a column of {name} is named {quote_value(column.name)} with unit "
                    f"{quote_value(column.unit)}: name it "
                    f"'{term.id}' or '{term.id}.PART', and give its unit as a text"
                )
            for law in LAWS:
                if (function := getattr(column, law)) is not None:
                    _try_law(f"{law} of column '{column.name}' of {name}", function, x)
            _check_potential(f"column '{column.name}' of {name}", column, x)


def _check_potential(label: str, column: Column, x: Samples) -> None:
    """Refuse a force that differs from dU/dq + loss."""
    if (potential := column.potential) is not None:
        ahead, behind = (potential(replace(x, position=x.position + step)) for step in (STEP, -STEP))
        slope, force = np.subtract(ahead, behind) / (2 * STEP), np.subtract(column.force(x), column.loss(x))
        if np.max(np.abs(force - slope)) > CLOSE * max(np.max(np.abs(force)), np.max(np.abs(slope))):
            lacks_force = column.force is return_zero and column.loss is return_zero
            fault = "has a potential U but no force" if lacks_force else "has a force that is not dU/dq + loss"
            raise UserError(f"{label} {fault}: give force = dU/dq of its potential, plus its loss if it has one")


def _check_torque(term: Term) -> None:
    """Refuse zero torque, the law of a base term and negative dissipation, on independent random quantities."""
    name, columns = type(term).__name__, (*term.columns, *term.fixed)
    position, velocity, torque, warmth = np.random.default_rng(0).uniform(-20.0, 20.0, (4, 300))
    x = Samples(np.linspace(0.0, 100.0, 300), position, velocity, torque, temperature=ROOM + warmth)
    if term.has_memory:
        x = replace(x, memory=term.name_memory(term.start(x)))
    torques = _call_user_function(f"columns of {name}", lambda: [_split_torque(column, x) for column in columns])
    if term.nonlinear_parameters:  # their defaults may give zero torque, as an infinite stop
        has_torque = any(law is not return_zero for c in columns for law in (c.mass, c.force, c.dry))
    else:
        has_torque = any(map(np.any, torques))
    if not has_torque and type(term).delay is Term.delay and type(term).lead is Term.lead:
        raise UserError(f"{name} has no torque: give it columns with a mass, force or dry that is not zero")
    for column, parts in zip(columns, torques, strict=True):
        if term.kind == "potential" and column.potential is None:
            raise UserError(
                f"column '{column.name}' of {name} is of kind 'potential' and has no potential: give U(q) with "
                "force = dU/dq, or another kind"
            )
        power = _call_user_function(f"columns of {name}", partial(column.power, x))
        if term.kind == "dissipative" and np.max(power) <= 0 > np.min(power):
            raise UserError(f"column '{column.name}' of {name} gains energy in every motion: change its sign")
        for base in (base for base_term in BASE for base in base_term.columns if not term.has_memory):
            known = _split_torque(base, x)
            if np.any(parts) and np.allclose(parts, np.vdot(parts, known) / np.vdot(known, known) * known):
                raise UserError(f"column '{column.name}' of {name} has the law of '{base.name}': leave it out")


def _split_torque(column: Column, x: Samples) -> Array:
    """Return mass, force and dry friction of a column, per unit of its parameter (3, N)."""
    return np.array([np.broadcast_to(getattr(column, law)(x), x.time.shape) for law in LAWS[:3]], dtype=float)


def _try_law(label: str, law: Callable[[Samples], Any], x: Samples) -> None:
    values = _call_user_function(label, lambda: np.broadcast_to(np.asarray(law(x), dtype=float), x.time.shape))
    if (count := int(np.sum(~np.isfinite(values)))) > 0:
        raise UserError(f"{label} is not finite at {count} of {values.size} samples: give a law that is")


def _check_all(values: object, kind: type, label: str) -> None:
    if not isinstance(values, tuple | list) or not all(isinstance(value, kind) for value in values):
        raise UserError(f"{label} are {quote_value(values)}: give a tuple of {kind.__name__}")


def _call_user_function(label: str, function: Callable[[], T]) -> T:
    """Call a user's function; turn any error into a UserError."""
    try:
        with np.errstate(all="ignore"):
            return function()
    except Exception as error:
        raise UserError(f"{label}: {format_error(error)}") from error
