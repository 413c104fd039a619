"""A session in one file: a ZIP archive of its recordings, the study that reads them, and what was made of them."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import StrEnum
from pathlib import Path
from types import NoneType
from typing import Any, cast, get_args, get_origin, get_type_hints

from estimators.diagnosis.result import Diagnosis
from estimators.selection.data import Step
from pendulum_env.excitation import SIGNALS, Excitation, signal_from_json, signal_json
from pendulum_env.physics import Model, Term
from pendulum_env.reading import Unreadable, read_json
from pendulum_env.recording.study import read_sources
from workbench.app.asked import Asked
from workbench.app.state import Loaded, State
from workbench.app.uploads import safe_name

SCHEMA = "pendulum-ident/session@1"
CONTENTS, STUDY = "session.json", "study.toml"
HINT = "a session is what “Save session” wrote"


@dataclass(frozen=True)
class Saved:
    """What a session knows beyond its recordings; the hints tell how it is read.

    Attributes:
        base: a model with the terms that the ladder begins with; its numbers say nothing.
        model_file, is_aligned, asked, started, diagnosis: as in `State`.
        origins: of the recordings, in their order.
        ladder: `grown` of the `State`.
    """

    base: Model
    model_file: str
    is_aligned: bool
    asked: Asked
    origins: tuple[tuple[str, ...], ...]
    ladder: tuple[Step, ...]
    started: tuple[Step, ...]
    diagnosis: Diagnosis | None


def pack(state: State, study: str) -> bytes:
    """The archive of a state, and of the study that reads its recordings."""
    made = state.grown, state.started, state.diagnosis
    origins = tuple(one.origin for one in state.loaded)
    known = Saved(_of(state.terms), state.model_file, state.is_aligned, state.asked, origins, *made)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(CONTENTS, json.dumps({"schema": SCHEMA, **_plain(known)}, default=_plain, indent=1))
        archive.writestr(STUDY, study)
        for file in {one.source.file for one in state.loaded}:
            archive.write(file, file.name)
    return packed.getvalue()


def opened(folder: Path) -> State:
    """The state whose archive was unpacked to a folder.

    Raises:
        Unreadable: if something is missing, or does not belong together.
        RecordingError: if a recording cannot be read.
    """
    if not (folder / CONTENTS).is_file():
        raise Unreadable(f"lacks {CONTENTS}; {HINT}")
    content = read_json(folder / CONTENTS, HINT)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise Unreadable(f"'schema' of {CONTENTS} should be {SCHEMA}; {HINT}")
    sources = read_sources(folder / STUDY) if content.get("origins") else ()
    loaded: list[Loaded] = []
    for source in sources:
        file = folder / safe_name(source.file.name)
        if not file.is_file():
            raise Unreadable(f"lacks {file.name}; {HINT}")
        loaded.append(Loaded.of(replace(source, file=file), loaded))
    try:
        known: Saved = _typed(Saved, content)
        known.asked.check(known.base.terms)
        whole = tuple(replace(one, origin=origin) for one, origin in zip(loaded, known.origins, strict=True))
        made = known.ladder, known.diagnosis, known.started
        state = State(whole, known.base.terms, known.model_file, known.is_aligned, known.asked, *made)
        if not state.trouble:
            state.told.json(), state.found, state.points  # what a page would stumble over
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise Unreadable(f"{CONTENTS} makes no sense ({type(error).__name__}: {error}); {HINT}") from None
    return state


def _of(terms: tuple[Term, ...]) -> Model:
    """A model with these terms, which JSON knows how to name."""
    return Model.build(terms, 1.0)


def _plain(record: Any) -> Any:
    """A record as JSON has it, one level deep."""
    if isinstance(record, Model):
        return record.json()
    if isinstance(record, Term):
        return _of((record,)).json()
    if isinstance(record, tuple(SIGNALS.values())):
        return signal_json(cast(Excitation, record))
    return {field.name: getattr(record, field.name) for field in fields(record)}


def _typed(kind: Any, content: Any) -> Any:
    """What JSON has as a type hint asks for; raises LookupError, TypeError or ValueError if it is something else."""
    parts = get_args(kind)
    if NoneType in parts:
        (kind,) = (part for part in parts if part is not NoneType)
        return None if content is None else _typed(kind, content)
    if kind in (Model, Term):
        model = Model.from_json(content)
        return model if kind is Model else model.terms[0]
    if kind is Excitation:
        return signal_from_json(content)
    if is_dataclass(kind):
        hints, make = get_type_hints(kind), cast(Any, kind)
        return make(**{field.name: _typed(hints[field.name], content[field.name]) for field in fields(kind)})
    if get_origin(kind) is tuple:
        each = [parts[0]] * len(content) if parts[-1] is Ellipsis else parts
        return tuple(_typed(one, item) for one, item in zip(each, content, strict=True))
    if get_origin(kind) is Mapping:
        return {key: _typed(parts[1], item) for key, item in content.items()}
    if kind is float:
        return kind(content)
    if not isinstance(content, str if issubclass(kind, StrEnum) else kind):
        raise TypeError(f"{content!r} is no {kind.__name__}")
    return kind(content)
