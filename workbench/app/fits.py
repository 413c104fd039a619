"""Fits of a session's recordings; they run in a worker process."""

from dataclasses import dataclass, replace
from typing import Any

from estimators import Addition, Diagnosis, FitData, Identification, add, diagnose, fit, identify
from estimators.arguments import apply_limits
from estimators.checks.homogeneity import Disagreement, find_disagreements, fit_each_recording
from estimators.data.model_errors import compute_errors
from estimators.data.split import split_arm
from estimators.data.standard_errors import add_torque_constant
from estimators.decisions.errors import Step
from estimators.free_swings import make_swing_terms, restore_known
from estimators.progress import Progress
from pendulum_env.physics import Model, Term
from pendulum_env.recording import PER_INERTIA, Recording
from workbench.app.jobs import Task
from workbench.errors import InputError
from workbench.narrator import describe

SCHEMES_OF_ARM = ("dynamic", "filtered_dynamic", "filtered_hamiltonian")


@dataclass(frozen=True, eq=False)
class BaseFit:
    """Result of the fit of the base model, and the data for further fits."""

    data: FitData  # calibrated recordings, with corrected timing if requested
    step: Step  # the base model
    disagreements: tuple[Disagreement, ...] = ()  # recordings of a different plant
    schemes: Identification | None = None  # of the base model of an arm


def fit_pendulum(
    recordings: tuple[Recording, ...],
    holdout: tuple[Recording, ...],
    terms: tuple[Term, ...],
    is_aligned: bool,
    limits: dict[str, Any],
    _: Progress,
) -> BaseFit:
    """Fit the base model of a pendulum.

    Raises InputError if no known load determines a gain, and IdentificationError if the joint moves too little.
    """
    terms = apply_limits(terms, {}, **limits)[0]
    logged = FitData.from_recordings(recordings, holdout, terms)
    if logged.doubt is not None and logged.recordings[0].torque_unit != PER_INERTIA:
        raise InputError(f"{describe(logged.doubt)} Or give the gain itself.")
    data = logged.with_timing() if is_aligned else logged
    step = fit(*data.parts, make_swing_terms(terms, data.recordings), data.criterion)
    model = restore_known(add_torque_constant(step.model, data.parts[0].data), terms, data.recordings)
    parts = [part.data for part in data.parts[: 2 if holdout else 1]]
    fits = fit_each_recording(parts, model.terms, data.criterion)
    return BaseFit(data, replace(step, model=model), find_disagreements(fits, only_if_all_fit=True))


def fit_arm(
    recordings: tuple[Recording, ...], holdout: tuple[Recording, ...], terms: tuple[Term, ...], *_: Any
) -> BaseFit:
    """Fit the base model of an arm; raises IdentificationError if a joint moves too little."""
    identification = identify(split_arm(recordings, holdout)[0], terms, SCHEMES_OF_ARM)
    model = identification.primary.model
    data = FitData.from_recordings(recordings, holdout, model.terms)
    errors = {name: compute_errors(part, model) for name, part in zip(("train", "holdout"), data.parts, strict=True)}
    return BaseFit(data, Step(None, model, errors), schemes=identification)


def fit_and_diagnose(
    fit: Task, effects: dict[str, Any], limits: dict[str, Any], progress: Progress
) -> tuple[BaseFit, Diagnosis]:
    """Fit the base model and diagnose it; `fit` is the task of the first step."""
    base: BaseFit = fit(progress)
    data = base.data
    return base, diagnose(data.recordings, data.holdout, base.step.model.terms, progress, **effects, **limits)


def fit_effect(
    model: Model,
    effect: str,
    recordings: tuple[Recording, ...],
    holdout: tuple[Recording, ...],
    limits: dict[str, Any],
    progress: Progress,
) -> Addition:
    """Refit a model with one more effect."""
    return add(model, effect, recordings, holdout, progress, **limits)
