"""Case of an arm: effects at its joints by the torque of all joints; nothing is simulated or suggested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.data.fit_data import FitData
from estimators.data.regions import find_regions_at
from estimators.diagnosis.case import Case, Setting, Trial
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.treatments import align_with_effects, include_payload
from estimators.findings import Finding, Kind
from estimators.schemes.identifiability import find_undetermined_links
from estimators.selection.errors import Terms
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.physical import find_driving_friction
from estimators.selection.search import SearchResult, search
from estimators.selection.tables import find_explaining_law
from estimators.signals.residual import Region, make_region_everywhere
from estimators.weak_form.windows import concatenate_samples
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import find_body, find_links, place_effects
from pendulum_env.physics.table import TABLES
from pendulum_env.physics.terms import list_ids
from pendulum_env.recording import Recording


def prepare(recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> tuple[FitData, Setting]:
    """Take the recordings as they are, with columns of all terms that may be fitted."""
    known = list_ids(setting.base)
    library = {id: kind for id, kind in setting.library.items() if id not in known}
    data = FitData.of(recordings, holdout, (*setting.base, *library.values()))
    return data, replace(setting, library=library)


def make_evaluator(data: FitData, setting: Setting) -> ModelEvaluator:
    """Make the evaluator of models; every table may compete at every joint."""
    return setting.evaluator(data.parts, place_effects(TABLES.values(), find_links(setting.base)))


def refine(trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
    """Withhold parameters that the recordings do not determine."""
    *others, last = trial.found.steps
    body, data = find_links(trial.setting.base), trial.evaluator.train.data
    seen = (concatenate_samples([w.samples for w in data.part(at).windows]) for at in body.joints)
    motion = zip(*((x.position, x.velocity, x.torque) for x in seen), strict=True)
    model = last.model.withhold(find_undetermined_links(last.model, *map(np.column_stack, motion)))
    return replace(trial.found, steps=[*others, replace(last, model=model)]), ()


def find_residuals(evaluator: ModelEvaluator, terms: Terms) -> tuple[dict[str, float], list[Region]]:
    """Return the residual of each joint that is no noise [N m], and the region where it stands out most.

    The residual is its correlated part if that is significant, else its RMS. Held-out data count at joints whose fitted
    data leave noise only.
    """
    sizes, regions, criterion = dict[str, float](), list[Region](), evaluator.criterion
    residuals = evaluator.train.residual(terms), evaluator.residuals.holdout_residual(terms)
    parts = zip(evaluator.parts, residuals, ((), evaluator.holdout.names), strict=True)
    for (part, residual, names), found in zip(parts, evaluator.residuals.structures(terms), strict=True):
        for at, own in found.items():
            floor = max(evaluator.residuals.noise_floor(part, at), part.data.negligible(at))
            if at not in sizes and not criterion.is_noise(own, floor):
                sizes[at] = own.correlated_rms if own.z_score > criterion.z_score else own.rms
                places = find_regions_at(part, residual, at, most=1)
                region = places[0] if places else make_region_everywhere(at=at, units=part.units(at))
                regions.append(replace(region, held_out=names))
    return sizes, regions


def conclude(trial: Trial, found: Diagnosis) -> Diagnosis:
    """Add the residual of each joint, tables that explain it, and the next step."""
    evaluator, terms = trial.evaluator, trial.terms
    left, regions = find_residuals(evaluator, terms)
    joints = [region.at for region in regions if not region.held_out]
    by_law = ([table for table in evaluator.tables if table.at == at] for at in joints)
    tables = tuple(id for laws in by_law if (id := find_explaining_law(evaluator, terms, laws)) is not None)
    forbidden = Finding(Kind.NO_EFFECT_OPEN) if left else None
    if left and not joints:
        forbidden = Finding(Kind.FIT_HELD_OUT, recordings=evaluator.holdout.names)
    elif found.ambiguous:
        forbidden = Finding(Kind.TIED, effects=found.ambiguous[0])
    elif tables:
        forbidden = Finding(Kind.TABLE_HELPS, effects=tables)
    carried = (treatment for treatment in trial.data.treatments if treatment.kind is Kind.PAYLOAD)
    findings = (*carried, *find_driving_friction(trial.unbounded(found.model)), *trial.data.corrections)
    return replace(found, findings=findings, forbidden=forbidden, tables=tables, left=left)


ARM = Case(
    takes=lambda base, recordings: isinstance(find_body(base), Body),
    prepare=prepare,
    evaluator=make_evaluator,
    search=search,
    refit=lambda found, start: found,
    refine=refine,
    unexplained=lambda trial: find_residuals(trial.evaluator, trial.terms)[1],
    present=lambda trial, step: step,
    conclude=conclude,
    reveal=lambda data, base, kind: data,
    treatments=(include_payload, align_with_effects),
)
