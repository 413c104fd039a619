"""Frozen records as plain JSON, and back by their type hints: nothing comes in that the hints do not name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from types import NoneType
from typing import Any, cast, get_args, get_origin, get_type_hints

from pendulum_env._typing import JSON
from pendulum_env.excitation import SIGNALS, Excitation, signal_json, signal_of
from pendulum_env.physics import Model
from pendulum_env.reading import Value

NUMBERS = {text: float(text) for text in ("inf", "-inf", "nan")}  # which JSON has no word for
LONGEST = 5000  # characters of a text


def plain(value: Any) -> Any:
    """A record, or what it holds, as JSON has it."""
    if isinstance(value, Model):
        return value.json()
    if isinstance(value, tuple(SIGNALS.values())):
        return signal_json(cast(Excitation, value))
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    return value


def typed(kind: Any, value: Value) -> Any:
    """The record of a kind, or what a hint asks for.

    Raises:
        Unreadable: if it is something else; the message names the key.
        ModelError: if it holds a model that makes no sense.
    """
    parts = get_args(kind)
    if NoneType in parts:  # it is there, or `_record` would not have asked
        (kind,) = (part for part in parts if part is not NoneType)
        return typed(kind, value)
    if kind is Model:
        return Model.from_json(_table(value))
    if kind is Excitation:
        return signal_of(value)
    if is_dataclass(kind):
        return _record(kind, value)
    if get_origin(kind) is tuple:
        items = value.items()
        each = [parts[0]] * len(items) if parts[-1] is Ellipsis else list(parts)
        if len(each) != len(items):
            raise value.fault(f"a list of {len(each)}")
        return tuple(typed(one, item) for one, item in zip(each, items, strict=True))
    if get_origin(kind) is Mapping:
        return {key: typed(parts[1], value[key]) for key in _table(value)}
    if kind is float:
        return NUMBERS[value.content] if value.content in list(NUMBERS) else value.number()
    if kind in (bool, int):
        if type(value.content) is not kind:
            raise value.fault("true or false" if kind is bool else "a whole number")
        return value.content
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        if value.content not in list(kind):
            raise value.fault(f"one of {', '.join(kind)}")
        return kind(value.content)
    return value.text(LONGEST) if value.content != "" else ""


def _record(kind: Any, value: Value) -> Any:
    hints = get_type_hints(kind)
    content = {}
    for field in fields(kind):
        hint = hints[field.name]
        inner = value.get(field.name)
        if inner is None and NoneType not in get_args(hint):
            inner = value[field.name]  # which says that it is lacking
        content[field.name] = None if inner is None else typed(hint, inner)
    return kind(**content)


def _table(value: Value) -> JSON:
    if not isinstance(value.content, dict):
        raise value.fault("a table")
    return value.content
