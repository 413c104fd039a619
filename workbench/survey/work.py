"""What a worker does with a case: read the file, diagnose, and say what was found, or why not."""

import hashlib
import json
import os
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import Any

from estimators.diagnosis.result import Diagnosis, Verdict
from estimators.diagnosis.run import diagnose
from pendulum_env._typing import JSON
from pendulum_env.mistake import Mistake, told
from pendulum_env.physics import Term, load_plugin
from pendulum_env.physics.plugin import fault
from pendulum_env.reading import check_size
from pendulum_env.recording import Recording
from pendulum_env.recording.study import read_sources
from workbench.mistakes import MISTAKES, InputError, printable, sentence
from workbench.survey.cases import Case
from workbench.survey.dataset import VERDICTS

PAGES = {"none": (), "found": ("missing", "unexplained"), "all": VERDICTS}  # verdicts of cases that get a page each


@dataclass(frozen=True)
class Settings:
    """What a survey asks for."""

    # Of every diagnosis: arguments of `estimators.diagnose` by name, such as `base`, `only` or `fixed`
    asked: Mapping[str, Any] = field(default_factory=dict)
    plugins: tuple[Path, ...] = ()  # files that register effects of the user's own; each worker loads them
    reports: str = "none"  # which cases get a page of their own, a key of `PAGES`
    folder: Path | None = None  # where the survey is written; the workers write pages there

    def mark(self, case: Case) -> str:
        """Hash of all that decides on a row apart from what is in the file, wherever it lies."""
        of_case = vars(case) | {"source": vars(case.source) | {"file": None}}
        plugins = [content_hash(path) for path in self.plugins]
        text = json.dumps([version(), self.asked, plugins, of_case], sort_keys=True, default=_plain)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def is_answered(self, case: Case, row: JSON) -> bool:
        """Whether a row is what would be found of a case now: the same was asked, of the same content."""
        if row["status"] == "failed" or row["settings"] != self.mark(case):
            return False
        if row["report"] is None and row["verdict"] in PAGES[self.reports]:
            return False
        try:
            return content_hash(case.source.file) == row["hash"]
        except MISTAKES:
            return row["hash"] is None


def _plain(value: object) -> Any:
    return [value.id, value.shape] if isinstance(value, Term) else str(value)


Look = Callable[[Case, Settings], JSON]


def look(case: Case, settings: Settings) -> JSON:
    """Read a recording and diagnose it, and write its page if that is asked for.

    Returns:
        What was found, by the columns of `SCHEMA`.

    Raises RecordingError if it cannot be read, IdentificationError if it holds too little motion, and OSError if the
    page cannot be written.
    """
    for path in settings.plugins:
        load_plugin(path)
    recording = replace(case.source.read(), drive=None)  # by its torque
    found = diagnose([recording], **settings.asked)
    row = _row(recording, found)
    if settings.folder is not None and row["verdict"] in PAGES[settings.reports]:
        from workbench.report import write_report  # plotly takes a while to import

        row["report"] = page_of(case)
        path = settings.folder / row["report"]
        path.parent.mkdir(parents=True, exist_ok=True)
        write_report(path, found)
    return row


def page_of(case: Case) -> str:
    """File of a case's own page, below the survey's folder; names that differ stay different."""
    readable = re.sub(r"[^\w.-]+", "-", case.name, flags=re.ASCII).strip("-.")[-80:]
    return f"reports/{readable}-{hashlib.sha256(case.name.encode()).hexdigest()[:8]}.html"


def _row(recording: Recording, found: Diagnosis) -> JSON:
    data = found.json()
    errors = found.steps[-1].errors["holdout"]
    gains = [one["gain"] or {} for one in data["candidates"]]
    return {
        "verdict": "missing" if found.selected else "unexplained" if found.unexplained else "nothing",
        "headline": found.headline,
        "score": max((one.score for one in found.candidates if one.verdict is Verdict.SELECTED), default=None),
        "selected": data["selected"],
        "ambiguous": data["ambiguous"],
        "candidates": [
            one | {"gain": gain.get("total"), "gain_error": gain.get("error"), "variants": gain.get("variants")}
            for one, gain in zip(data["candidates"], gains, strict=True)
        ],
        "parameters": [{"name": name, **one.json()} for name, one in found.model.estimates.items()],
        "torque_unit": found.torque_unit,
        "noise_floor": found.noise_floor,
        "torque_rms": errors.torque_rms,
        "position_rms": errors.position_rms,
        "samples": len(recording),
        "duration": recording.duration,
        "diagnosis": json.dumps(data),
    }


def examined(case: Case, settings: Settings, look: Look = look) -> JSON:
    """Row of a case, whatever happens."""
    begun = perf_counter()
    row = row_of(case, settings)
    try:
        row["hash"] = content_hash(case.source.file)
        if case.source.file.suffix == ".toml":
            read_sources(case.source.file)  # says what is wrong in a study that could not be read
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what matters is in the result
            row |= {"status": "done", **look(case, settings)}
    except BaseException as error:  # a fault of the program in one case must not cost the others
        row |= trouble(error, case)
    return row | {"seconds": perf_counter() - begun, "finished": datetime.now(UTC)}


def row_of(case: Case, settings: Settings) -> JSON:
    """What a row says of a case before anybody has looked at it."""
    return {name: value for name, value in vars(case).items() if name != "source"} | {
        "file": printable(os.path.realpath(case.source.file)),
        "version": version(),
        "settings": settings.mark(case),
        "finished": datetime.now(UTC),
    }


def trouble(error: BaseException, case: Case) -> JSON:
    """Status and reason of a case of which nothing was found: the file cannot be used, or something else went wrong."""
    if isinstance(error, Mistake):
        return {"status": "refused", "reason": sentence(error).removeprefix(f"{case.source.file}: ")}
    if isinstance(error, MemoryError):
        error = InputError("it does not fit into the memory of the worker: give workers more (--memory)")
    elif not isinstance(error, OSError):  # of a full disk, or a share that is away
        error = fault(error) or InputError(told(error))
    return {"status": "failed", "reason": sentence(error)}


def content_hash(file: Path) -> str:
    """Hash of what is in a file, or in the files of a folder.

    Raises OSError if it cannot be read, and Unreadable as `check_size`.
    """
    digest = hashlib.blake2b(digest_size=20)
    for path in sorted(file.iterdir()) if file.is_dir() else [file]:
        check_size(path)
        with path.open("rb") as stream:
            hashlib.file_digest(stream, lambda: digest)
    return digest.hexdigest()


@cache
def version() -> str:
    """Version of this project."""
    return metadata.version("pendulum-ident")
