"""Case of a pendulum: effects that explain the recorded torque, confirmed by free-running motion."""

from collections.abc import Sequence
from dataclasses import replace

from estimators.checks.closed_loop import find_feedback
from estimators.checks.remedies import find_remedies, find_turned_torque
from estimators.checks.torque_constant import add_torque_constant, find_gain_doubts
from estimators.data.fit_data import FitData
from estimators.data.fits import fit_within_laws
from estimators.diagnosis.case import Case, Setting, Trial
from estimators.diagnosis.experiment import list_questions, suggest_experiment
from estimators.diagnosis.horizon import refit_to_horizon
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.sensitivity import find_detectable_effects
from estimators.diagnosis.treatments import align_with_effects, exclude_outliers, include_contacts, narrow_windows
from estimators.diagnosis.unexplained import find_holdout_structure, find_unexplained
from estimators.findings import Finding, Kind, Quantity
from estimators.free_swings import is_torque_needed, make_swing_terms, restore_known
from estimators.schemes.identifiability import find_undetermined, find_unidentifiable
from estimators.selection.candidates import refit_nonlinear
from estimators.selection.errors import Step
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.motion import refit_by_likelihood, refit_if_misfit
from estimators.selection.physical import find_violations
from estimators.selection.search import SearchResult, search
from estimators.selection.tables import find_explaining_law
from estimators.signals.measurements import measure_segments
from estimators.signals.residual import Region
from pendulum_env.physics import Model
from pendulum_env.physics.table import COMPETING, TABLES
from pendulum_env.physics.terms import find_untested_ends
from pendulum_env.recording import Recording

ENOUGH = 40  # windows; with fewer, a finding warns


def prepare(recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> tuple[FitData, Setting]:
    """Calibrate the recordings; the base model of free swings has the inertia that scales them."""
    data = FitData.of(recordings, holdout, setting.base)
    return data, replace(setting, base=make_swing_terms(setting.base, data.recordings), original=setting.base)


def make_evaluator(data: FitData, setting: Setting) -> ModelEvaluator:
    """Make the evaluator of models; only tables that the recordings can show compete."""
    data.over(setting.horizon)  # raises an error before the search begins
    is_free = all(recording.known_inertia for recording in data.recordings)
    return setting.evaluator(data.parts, [kind for kind in COMPETING if not (is_free and is_torque_needed(kind))])


def search_by_torque(evaluator: ModelEvaluator) -> SearchResult:
    """Search for effects; with a reversed sign of the logged torque, fit the base model only."""
    if find_contradiction(evaluator) is None:
        return refit_if_misfit(search(evaluator))
    evaluator = replace(evaluator, library={}, tables=())
    model = fit_within_laws(evaluator.train, refit_nonlinear(evaluator, evaluator.base))
    return SearchResult(evaluator, [evaluator.make_step(None, model)])


def find_contradiction(evaluator: ModelEvaluator) -> Finding | None:
    """Find a reversed sign of the logged torque."""
    return find_turned_torque(fit_within_laws(evaluator.train, evaluator.base), evaluator.train.recordings)


def refine(trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
    """Refit the result by likelihood, and withhold parameters that the data do not determine."""
    if find_contradiction(trial.evaluator) is not None:
        return trial.found, ()
    trial.setting.progress("refitting", 0.93)
    found = refit_by_likelihood(trial.found)
    *others, last = found.steps
    measured = [m for recording in trial.data.recordings for m in measure_segments(recording)]
    doubts = find_undetermined(measured, last.model.terms, last.model.units())
    unknown = find_unidentifiable(last.model, measured, doubts)
    model = last.model.withhold({name for doubt in unknown for name in doubt.withheld})
    return replace(found, steps=[*others, replace(last, model=model)]), (*doubts, *unknown)


def find_regions(trial: Trial) -> Sequence[Region]:
    """Find regions of the residual of the final model; all time if the sign of the torque is reversed."""
    cause = find_contradiction(trial.evaluator)
    if cause is None:
        return find_unexplained(trial.final)
    end = float(trial.evaluator.train.samples.time.max())
    return [Region("time", 0.0, end, 0.0, 0.0, is_profiled=False, cause=cause)]


def present(trial: Trial, step: Step) -> Step:
    """Return a step with the torque constant in its model, and with known values as the user gave them."""
    model = add_torque_constant(step.model, trial.data.parts[0].data)
    return replace(step, model=restore_known(model, trial.setting.original, trial.data.recordings))


def conclude(trial: Trial, found: Diagnosis) -> Diagnosis:
    """Add findings on the torque channel, detectable sizes, and the experiment for open questions."""
    found = replace(found, disagreements=trial.outliers)
    channel = find_in_channel(trial, found)
    wrong = find_remedies(trial.unbounded(found.model), trial.data.recordings, found.ambiguous, not found.unexplained)
    if (cause := find_contradiction(trial.evaluator)) is not None:
        return replace(found, findings=(*wrong, *channel), forbidden=cause)
    evaluator, model, regions, doubts = trial.final.evaluator, trial.model, found.unexplained, trial.doubts
    table = trial.found.table.id if trial.found.table is not None and trial.found.table.id in TABLES else None
    if regions and table is None:
        table = find_explaining_law(evaluator, model.terms, TABLES.values())
    kept = None if table is None else Finding(Kind.TABLE_HELPS, effects=(table,))
    trial.setting.progress("looking for the next experiment", 0.95)
    asked = list_questions(evaluator, model.terms, found.ambiguous, found.candidates, doubts)
    if find_violations(model, evaluator.train.motions) or not model.has_known_inertia:
        asked = []  # the motion under another torque is unknown
    limits = trial.setting.limits.with_trusted_torque((trial.data.whole or trial.data).recordings)
    suggestion, hopeless, forbidden = suggest_experiment(evaluator, model, asked, limits, regions)
    if not model.has_known_inertia:
        forbidden = Finding(Kind.INERTIA_UNKNOWN)
    elif regions and not asked:
        forbidden = find_holdout_structure(evaluator, trial.terms) or kept or Finding(Kind.NO_EFFECT_OPEN)
    is_complete = not regions and len(trial.terms) == len(evaluator.base)
    return replace(
        found,
        findings=(
            *wrong,
            *channel,
            *(Finding(Kind.TIED, effects=group) for group in found.ambiguous),
            *_find_few_clusters(evaluator),
            *doubts,
            *_find_untested_ranges(model, *evaluator.train.reach()),
            *([kept] if kept and kept != forbidden else []),
        ),
        detectable=find_detectable_effects(evaluator, trial.terms, evaluator.library) if is_complete else (),
        suggestion=suggestion,
        forbidden=forbidden,
        tables=() if table is None else (table,),
        inseparable=tuple((aim.instead, aim.effect) for aim in hopeless if aim.instead),
    )


def find_in_channel(trial: Trial, found: Diagnosis) -> list[Finding]:
    """Return findings on the torque channel: its constant, the time between torque and motion, and feedback."""
    whole = trial.data.whole or trial.data
    constant, findings = whole.constant, [] if whole.doubt is None else [whole.doubt]
    if constant is not None:
        findings += find_gain_doubts(found.model, constant, whole.parts[0].data)
    findings += whole.corrections
    named = {id for group in found.effects for id in group}
    if named & {"dead_time", "actuator_lag"}:
        findings += whole.find_timing(False)
    elif found.unexplained and whole.find_timing(False):  # not where the effects explain the delay
        findings += whole.with_timing([term for term in found.model.terms if term.id in found.selected]).find_timing(
            False
        )
    return [*findings, *find_feedback(whole.recordings)]


def _find_few_clusters(evaluator: ModelEvaluator) -> list[Finding]:
    """Return a finding where few stretches of motion are clear of stick."""
    count = len(evaluator.train.layout.clusters)
    return [Finding(Kind.FEW_STRETCHES, {"count": Quantity(count)})] if count < ENOUGH else []


def _find_untested_ranges(model: Model, low: float, high: float) -> list[Finding]:
    """Return findings on terms that were tested between two angles [rad] only."""
    ends = {term.id: find_untested_ends(term, low, high, model.units(term.at)) for term in model.terms}
    return [Finding(Kind.UNTESTED_RANGE, own, effects=(id,)) for id, own in ends.items() if own]


PENDULUM = Case(
    takes=lambda base, recordings: True,
    prepare=prepare,
    evaluator=make_evaluator,
    search=search_by_torque,
    refit=refit_by_likelihood,
    refine=refine,
    unexplained=find_regions,
    present=present,
    conclude=conclude,
    reveal=lambda data, base, kind: data.with_contacts(base),
    treatments=(narrow_windows, include_contacts, exclude_outliers, align_with_effects),
    refit_to_horizon=refit_to_horizon,
)
