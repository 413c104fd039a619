"""Recordings that a model can be fitted to, with the base model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

from estimators.arguments import apply_limits
from estimators.checks.torque_constant import add_torque_constant
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.data.split import split_arm
from estimators.diagnosis.addition import fit
from estimators.free_swings import make_swing_terms, restore_known
from estimators.schemes.identification import identify
from estimators.schemes.result import SAVED, Identification
from estimators.selection.criterion import Criterion
from estimators.selection.errors import Step
from estimators.signals.residual import Region, make_region_everywhere
from pendulum_env._typing import Array
from pendulum_env.physics import Model, Term
from pendulum_env.recording.record import PER_INERTIA
from workbench.app.choices import SearchChoices
from workbench.app.recordings import LoadedRecording
from workbench.errors import InputError
from workbench.narrator.findings import describe

SCHEMES = ("dynamic", "filtered_dynamic", "filtered_hamiltonian")  # of an arm, the sure ones


@dataclass(frozen=True, eq=False)
class PreparedRecordings:
    """Recordings that a model can be fitted to."""

    data: FitData  # in N m, with their torque in time if that is asked for
    timed: FitData  # the same with their torque in time
    base: Step  # the base model, fitted
    schemes: Identification | None = None  # what some schemes find of an arm


@lru_cache(maxsize=4)  # states of the same choices share it
def prepare(
    loaded: tuple[LoadedRecording, ...], terms: tuple[Term, ...], is_aligned: bool, asked: SearchChoices
) -> PreparedRecordings:
    """Prepare recordings for fits; `asked` has the fixed and bounded parameters of the base model.

    Raises InputError if no known load tells a gain, and IdentificationError if there is too little motion.
    """
    train, holdout = ([one.recording for one in loaded if one.held_out is held] for held in (False, True))
    terms, _ = apply_limits(terms, {}, **asked.limits)
    given = FitData.of(train, holdout, terms)
    if given.doubt is not None and given.unit != PER_INERTIA:
        raise InputError(f"{describe(given.doubt)} Or give the gain itself.")
    timed = given.with_timing()
    own = timed if is_aligned else given
    base = fit(*own.parts, make_swing_terms(terms, own.recordings))
    model = restore_known(add_torque_constant(base.model, own.parts[0].data), terms, own.recordings)
    return PreparedRecordings(own, timed, replace(base, model=model))


@lru_cache(maxsize=4)
def prepare_arm(
    loaded: tuple[LoadedRecording, ...], terms: tuple[Term, ...], is_aligned: bool, asked: SearchChoices
) -> PreparedRecordings:
    """Prepare recordings of an arm for fits, without alignment; raises as `prepare`."""
    train, holdout = ([one.recording for one in loaded if one.held_out is held] for held in (False, True))
    fitted, _ = split_arm(train, holdout)
    found = identify(fitted, terms, SCHEMES)
    model, data = found[SAVED].model, FitData.of(train, holdout, found[SAVED].model.terms)
    errors = {name: part.errors(model) for name, part in zip(("train", "holdout"), data.parts, strict=True)}
    return PreparedRecordings(data, data, Step(None, model, errors), found)


def find_unexplained(prepared: RegressionData, model: Model) -> tuple[Region, ...]:
    """Find regions of the residual above noise in the fitted data, by joint."""
    residual: Array = prepared.with_link_states(model).residual(model.terms, model.theta)
    felt, data, regions = prepared.inertias(prepared.base), prepared.data, list[Region]()
    for at in data.joints:
        structure = data.part(at).structure(residual[data.where(at)], felt[at])
        if not Criterion().is_noise(structure, prepared.floors[at]):
            regions += prepared.stand_out(residual, at) or [make_region_everywhere(at=at)]
    return tuple(regions)
