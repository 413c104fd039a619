"""Case of an arm: effects at its joints by the torque of all joints, without simulation and suggestion."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.data.fit_data import FitData
from estimators.data.standard_errors import widen_by_timing
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.conclusion import conclude_arm
from estimators.diagnosis.options import Options
from estimators.diagnosis.treatments import align_with_effects, include_payload
from estimators.diagnosis.unexplained import find_joint_residuals
from estimators.findings import Finding
from estimators.schemes.identifiability import find_undetermined_links
from estimators.selection.evidence import Evidence
from estimators.selection.search import SearchResult, search
from estimators.weak_form.averages import concatenate_samples
from pendulum_env.arms.joints import find_body, find_links, place_effects
from pendulum_env.physics import TABLES, Term, list_ids
from pendulum_env.recording import Recording


def prepare(recordings: Sequence[Recording], holdout: Sequence[Recording], options: Options) -> tuple[FitData, Options]:
    """Return uncalibrated data with all terms that may be fitted, and options without base terms in the library."""
    ids = list_ids(options.base)
    library = {id: kind for id, kind in options.library.items() if id not in ids}
    terms: list[Term | type[Term]] = [*options.base, *library.values()]
    data = FitData.from_recordings(recordings, holdout, terms, criterion=options.criterion)
    return data, replace(options, library=library)


def make_evidence(data: FitData, options: Options) -> Evidence:
    """Return the evidence of models; every table competes at every joint."""
    return options.make_evidence(data.parts, place_effects(TABLES.values(), find_links(options.base)))


def refine(trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
    """Return the result without parameters of links that the recordings do not determine, and no findings."""
    *others, last = trial.result.steps
    body, data = find_links(trial.options.base), trial.evidence.train.data
    samples = (concatenate_samples([w.samples for w in data.part(at).windows]) for at in body.joints)
    motion = zip(*((x.position, x.velocity, x.torque) for x in samples), strict=True)
    model = last.model.mark_unknown(find_undetermined_links(last.model, *map(np.column_stack, motion)))
    return replace(trial.result, steps=[*others, replace(last, model=model)]), ()


ARM = Case(
    accepts=lambda base, recordings: not find_body(base).can_simulate,
    prepare=prepare,
    make_evidence=make_evidence,
    search=search,
    refit=lambda found, start: found,
    refine=refine,
    unexplained=lambda trial: find_joint_residuals(trial.evidence, trial.terms)[1],
    present=lambda trial, step, _: replace(step, model=widen_by_timing(step.model, trial.data, trial.evidence.train)),
    conclude=conclude_arm,
    show_effect=lambda data, base, kind: data,
    treatments=(include_payload, align_with_effects),
)
