"""Case of an arm: effects at its joints, by the torque of all joints together; nothing is simulated or suggested."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from estimators.data.fit_data import FitData
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.experiment import Limits
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.setting import Setting
from estimators.diagnosis.treatments import time_beside_effects
from estimators.diagnosis.unexplained import fit_holdout_too, holdout_names
from estimators.findings import Finding, Kind
from estimators.schemes.identifiability import unidentifiable
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.physical import driving_friction
from estimators.selection.residuals import Terms
from estimators.selection.search import SearchResult, search
from estimators.selection.tables import find_explaining_law
from estimators.signals.residual import Region, everywhere
from estimators.weak_form.windows import concatenate_samples
from pendulum_env.arms.joints import at_joints, links_of
from pendulum_env.mistake import Mistake
from pendulum_env.physics.table import TABLES
from pendulum_env.physics.terms import ids
from pendulum_env.recording import Recording


def prepare(recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> tuple[FitData, Setting]:
    """Take the recordings as they are, with columns of all terms that may be fitted.

    Raises:
        Mistake: if instruments or bounds of an experiment are asked for.
    """
    if setting.by_reference or setting.limits != Limits():
        raise Mistake("by_reference and bounds of an experiment are for pendulums alone: leave them out for an arm")
    known = ids(setting.base)
    library = {id: kind for id, kind in setting.library.items() if id not in known}
    data = FitData.of(recordings, holdout, (*setting.base, *library.values()))
    return data, replace(setting, library=library, original=setting.base)


def make_evaluator(data: FitData, setting: Setting) -> ModelEvaluator:
    """Make the evaluator of models; every table may compete at every joint."""
    return setting.evaluator(data.parts, at_joints(TABLES.values(), links_of(setting.base)))


def refine(trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
    """Withhold parameters that the recordings do not determine."""
    *others, last = trial.found.steps
    body, data = links_of(trial.setting.base), trial.evaluator.train.data
    seen = (concatenate_samples([w.samples for w in data.part(at).windows]) for at in body.joints)
    motion = zip(*((x.position, x.velocity, x.torque) for x in seen), strict=True)
    model = last.model.withholding(unidentifiable(last.model, *map(np.column_stack, motion)))
    return replace(trial.found, steps=[*others, replace(last, model=model)]), ()


def find_regions(trial: Trial) -> Sequence[Region]:
    """Find where the residual stands out at the joints that have one."""
    return where_it_stands_out(trial.evaluator, trial.terms, *left_at_joints(trial.evaluator, trial.terms))


def conclude(trial: Trial, found: Diagnosis) -> Diagnosis:
    """Add the residual of each joint, tables that explain it, and the next step."""
    evaluator, terms = trial.evaluator, trial.terms
    left, unseen = left_at_joints(evaluator, terms)
    by_law = ([table for table in evaluator.tables if table.at == at] for at in left)
    tables = tuple(id for laws in by_law if (id := find_explaining_law(evaluator, terms, laws)) is not None)
    forbidden = what_is_open(found.ambiguous, tables, bool(left or unseen))
    if unseen and not left:
        forbidden = fit_holdout_too(
            evaluator, Kind.FIT_HELD_OUT_OR_PAYLOAD if trial.data.holdout else Kind.FIT_HELD_OUT
        )
    findings = (*driving_friction(found.model), *trial.data.corrections)
    return replace(found, findings=findings, forbidden=forbidden, tables=tables, left=left | unseen)


def left_at_joints(evaluator: ModelEvaluator, terms: Terms) -> tuple[dict[str, float], dict[str, float]]:
    """Torque that terms leave of joints and that is no noise [N m]: what neighbouring windows share, or all.

    The second are of the held-out data, at joints where nothing is left of what was fitted.
    """
    fitted, unseen = (
        {
            at: own.correlated_rms if own.z_score > evaluator.criterion.z_score else own.rms
            for at, own in found.items()
            if not evaluator.criterion.is_noise(
                own, max(evaluator.residuals.noise_floor(part, at), part.data.negligible(at))
            )
        }
        for part, found in zip(evaluator.parts, evaluator.residuals.structures(terms), strict=True)
    )
    return fitted, {at: size for at, size in unseen.items() if at not in fitted}


def where_it_stands_out(
    evaluator: ModelEvaluator, terms: Terms, joints: Collection[str], unseen: Collection[str]
) -> tuple[Region, ...]:
    """Where what terms leave stands out most of the noise, one region of each joint, everywhere if it does nowhere.

    Of the joints `unseen`, where that is in held-out data.
    """
    regions = []
    for part, residual, places, names in (
        (evaluator.train, evaluator.train.residual(terms), joints, ()),
        (evaluator.holdout, evaluator.residuals.holdout_residual(terms), unseen, holdout_names(evaluator)),
    ):
        for at in places:
            region = next(iter(part.stand_out(residual, at, most=1)), everywhere(at=at, units=part.units(at)))
            regions.append(replace(region, held_out=names))
    return tuple(regions)


def what_is_open(groups: Sequence[tuple[str, ...]], tables: Sequence[str], is_left: bool) -> Finding | None:
    """Return what would settle what is open at joints, or that nothing would; None if nothing is open."""
    if groups:
        return Finding(Kind.TIED, effects=groups[0])
    if tables:
        return Finding(Kind.TABLE_HELPS, effects=tuple(tables))
    return Finding(Kind.NO_EFFECT_OPEN) if is_left else None


ARM = Case(
    prepare=prepare,
    evaluator=make_evaluator,
    search=search,
    refit=lambda found, start: found,
    refine=refine,
    unexplained=find_regions,
    present=lambda trial, step: step,
    conclude=conclude,
    reveal=lambda data, base, kind: data,
    treatments=(time_beside_effects,),
)
