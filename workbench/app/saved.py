"""A session in one file: a ZIP archive of its recordings, the study that reads them, and what was made of them."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from estimators.arguments import within_limits
from estimators.diagnosis.result import Diagnosis
from estimators.selection.data import Step
from pendulum_env.physics import Model, Term, effects
from pendulum_env.reading import Unreadable, Value, read_json
from workbench.app.asked import Asked
from workbench.app.state import State
from workbench.app.typed import plain, typed

SCHEMA = "pendulum-ident/session@1"
CONTENTS = "session.json"
HINT = "a session is what “Save session” wrote"
PARTS = {"train", "holdout"}


@dataclass(frozen=True)
class Saved:
    """What a session knows beyond its recordings.

    Attributes:
        base: a model with the terms that the ladder begins with; its numbers say nothing.
        model_file, is_aligned, asked, ladder, started, diagnosis: as in `State`.
        origins: of the recordings, in their order.
    """

    base: Model
    model_file: str
    is_aligned: bool
    asked: Asked
    origins: tuple[tuple[str, ...], ...]
    ladder: tuple[Step, ...]
    started: tuple[Step, ...]
    diagnosis: Diagnosis | None

    @classmethod
    def of(cls, state: State) -> Saved:
        """What a state knows."""
        return cls(
            Model.build(state.terms, 1.0),
            state.model_file,
            state.is_aligned,
            state.asked,
            tuple(one.origin for one in state.loaded),
            state.ladder,
            state.started,
            state.diagnosis,
        )

    @classmethod
    def read(cls, file: Path) -> Saved:
        """What a file tells.

        Raises:
            Unreadable: if it is no such file; the message names the key.
            ModelError: if it holds a model that makes no sense.
        """
        content = read_json(file, HINT)
        if not isinstance(content, dict) or content.get("schema") != SCHEMA:
            raise Unreadable(f"{file}: is not a session: 'schema' should be {SCHEMA}; {HINT}")
        saved: Saved = typed(cls, Value("the session", "", content))
        if faults := saved.asked.faults(saved.base.terms):
            raise Unreadable(f"{file}: {next(iter(faults.values()))}")
        return saved

    def begin(self) -> State:
        """The state before any recording."""
        return State((), self.base.terms, self.model_file, self.is_aligned, self.asked)

    def restore(self, state: State) -> State:
        """The state with recordings, and what was made of them; as it is where nothing was, or can be.

        Raises:
            Unreadable: if what was made does not belong together.
        """
        if not (state.ladder and self.ladder):
            return state
        base = _ids(self.base.terms)
        start = [*base, *(step.added for step in self.started[1:])]
        for what, terms, steps in (
            ("ladder", base, self.ladder),
            ("started", base, self.started),
            ("diagnosis", start, self.diagnosis.steps if self.diagnosis is not None else ()),
        ):
            if not _climbs(terms, steps):
                raise Unreadable(f"'{what}' of the session has steps that do not follow from each other; {HINT}")
        if (self.diagnosis is None) == bool(self.started) or not _belongs(self.diagnosis, state):
            raise Unreadable(f"'diagnosis' of the session is not one of its recordings; {HINT}")
        limits = self.asked.limits

        def limited(steps: Sequence[Step]) -> tuple[Step, ...]:
            models = [replace(step.model, terms=within_limits(step.model.terms, {}, **limits)[0]) for step in steps]
            return tuple(replace(step, model=model) for step, model in zip(steps, models, strict=True))

        found = self.diagnosis and replace(self.diagnosis, steps=limited(self.diagnosis.steps))
        return replace(state, ladder=limited(self.ladder), started=limited(self.started), diagnosis=found)


def pack(state: State, study: str, name: str) -> bytes:
    """The archive of a state and the study that reads its recordings."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(CONTENTS, json.dumps({"schema": SCHEMA, **plain(Saved.of(state))}, indent=1) + "\n")
        archive.writestr(name, study)
        for one in state.loaded:
            archive.write(one.file, one.file.name)
    return packed.getvalue()


def member(contents: Mapping[str, bytes], name: str) -> bytes:
    """A file of an archive.

    Raises:
        Unreadable: if it is missing.
    """
    if name not in contents:
        raise Unreadable(f"lacks {name}; {HINT}")
    return contents[name]


def _ids(terms: Sequence[Term]) -> list[str]:
    return [term.id for term in terms]


def _climbs(base: Sequence[str | None], steps: Sequence[Step]) -> bool:
    """Whether each step adds what it says to the one before, and tells its errors."""
    known = list(base)
    for number, step in enumerate(steps):
        known += [step.added] if number else []
        if any(0.0 in (errors.torque_rms, errors.position_rms) for errors in step.errors.values()):
            return False  # of none, no share could be told
        if (step.added is None) != (number == 0) or _ids(step.model.terms) != known or set(step.errors) != PARTS:
            return False
    return True


def _belongs(found: Diagnosis | None, state: State) -> bool:
    """Whether a diagnosis may be one of these recordings, and of effects that are known here."""
    if found is None:
        return True
    named = {one.effect for one in found.candidates}
    odd = {one.recording for one in found.disagreements}
    count = len(state.train)
    return (
        bool(found.steps)
        and named <= set(effects())
        and len(found.alignments) == len(state.loaded)
        and odd <= set(range(1, len(state.loaded) + 1))
        and not set(range(1, count + 1)) <= odd
    )
