"""How this was done: recordings, windows, noise, and how to do it again."""

import shlex
from typing import Any

import numpy as np

from estimators.signals.differentiation import encoder_noise, white_noise
from estimators.simulation.free_running import SECONDS
from estimators.weak_form.windows import Windows
from workbench.report.case import Case
from workbench.report.figure import Section


def method(case: Case) -> Section:
    """What the result rests on."""
    content = {
        "used": [
            _use(w, part)
            for part, prepared in zip(("fitted", "held out"), case.data.parts, strict=True)
            for w in prepared.data.windows
        ],
        "split": not case.data.holdout,
        "seconds": SECONDS,
        "command": command(case),
        "terms": [term.id for term in case.diagnosis.steps[0].model.terms],
    }
    return Section("method", "Method", "How this was done", content)


def _use(w: Windows, part: str) -> dict[str, Any]:
    """One recording as it was used: shares of its samples at rest and inside a window, lengths [s], and noises."""
    covered = np.zeros(len(w.recording), dtype=bool)
    half = len(w.kernel) // 2
    for center in w.centers:
        covered[center - half : center + half + 1] = True
    return {
        "name": w.recording.name,
        "part": part,
        "rate": w.recording.rate,
        "duration": w.recording.duration,
        "at_rest": 1.0 - float(np.mean(w.moving)),
        "used": float(np.mean(covered)),
        "windows": len(w.centers),
        "window": len(w.kernel) / w.recording.rate,
        "torque_noise": white_noise(w.recording.torque),
        "position_noise": encoder_noise(w.recording.position),
        "notes": w.recording.notes,
    }


def command(case: Case) -> str:
    """Command line that does the same."""
    options = [word for recording in case.data.holdout for word in ("--holdout", f"{recording.name}.csv")]
    fitted = [f"{recording.name}.csv" for recording in case.data.recordings]
    return shlex.join(["pendulum-ident", "diagnose", *fitted, *options, "--report", "report.html"])
