"""Check of an exported model: MuJoCo and this project's simulation against recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.signals.motion import get_load_in_newton_metres
from estimators.simulation.free_running import simulate_all
from estimators.weak_form.point import Point
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.servos import are_driven
from robots.servos.in_loop.settings import LOOP
from workbench.export.request import Exported, ExportError, Request
from workbench.export.runs import simulate_segments, simulate_servos


@dataclass(frozen=True)
class CheckResult:
    """Deviations of simulations from recordings [rad]."""

    title: str  # definition of the deviations
    errors: Mapping[str, float]  # by pair of compared motions
    motion: float  # the same measure of the recorded position about its mean


def check(model: Model, exported: Exported, request: Request, recordings: Sequence[Recording]) -> CheckResult:
    """Compare the exported model in MuJoCo with recordings; a servo is simulated from their goals.

    Raises ExportError if a recording has a known load, IdentificationError if it has too little motion, and
    ModuleNotFoundError if the extra `export` is not installed.
    """
    for recording in recordings:
        if get_load_in_newton_metres(recording):
            raise ExportError(f"{recording.name}: a known load acted on the joint: check with a recording without one")
    if request.drive is None:
        return _check_free_runs(model, exported, recordings)
    return _check_in_loop(model, request, recordings)


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


def _check_in_loop(model: Model, request: Request, recordings: Sequence[Recording]) -> CheckResult:
    """Compare whole recordings of servos, each simulated with its recorded drive.

    Raises ExportError if a recording has no goal, or the grain is not a multiple of the step.
    """
    if not are_driven(recordings):
        raise ExportError(f"{recordings[0].name}: has no goal: a servo is checked in the loop alone")
    grain = LOOP.simulation.grain
    steps = round(grain / request.step)
    if abs(steps * request.step - grain) > 1e-9:
        raise ExportError(f"positions are compared every {grain:g} s: --step should be a whole part of it, as 0.001")
    # MuJoCo's controller reads the exact position
    rollouts = Rollouts(tuple(recordings), steps, grain=grain).without_counts
    simulated = rollouts.compute_position_errors([Point(model.terms, model.theta)])
    theirs = rollouts.positions.compare_paths(simulate_servos(model, request, rollouts.servos, steps))
    errors = {
        "this project's simulation": _compute_mean_size(simulated),
        "MuJoCo with what is exported": _compute_mean_size(theirs),
    }
    measured = rollouts.positions.measured
    motion = _compute_mean_size(measured - measured.mean())
    return CheckResult("In the loop, whole recordings from their goals alone, mean error", errors, motion)


def _compute_mean_size(values: Array) -> float:
    return float(np.mean(np.abs(values)))


def _compute_rms(first: Sequence[Array], second: Sequence[Array]) -> float:
    """Compute the root mean square of the differences of paths (N + 1, B) without their start."""
    differences = [(a - b)[1:].ravel() for a, b in zip(first, second, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2)))
