"""Check of an exported model against recordings: the motion of MuJoCo, or the torque that a feedforward leaves."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.signals.motion import get_load_in_newton_metres
from estimators.simulation.free_running import simulate_all
from estimators.weak_form.point import Point
from pendulum_env._typing import Array
from pendulum_env.export.exporter import CheckResult, find_exporter
from pendulum_env.export.feedforward import select_terms
from pendulum_env.export.request import Exported, ExportError, Request
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from workbench.export.runs import simulate_segments


def check(model: Model, exported: Exported, request: Request, recordings: Sequence[Recording]) -> CheckResult:
    """Compare the exported model in MuJoCo with recordings; a servo is simulated from their goals.

    Raises ExportError if a recording has a known load, IdentificationError if it has too little motion, and
    ModuleNotFoundError if the extra `export` is not installed.
    """
    for recording in recordings:
        if get_load_in_newton_metres(recording):
            raise ExportError(f"{recording.name}: a known load acted on the joint: check with a recording without one")
    if (exporter := find_exporter(model, request)) is not None:
        return exporter.check(model, exported, request, recordings)
    return _check_free_runs(model, exported, recordings)


def check_feedforward(model: Model, recordings: Sequence[Recording]) -> CheckResult:
    """Compare the torque that the inertia does not need with the feedforward at the measured motion.

    Raises IdentificationError if a recording has too little motion.
    """
    data = RegressionData.from_recordings(recordings)
    inertia = [term for term in model.terms if term.kind == "inertial"]
    compensated = [*inertia, *select_terms(model)[0].terms]
    left = [data.residual(terms, replace(model, terms=tuple(terms)).theta) for terms in (inertia, compensated)]
    names = ("torque without feedforward, less that of the inertia", "torque that the feedforward leaves")
    errors = {name: float(np.sqrt(np.mean(values**2))) for name, values in zip(names, left, strict=True)}
    title = "Torque at the measured motion, without rest and reversals, RMS"
    return CheckResult(title, errors, errors[names[0]], model.units().unit("N m"), "of it")


def _check_free_runs(model: Model, exported: Exported, recordings: Sequence[Recording]) -> CheckResult:
    """Compare free motion over windows that start from the measured state."""
    segments = RegressionData.from_recordings(recordings).with_link_states(model).segments
    simulated = [path[:, 0] for path in simulate_all(segments, [Point.from_model(model)])]
    theirs = [simulate_segments(model, exported, segment) for segment in segments]
    measured = [segment.position for segment in segments]
    errors = {
        "this project's simulation against the recording": _compute_rms(simulated, measured),
        "MuJoCo with the exported model against the recording": _compute_rms(theirs, measured),
        "one against the other": _compute_rms(theirs, simulated),
    }
    motion = _compute_rms(measured, [q.mean(0) for q in measured])
    return CheckResult("Free run over windows of one second, RMS", errors, motion)


def _compute_rms(first: Sequence[Array], second: Sequence[Array]) -> float:
    """Compute the root mean square of the differences of paths (N + 1, B) without their start."""
    differences = [(a - b)[1:].ravel() for a, b in zip(first, second, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))
