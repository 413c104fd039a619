"""How this was done: recordings, windows, noise, and how to do it again."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.signals.differentiation import encoder_noise, white_noise
from estimators.simulation.free_running import SECONDS
from estimators.weak_form.windows import Windows
from workbench.report.case import Case
from workbench.report.section import Section


@dataclass(frozen=True)
class Used:
    """One recording as it was used; shares are of its samples."""

    name: str
    part: str
    samples: int
    rate: float  # [Hz]
    duration: float  # [s]
    at_rest: float  # share in stick, or too slow to have a sign
    used: float  # share inside a window
    windows: int
    window: float  # length [s]
    torque_noise: float  # white part of one sample [N m]
    position_noise: float  # the same [rad]
    notes: tuple[str, ...]


def method(case: Case) -> Section:
    """What the result rests on."""
    used = [use(w, "fitted") for w in case.training.data.windows]
    used += [use(w, "held out") for w in case.testing.data.windows]
    return Section(
        "method",
        "Method",
        "How this was done",
        {
            "used": used,
            "split": case.is_split,
            "seconds": SECONDS,
            "command": command(case),
            "snippet": snippet(case),
            "terms": [term.id for term in case.base.terms],
        },
    )


def use(w: Windows, part: str) -> Used:
    """Facts of one recording."""
    covered = np.zeros(len(w.recording), dtype=bool)
    half = len(w.kernel) // 2
    for center in w.centers:
        covered[center - half : center + half + 1] = True
    return Used(
        name=w.recording.name,
        part=part,
        samples=len(w.recording),
        rate=w.recording.rate,
        duration=w.recording.duration,
        at_rest=1.0 - float(np.mean(w.moving)),
        used=float(np.mean(covered)),
        windows=len(w.centers),
        window=len(w.kernel) / w.recording.rate,
        torque_noise=white_noise(w.recording.torque),
        position_noise=encoder_noise(w.recording.position),
        notes=w.recording.notes,
    )


def _files(case: Case) -> tuple[list[str], list[str]]:
    training = [f"{recording.name}.csv" for recording in case.train]
    return training, [] if case.is_split else [f"{recording.name}.csv" for recording in case.holdout]


def command(case: Case) -> str:
    """Command line that does the same."""
    training, testing = _files(case)
    words = ["pendulum-ident", "diagnose", *training]
    for file in testing:
        words += ["--holdout", file]
    return shlex.join([*words, "--report", "report.html"])


def _read(files: Sequence[str]) -> str:
    return f"[read_recording(path) for path in {files!r}]" if files else "[]"


def snippet(case: Case) -> str:
    """Python that does the same."""
    training, testing = _files(case)
    return "\n".join(
        [
            "from estimators.diagnosis.run import diagnose",
            "from pendulum_env.recording import read_recording",
            "from workbench.report import write_report",
            "",
            f"recordings = {_read(training)}",
            f"holdout = {_read(testing)}",
            "diagnosis = diagnose(recordings, holdout)",
            'write_report("report.html", recordings, holdout, diagnosis)',
        ]
    )
