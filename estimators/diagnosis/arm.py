"""Which effect is missing at which joint of an arm: the pendulum's search, on the rows of all joints."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from estimators.data.fit_data import FitData
from estimators.diagnosis.ranking import rank_effects
from estimators.diagnosis.result import Diagnosis, corrected
from estimators.diagnosis.setting import Setting
from estimators.diagnosis.unexplained import fit_that, held_out
from estimators.findings import Finding, Kind
from estimators.schemes.identifiability import unidentifiable
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.physical import driving_friction
from estimators.selection.residuals import Terms
from estimators.selection.search import search
from estimators.selection.tables import find_explaining_law
from estimators.signals.residual import Region, everywhere
from estimators.weak_form.windows import concatenate_samples
from pendulum_env.arms.joints import links_of


def examine_arm(given: FitData, setting: Setting) -> Diagnosis:
    """Find the effects at joints that recordings of an arm call for.

    Raises:
        IdentificationError: if a joint hardly moves clear of stick.
    """
    body, evaluator = links_of(setting.base), setting.evaluator(given.parts)
    found = search(evaluator)
    left, unseen = left_at_joints(evaluator, found.terms)
    candidates, groups = rank_effects(found, found.terms)
    by_law = ([table for table in evaluator.tables if table.at == at] for at in left)
    tables = tuple(id for laws in by_law if (id := find_explaining_law(evaluator, found.terms, laws)) is not None)
    forbidden = what_is_open(groups, tables, bool(left or unseen))
    if unseen and not left:
        forbidden = fit_that(evaluator, Kind.FIT_HELD_OUT_OR_PAYLOAD if given.holdout else Kind.FIT_HELD_OUT)
    *others, last = found.steps
    model = last.model.biased() if left or unseen else last.model
    seen = (concatenate_samples([w.samples for w in evaluator.train.data.part(at).windows]) for at in body.joints)
    motion = zip(*((x.position, x.velocity, x.torque) for x in seen), strict=True)
    model = model.withholding(unidentifiable(model, *map(np.column_stack, motion)))
    steps = (*others, replace(last, model=model))
    return Diagnosis(
        steps=steps,
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=where_it_stands_out(evaluator, found.terms, left, unseen),
        floors=evaluator.residuals.floors,
        findings=(*driving_friction(model), *corrected(given)),
        forbidden=forbidden,
        tables=tables,
        data=given.fresh(model.terms),
        left=left | unseen,
        alignments=given.alignments,
        evaluator=evaluator,
    )


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
        (evaluator.holdout, evaluator.residuals.holdout_residual(terms), unseen, held_out(evaluator)),
    ):
        for at in places:
            region = next(iter(part.stand_out(residual, at, most=1)), everywhere(at=at))
            regions.append(replace(region, held_out=names))
    return tuple(regions)


def what_is_open(groups: Sequence[tuple[str, ...]], tables: Sequence[str], is_left: bool) -> Finding | None:
    """Return what would settle what is open at joints, or that nothing would; None if nothing is open."""
    if groups:
        return Finding(Kind.TIED, effects=groups[0])
    if tables:
        return Finding(Kind.TABLE_HELPS, effects=tuple(tables))
    return Finding(Kind.NO_EFFECT_OPEN) if is_left else None
