"""What a worker does with a case: read the file, diagnose, and say what was found, or why not."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from time import perf_counter

from estimators.checks.alignment import Aligned
from estimators.diagnosis.result import Diagnosis, Verdict
from estimators.diagnosis.run import diagnose
from estimators.selection.criterion import Criterion
from pendulum_env._typing import JSON
from pendulum_env.physics import BASE, Term, effects, load_plugin
from pendulum_env.reading import regular_size
from pendulum_env.recording import Recording
from pendulum_env.recording.record import by_torque
from pendulum_env.recording.table import REMEDY
from workbench.mistakes import MISTAKES, sentence
from workbench.survey.cases import Case

BLOCK = 1 << 20  # bytes that are hashed at a time


@dataclass(frozen=True)
class Settings:
    """What a survey asks of every diagnosis.

    Attributes:
        base: terms of the model to start from.
        criterion: what effects have to achieve.
        library: ids of the effects that may be named.
        fixed: values of parameters that are known, by name.
        bounds: of others.
        plugins: files that register effects of the user's own; each worker loads them.
        reports: which cases get a page of their own: `none`, `found` (those where something is missing) or `all`.
        folder: where the survey is written; the workers write pages there.
    """

    base: tuple[Term, ...] = tuple(BASE)
    criterion: Criterion = field(default_factory=Criterion)
    library: tuple[str, ...] = field(default_factory=lambda: tuple(effects()))
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    plugins: tuple[Path, ...] = ()
    reports: str = "none"
    folder: Path | None = None

    def mark(self, case: Case) -> str:
        """Hash of all that decides on the result, apart from the file and the version."""
        source = case.source
        asked = {
            "model": self._model,
            "columns": dict(source.columns),
            "unwrap": source.unwrap,
            "range": source.range,
            "largest": source.largest,  # what was refused for its size may be read now
            "load": asdict(source.load) if source.load is not None else None,
        }
        return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:16]

    @cached_property
    def _model(self) -> JSON:
        return {
            "base": [[term.id, term.shape] for term in self.base],
            "criterion": asdict(self.criterion),
            "library": sorted(self.library),
            "fixed": dict(self.fixed),
            "bounds": dict(self.bounds),
            "plugins": [content_hash(path) for path in self.plugins],
        }

    def asks_for_page(self, verdict: str | None) -> bool:
        """Whether a case of that verdict gets a page."""
        return self.reports == "all" or (self.reports == "found" and verdict in ("missing", "unexplained"))


@dataclass(frozen=True)
class Findings:
    """What a diagnosis found, as a row of the dataset has it; see `SCHEMA`."""

    verdict: str
    headline: str
    score: float | None
    selected: tuple[str, ...]
    ambiguous: tuple[tuple[str, ...], ...]
    candidates: tuple[JSON, ...]
    parameters: tuple[JSON, ...]
    torque_unit: str
    noise_floor: float
    torque_rms: float
    position_rms: float
    samples: int
    duration: float
    diagnosis: str
    report: str | None = None


Look = Callable[[Case, Settings], Findings]


def look(case: Case, settings: Settings) -> Findings:
    """Read a recording and diagnose it, and write its page if that is asked for.

    Raises:
        RecordingError: if it cannot be read.
        IdentificationError: if it holds too little motion.
        OSError: if the page cannot be written.
    """
    for path in settings.plugins:
        load_plugin(path)
    recording = by_torque(case.source.read())
    found = diagnose(
        [recording],
        (),
        settings.base,
        only=settings.library,
        fixed=settings.fixed,
        bounds=settings.bounds,
        criterion=settings.criterion,
    )
    verdict = _verdict(found)
    page = None
    if settings.asks_for_page(verdict) and settings.folder is not None:
        page = page_of(case)
        _write_page(settings.folder / page, recording, found)
    return _findings(recording, found, verdict, page)


def page_of(case: Case) -> str:
    """File of a case's own page, below the survey's folder; names that differ stay different."""
    readable = re.sub(r"[^\w.-]+", "-", case.name, flags=re.ASCII).strip("-.")[-80:]
    return f"reports/{readable}-{hashlib.sha256(case.name.encode()).hexdigest()[:8]}.html"


def _write_page(path: Path, recording: Recording, found: Diagnosis) -> None:
    from workbench.commands.identify import six_schemes
    from workbench.report import write_report  # plotly takes a while to import

    path.parent.mkdir(parents=True, exist_ok=True)
    fitted = Aligned.by(found.alignments, [recording], []).recordings
    write_report(path, [recording], [], found, six_schemes(fitted, found.model.terms))


def _verdict(found: Diagnosis) -> str:
    if found.selected:
        return "missing"
    return "unexplained" if found.unexplained else "nothing"


def _findings(recording: Recording, found: Diagnosis, verdict: str, page: str | None) -> Findings:
    errors = found.steps[-1].errors["holdout"]
    scores = [one.score for one in found.candidates if one.verdict is Verdict.SELECTED]
    return Findings(
        verdict=verdict,
        headline=found.headline,
        score=max(scores, default=None),
        selected=found.selected,
        ambiguous=found.ambiguous,
        candidates=tuple(
            {
                "effect": one.effect,
                "verdict": str(one.verdict),
                "score": one.score,
                "gain": one.gain.total if one.gain is not None else None,
                "gain_error": one.gain.json()["error"] if one.gain is not None else None,
                "variants": one.variants,
            }
            for one in found.candidates
        ),
        parameters=tuple({"name": name, **one.json()} for name, one in found.model.estimates.items()),
        torque_unit=found.torque_unit,
        noise_floor=found.noise_floor,
        torque_rms=errors.torque_rms,
        position_rms=errors.position_rms,
        samples=len(recording),
        duration=recording.duration,
        diagnosis=json.dumps(found.json()),
        report=page,
    )


def examined(case: Case, settings: Settings, known: str | None = None, look: Look = look) -> JSON | None:
    """Row of a case, whatever happens; None if the file's content is what is known already.

    Args:
        case: to look at.
        settings: of the survey.
        known: hash of the content at the last look, if nothing else has changed since.
        look: that finds.
    """
    begun = perf_counter()
    row = row_of(case, settings)
    try:
        content = stamp(case.source.file) | {"hash": content_hash(case.source.file, case.source.largest)}
        if known is not None and content["hash"] == known:
            return None
        row |= content
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what matters is in the result
            found = look(case, settings)
        row |= {"status": "done", **vars(found)}
    except OSError as error:  # a full disk, a share that is away
        row |= {"status": "failed", "reason": sentence(error)}
    except MemoryError:
        row |= {"status": "failed", "reason": "it does not fit into the memory of the worker: give workers more"}
    except MISTAKES as mistake:
        row |= {"status": "refused", "reason": sentence(mistake).removeprefix(f"{case.source.file}: ")}
    except Exception as fault:  # a fault of the program in one case must not cost the others
        row |= {"status": "failed", "reason": sentence(ValueError(f"{type(fault).__name__}: {fault}"))}
    return row | {"seconds": perf_counter() - begun, "memory": peak_memory(), "finished": datetime.now(UTC)}


def lost(case: Case, settings: Settings, reason: str) -> JSON:
    """Row of a case whose worker did not come back."""
    return row_of(case, settings) | {"status": "failed", "reason": reason, "finished": datetime.now(UTC)}


def row_of(case: Case, settings: Settings) -> JSON:
    """What a row says of a case before anybody has looked at it."""
    return {
        "name": case.name,
        "robot": case.robot,
        "joint": case.joint,
        "kind": case.kind,
        "date": case.date,
        "dated_by": case.dated_by,
        "file": str(case.source.file.resolve()),
        "version": version(),
        "settings": settings.mark(case),
    }


def stamp(file: Path) -> JSON:
    """Size and time of change of a file, which differ where its content does, or else cost one more reading.

    Raises:
        OSError: if there is no such file.
    """
    status = os.stat(file)
    return {"size": status.st_size, "changed": status.st_mtime_ns}


def content_hash(file: Path, most: float = math.inf) -> str:
    """Hash of what is in a file, or in the files of a folder.

    Raises:
        OSError: if it cannot be read.
        Unreadable: if it is no regular file, or larger than `most` bytes.
    """
    digest = hashlib.blake2b(digest_size=20)
    for path in sorted(file.iterdir()) if file.is_dir() else [file]:
        regular_size(path, most, REMEDY)
        with path.open("rb") as stream:
            while block := stream.read(BLOCK):
                digest.update(block)
    return digest.hexdigest()


@cache
def version() -> str:
    """Version of this project."""
    return metadata.version("pendulum-ident")


def peak_memory() -> float:
    """Most memory that this process has had so far [MB]; NaN where the system does not say."""
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20) if sys.platform == "darwin" else peak / 1024
