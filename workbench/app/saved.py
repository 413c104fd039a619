"""A session in one file: a ZIP archive of its recordings, the study that reads them, and what was made of them."""

import io
import json
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from enum import StrEnum
from pathlib import Path
from types import NoneType
from typing import Any, cast, get_args, get_origin, get_type_hints

from estimators.diagnosis.result import Diagnosis
from estimators.preprocessing import Preprocessed
from pendulum_env._typing import JSON
from pendulum_env.arms.joints import links_of
from pendulum_env.arms.model import ArmModel
from pendulum_env.excitation import SIGNALS, Excitation, signal_from_json, signal_json
from pendulum_env.physics import Model, Term
from pendulum_env.reading import Unreadable, amount, read_archive, read_json
from pendulum_env.recording import write_study
from pendulum_env.recording.study import read_sources
from workbench.app import uploads
from workbench.app.state import Asked, Loaded, State
from workbench.app.uploads import STUDY, safe_name
from workbench.mistakes import InputError, sentence
from workbench.robot import RobotFile

SCHEMA = "pendulum-ident/session@1"
CONTENTS = "session.json"
HINT = "a session is what “Save session” wrote"
# Fields of a `State` by what they are called in a file, beside its recordings and the terms of the base
MEMBERS = {name: name for name in ("model_file", "is_aligned", "asked", "started", "diagnosis")} | {"ladder": "grown"}


def study(state: State) -> str:
    """A study that names the recordings as they are read, for a folder in which they lie."""
    with tempfile.TemporaryDirectory() as folder:
        file, joints = Path(folder) / STUDY, state.robot.joints if state.robot is not None else None
        sources = [replace(one.source, joints=joints) for one in state.loaded]
        write_study(file, [replace(source, file=file.with_name(source.file.name)) for source in sources])
        return file.read_text(encoding="utf-8")


def pack(state: State) -> bytes:
    """The archive of a state; raises InputError if it would be too large to be opened again."""
    known: JSON = {"schema": SCHEMA, "origins": [one.origin for one in state.loaded]}
    if state.robot is not None:  # of an arm, models and diagnosis are made anew
        known |= {"robot": state.robot, "asked": state.asked, "model_file": state.model_file}
        known |= {"base": ArmModel.build(state.base_terms, 1.0) if state.terms else None}
    else:
        known |= {"base": _of(state.base_terms), **{key: getattr(state, name) for key, name in MEMBERS.items()}}
        if state.diagnosis is not None and (data := state.diagnosis.data) is not None:
            cut = {"window_share": data.window_share, "impacts_beside": data.impacts_beside}
            known["diagnosis"] = _plain(state.diagnosis) | cut
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(CONTENTS, json.dumps(known, default=_plain, indent=1))
        archive.writestr(STUDY, study(state))
        for file in state.files:
            archive.write(file, file.name)
    whole = packed.getvalue()
    if len(whole) > uploads.LIMITS.upload:
        raise InputError(
            f"a session is opened up to {amount(uploads.LIMITS.upload)}, and this one takes {amount(len(whole))}: "
            f"remove a recording first, or save {STUDY} and the model"
        )
    return whole


def opened(packed: Path, place: Callable[[float], Path]) -> State:
    """The state in an archive, which is unpacked to a place for that many bytes; raises InputError if it is none."""
    contents = read_archive(packed, HINT, uploads.LIMITS.space)
    folder = place(sum(map(len, contents.values())))
    for member, text in contents.items():
        (folder / safe_name(member)).write_bytes(text)
    try:
        return _opened(folder)
    except (ValueError, OSError) as mistake:
        raise InputError(f"{packed.name}: {sentence(mistake)}") from None


def _opened(folder: Path) -> State:
    """The state whose archive was unpacked to a folder.

    Raises Unreadable if something is missing, or does not belong together, and RecordingError as reading does.
    """
    if not (folder / CONTENTS).is_file():
        raise Unreadable(f"lacks {CONTENTS}; {HINT}")
    content = read_json(folder / CONTENTS, HINT)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise Unreadable(f"'schema' of {CONTENTS} should be {SCHEMA}; {HINT}")
    sources = read_sources(folder / STUDY) if content.get("origins") else ()
    loaded, begun = list[Loaded](), State()
    if "robot" in content:
        try:
            robot = _typed(RobotFile, content["robot"])
        except (LookupError, TypeError, ValueError) as error:
            raise Unreadable(f"'robot' of {CONTENTS} makes no sense ({error}); {HINT}") from None
        begun = State(robot=replace(robot, file=folder / robot.file))
    for source in sources:
        file = folder / safe_name(source.file.name)
        if not file.is_file():
            raise Unreadable(f"lacks {file.name}; {HINT}")
        loaded.append(Loaded.of(replace(source, file=file), loaded, read=begun.read))
    try:
        if begun.robot is not None:
            begun = replace(begun, loaded=tuple(loaded), asked=_typed(Asked, content["asked"]))
            if content.get("base") is not None:
                terms = ArmModel.of_body(content["base"], links_of(begun.base_terms)).terms[1:]
                begun = replace(begun, terms=terms, model_file=_typed(str, content["model_file"]))
            begun.asked.check(begun.base_terms)
            return begun
        _of_older(content["diagnosis"])
        hints, terms = get_type_hints(State), _typed(Model, content["base"]).terms
        known = {name: _typed(hints[name], content[key]) for key, name in MEMBERS.items()}
        origins = _typed(tuple[tuple[str, ...], ...], content["origins"])
        whole = tuple(replace(one, origin=origin) for one, origin in zip(loaded, origins, strict=True))
        state = State(loaded=whole, terms=terms, **known)
        state.asked.check(terms)
        if not state.trouble:
            if state.diagnosis is not None:
                data = _data_of(state, state.diagnosis, content["diagnosis"])
                state = replace(state, diagnosis=replace(state.diagnosis, data=data))
            state.told.json()  # what a page would stumble over
            state.standing.residuals(state.prepared.data.parts[0])
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise Unreadable(f"{CONTENTS} makes no sense ({type(error).__name__}: {error}); {HINT}") from None
    return state


def _of_older(diagnosis: JSON | None) -> None:
    """Give a diagnosis of older sessions, which tell one table or none, and one noise floor, its tables and floors."""
    if diagnosis is not None and "table" in diagnosis:
        diagnosis["tables"] = [] if (table := diagnosis.pop("table")) is None else [table]
    if diagnosis is not None and "noise_floor" in diagnosis:
        diagnosis["floors"] = {"": diagnosis.pop("noise_floor")}


def _data_of(state: State, found: Diagnosis, content: JSON) -> Preprocessed:
    """What a saved diagnosis was made of: the recordings, with their torque corrected and cut as it says."""
    train, holdout = ([one.recording for one in state.loaded if one.held_out is held] for held in (False, True))
    data = Preprocessed.of(train, holdout)
    data = data.corrected(found.alignments) if found.alignments else data
    beside = _typed(tuple[Term, ...] | None, content.get("impacts_beside"))
    share = _typed(float, content.get("window_share", 1.0))
    data = data.without([one.recording for one in found.disagreements])
    return replace(data, window_share=share, impacts_beside=beside)


def _of(terms: tuple[Term, ...]) -> Model:
    """A model with these terms, which JSON knows how to name."""
    return Model.build(terms, 1.0)


def _plain(record: Any) -> Any:
    """A record as JSON has it, one level deep."""
    if isinstance(record, Path):
        return record.name
    if isinstance(record, Model):
        return record.json()
    if isinstance(record, Term):
        return _of((record,)).json()
    if isinstance(record, tuple(SIGNALS.values())):
        return signal_json(cast(Excitation, record))
    return {field.name: getattr(record, field.name) for field in fields(record) if field.compare}


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
        kept = [field.name for field in fields(kind) if field.compare]
        known = [name for name in kept if name in content]  # others are as they begin
        return make(**{name: _typed(hints[name], content[name]) for name in known})
    if get_origin(kind) is tuple:
        each = [parts[0]] * len(content) if parts[-1] is Ellipsis else parts
        return tuple(_typed(one, item) for one, item in zip(each, content, strict=True))
    if get_origin(kind) is Mapping:
        return {key: _typed(parts[1], item) for key, item in content.items()}
    if kind is Path:
        return Path(safe_name(_typed(str, content)))
    if kind is float:
        return kind(content)
    if not isinstance(content, str if issubclass(kind, StrEnum) else kind):
        raise TypeError(f"{content!r} is no {kind.__name__}")
    return kind(content)
