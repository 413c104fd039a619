"""Diagnosis: which physical effects does the model lack?"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.arguments import (
    Recordings,
    Terms,
    chosen_effects,
    chosen_recordings,
    chosen_terms,
    that_may_show,
    within_limits,
)
from estimators.checks.closed_loop import feedback
from estimators.checks.homogeneity import Disagreement, disagreements, own_fits
from estimators.checks.remedies import remedies, turned_round
from estimators.checks.torque_constant import of_the_drive, told
from estimators.data.fit_data import FitData
from estimators.data.regression_data import fit_terms
from estimators.diagnosis.arm import examine_arm
from estimators.diagnosis.experiment import USUAL, Limits, questions, suggest
from estimators.diagnosis.in_loop import diagnose_in_loop
from estimators.diagnosis.ranking import rank_effects
from estimators.diagnosis.result import Diagnosis, corrected
from estimators.diagnosis.sensitivity import detectable
from estimators.diagnosis.setting import Setting
from estimators.diagnosis.unexplained import of_held_out, unexplained
from estimators.findings import Finding, Kind, Quantity
from estimators.free_swings import restore_known, swing_terms
from estimators.in_loop.rollouts import are_driven
from estimators.progress import Progress, forward, no_progress
from estimators.schemes.identifiability import identifiability, untold
from estimators.selection.candidates import refit_nonlinear
from estimators.selection.criterion import Criterion
from estimators.selection.evaluator import ModelEvaluator, held_out_cost
from estimators.selection.motion import is_misfit, refit_by_likelihood, refit_if_misfit
from estimators.selection.physical import violations
from estimators.selection.search import SearchResult, search
from estimators.selection.tables import find_explaining_law
from estimators.signals.measurements import measure_segments
from estimators.signals.residual import Region
from estimators.weak_form.instruments import fit_by_reference
from pendulum_env.arguments import check_order
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import body_of
from pendulum_env.mistake import Mistake
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.physics.limits import Bounds
from pendulum_env.physics.table import TABLES
from pendulum_env.physics.terms import ids, untested_ends
from pendulum_env.recording import Recording
from pendulum_env.recording.record import NEWTON_METRE
from pendulum_env.recording.study import format_of

BOLDER = 10.0  # times the largest recorded torque, which a motor is not asked for without a word
PLENTY = 40  # stretches of motion, below which little can be told


def diagnose(
    recordings: Recordings,
    holdout: Recordings = (),
    base: Terms = BASE,
    progress: Progress = no_progress,
    *,
    max_torque: float | None = None,
    max_angle: float | None = None,
    max_speed: float | None = None,
    library: Mapping[str, type[Term]] | None = None,
    only: Sequence[str] | None = None,
    without: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
    bounds: Bounds | None = None,
    criterion: Criterion | None = None,
    rng: np.random.Generator | None = None,
    by_reference: bool = False,
) -> Diagnosis:
    """Find the effects that the base model lacks.

    Torque that is logged late or filtered is corrected first: no effect acts before its cause. Where that is otherwise
    beside the effects that are found, it is corrected so, and they are looked for anew. Recordings that disagree with
    the others are named and not fitted: no effect of one plant explains two plants. Known loads are no part of the
    model; where a current was logged, they tell the torque constant, and without them all is per ampere.

    Of an arm, effects are looked for at its joints, by torque alone: nothing is simulated or suggested.

    Args:
        recordings: fitted jointly.
        holdout: to confirm on; without them the last 30 % of each recording, or of its motion where that comes late.
        base: at least one term to start from, as it is or by id; of an arm `arm_base(body)`, or `Links(body)` first.
        progress: called with what is being done and the share that is done.
        max_torque: bound of the experiment's torque [N m]; by default the paper's 6 N m, at most ten times the largest
            recorded, and no less than that.
        max_angle: bound of its angle to either side of hanging down [rad], infinity for any; by default the angles that
            were recorded, or any within the same number of turns where the joint turned.
        max_speed: bound of its speed [rad/s]; by default the highest that was recorded.
        library: effects that may be named, by id; by default all that are known.
        only: ids of those that are looked for; by default all. Of an arm `stribeck`, or `stribeck@elbow` at one joint.
        without: ids of effects that the joint cannot have.
        fixed: values that are known, by name of the parameter: `{"gravity": 2.01}`.
        bounds: of other parameters: `{"stribeck": (0.0, 0.5), "cogging.order": (10, None)}`; None is no limit.
        criterion: what effects have to achieve.
        rng: of the bootstrap; the same seed gives the same result, and so does none.
        by_reference: fit the base model by instruments made of the reference; effects by least squares all the same.

    Raises:
        IdentificationError: if the recordings hold too little motion, or no reference that instruments need.
        ValueError: if a name is unknown.
        TypeError: if something else is given than recordings and terms.
    """
    kinds = (recordings, Recording), (holdout, Recording), (base, Term | Model)
    check_order("diagnose(recordings, holdout, base)", *kinds)
    terms = chosen_terms(base)
    body = body_of(terms)
    terms, effects = within_limits(terms, chosen_effects(library, only, without, body), fixed, bounds)
    fitted, unseen = chosen_recordings(recordings, body=body), chosen_recordings(holdout, empty=True, body=body)
    effects, limits = that_may_show(effects, fitted), Limits(max_torque, max_angle, max_speed)
    rng, progress = rng or np.random.default_rng(0), forward(progress)
    setting = Setting(terms, effects, criterion or Criterion(), rng, progress, limits, by_reference=by_reference)
    found = _examined(fitted, unseen, setting)
    return replace(found, steps=(*found.steps[:-1], found.steps[-1].with_log_format(format_of(fitted))))


def _examined(recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> Diagnosis:
    """Find the effects by what was recorded: an arm, a servo with its controller, or a joint and its torque."""
    if isinstance(body_of(setting.base), Body):
        if setting.by_reference or setting.limits != Limits():
            raise Mistake("by_reference and bounds of an experiment are for pendulums alone: leave them out for an arm")
    elif are_driven([*recordings, *holdout]):
        return diagnose_in_loop(recordings, holdout, setting)
    return _by_torque(recordings, holdout, setting)


def _by_torque(recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> Diagnosis:
    """Find the effects that recorded torque calls for; timed anew where an effect explains its delay."""
    setting.progress("reading the motion", 0.0)
    base = setting.base
    if is_arm := isinstance(body_of(setting.base), Body):
        known, examine = ids(setting.base), examine_arm
        setting = replace(setting, library={id: kind for id, kind in setting.library.items() if id not in known})
        terms: tuple[Term | type[Term], ...] = (*setting.base, *setting.library.values())
        calibrated = FitData.of(recordings, holdout, terms)
    else:
        calibrated = FitData.of(recordings, holdout, setting.base)
        known, examine = ids(BASE), _of_one_plant
        setting = replace(setting, base=swing_terms(base, calibrated.recordings))
    setting.progress("timing the torque", 0.0)
    given = calibrated.timed()
    found = examine(given, setting)
    beside = [term for term in found.model.terms if term.id not in known]
    if beside and (given.has_moved or found.unexplained):  # an effect may look like a delay, or hide one
        again = calibrated.timed(beside)
        if not again.agrees(given):
            given, found = min((again, examine(again, setting)), (given, found), key=_complexity)
    setting.progress("done", 1.0)
    if is_arm:
        return found
    steps = (replace(step, model=restore_known(step.model, base, given.recordings)) for step in found.steps)
    return _with_channel(replace(found, steps=tuple(steps)), given)


def _complexity(timed: tuple[FitData, Diagnosis]) -> tuple[bool, int, int]:
    """Sort key of diagnoses under several timings, the one first that explains everything, or most, by least."""
    given, found = timed
    return bool(found.unexplained), len(found.disagreements), len(found.selected) + given.has_moved


def _usual_torque(given: FitData) -> float:
    """Torque that an experiment may ask of the motor where no bound is given, in the unit of the recordings."""
    largest = max(float(np.abs(recording.torque).max()) for recording in given.recordings)
    trusted = min(USUAL, BOLDER * largest) if given.unit == NEWTON_METRE else 0.0
    return max(trusted, largest)


def _with_channel(found: Diagnosis, given: FitData) -> Diagnosis:
    """A diagnosis with what was found of the torque channel."""
    wrong = remedies(found.model, given.recordings, found.ambiguous)
    constant = given.constant
    return replace(
        found,
        torque_unit=given.unit,
        torque_constant=constant,
        alignments=given.alignments,
        findings=(
            *wrong,
            *filter(None, [given.doubt]),
            *(of_the_drive(found.model, constant, given.parts[0].data) if constant is not None else ()),
            *_of_timing(given, found),
            *feedback(given.recordings),
            *(own for own in found.findings if own not in wrong),
        ),
    )


def _of_one_plant(given: FitData, setting: Setting) -> Diagnosis:
    """Find the effects that the recordings of one plant call for, and which recordings are another plant's.

    What no effect explains in all recordings together may be another plant: an effect that each recording alone takes
    for parameters of its own shows only in all of them.
    """
    usual = _usual_torque(given)
    limits = replace(setting.limits, torque=setting.limits.torque or usual, usual=usual)
    setting = replace(setting, limits=limits)
    datasets = [part.data for part in (given.parts if given.holdout else given.parts[:1])]
    kept, found, odd = given, _examine(given, setting), dict[int, Disagreement]()
    named = disagreements(own_fits(datasets, setting.base), only_if_all_fit=True) if found.unexplained else ()
    while True:
        named = named or disagreements(own_fits(datasets, found.model.terms))
        more = odd | {one.recording: one for one in named}
        left = len(given.without(more).recordings)
        odd = more if left else odd  # where every recording would be another plant's, what was said before stands
        if left in (0, len(kept.recordings)):
            break
        kept, named = given.without(odd), ()
        found = _examine(kept, setting)
    *others, last = (replace(step, model=told(step.model, kept.parts[0].data)) for step in found.steps)
    return replace(
        found,
        steps=(*others, replace(last, model=last.model.biased()) if found.unexplained else last),
        disagreements=tuple(odd[number] for number in sorted(odd)),
    )


def _of_timing(given: FitData, found: Diagnosis) -> list[Finding]:
    """Findings on the time between torque and motion: what was corrected, and what the drive may have done.

    The latter is asked again beside the effects that were found, and not at all where they explain everything: then
    what looked like a delay of the drive was theirs.
    """
    moved = corrected(given)
    named = {id for group in found.effects for id in group}
    if named & {"dead_time", "actuator_lag"}:
        return [*moved, *given.timing(False)]
    if not (found.unexplained and given.timing(False)):
        return moved
    beside = [term for term in found.model.terms if term.id in found.selected]
    return [*moved, *given.timed(beside).timing(False)]


def _examine(given: FitData, setting: Setting) -> Diagnosis:
    """Find the effects that recordings of one plant call for."""
    first = evaluator = setting.evaluator(given.parts)
    followed = fit_by_reference(given.parts[0].data, setting.base) if setting.by_reference else None
    if (mislogged := _mislogged(given, evaluator)) is not None:
        return mislogged
    rough, given = _looked_closer(given, evaluator, setting)
    setting.progress("refitting", 0.93)
    found = refit_by_likelihood(rough)
    evaluator, steps = found.evaluator, found.steps
    if followed is not None:
        steps = [evaluator.make_step(None, followed), *steps[1:]]
    final = (rough.steps if ids(rough.terms) == ids(steps[-1].model.terms) else steps)[-1].model.terms
    measured = [m for recording in given.recordings for m in measure_segments(recording)]
    doubts = identifiability(measured, steps[-1].model.terms)
    unknown = untold(steps[-1].model, measured, doubts)
    doubts = (*doubts, *unknown)
    last = steps[-1].model.withholding({name for doubt in unknown for name in doubt.withheld})
    steps = [*steps[:-1], replace(steps[-1], model=last)]
    candidates, groups = rank_effects(replace(found, steps=steps), final, doubts)
    setting.progress("looking for the next experiment", 0.95)
    left, held_out = unexplained(replace(found, steps=steps)), of_held_out(evaluator, final)
    table = found.table.id if found.table is not None and found.table.id in TABLES else None
    if left and table is None:
        table = find_explaining_law(evaluator, steps[-1].model.terms, TABLES.values())
    kept = None if table is None else Finding(Kind.TABLE_HELPS, effects=(table,))
    asked = questions(evaluator, steps[-1].model.terms, groups, candidates, doubts)
    if violations(last, evaluator.train.motions) or not last.has_known_inertia:
        asked = []  # the motion under another torque is unknown
    suggestion, hopeless, forbidden = suggest(evaluator, steps[-1].model, asked, setting.limits, left)
    if not last.has_known_inertia:
        forbidden = Finding(Kind.INERTIA_UNKNOWN)
    elif left and not asked:
        forbidden = held_out or kept or Finding(Kind.NO_EFFECT_OPEN)
    would_show = (
        () if left or len(final) > len(evaluator.base) else detectable(evaluator, tuple(final), evaluator.library)
    )
    return Diagnosis(
        steps=tuple(steps),
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=tuple(left),
        floors=evaluator.residuals.floors,
        findings=(
            *(Finding(Kind.TIED, effects=group) for group in groups),
            *_of_little(len(first.train.layout.clusters)),
            *doubts,
            *_untested(steps[-1].model.terms, *first.train.reach()),
            *([kept] if kept and kept != forbidden else []),
        ),
        detectable=would_show,
        suggestion=suggestion,
        forbidden=forbidden,
        tables=() if table is None else (table,),
        inseparable=tuple((aim.instead, aim.effect) for aim in hopeless if aim.instead),
        data=given.fresh(),
        evaluator=evaluator,
    )


def _mislogged(given: FitData, evaluator: ModelEvaluator) -> Diagnosis | None:
    """What is said of torque that is logged turned round, if it is: no effect is named before that is mended."""
    cause = turned_round(fit_terms(evaluator.train, evaluator.base)[0], given.recordings)
    if cause is None:
        return None
    step = evaluator.fit_with_std(None, refit_nonlinear(evaluator, evaluator.base))
    region = Region("time", 0.0, float(evaluator.train.samples.time.max()), 0.0, 0.0, is_profiled=False, cause=cause)
    return Diagnosis((step,), (), (), (region,), evaluator.residuals.floors, (cause,), forbidden=cause, data=given)


def _looked_closer(given: FitData, evaluator: ModelEvaluator, setting: Setting) -> tuple[SearchResult, FitData]:
    """What was found, and the data in which it was.

    What happens near turns shows in windows that come closer to them, if through more noise, and in those near turns
    that miss more torque than dry friction can be.
    """
    rough = refit_if_misfit(search(evaluator))
    if rough.evaluator.residuals.is_noise_by_part(rough.terms)[0] and is_misfit(rough.evaluator, rough.steps[-1]):
        closer = given.closer(evaluator.criterion.shorter_window)
        found = refit_if_misfit(search(setting.evaluator(closer.parts)))
        if len(found.steps) > 1 and held_out_cost(found.steps[-1]) < held_out_cost(rough.steps[-1]):
            rough, given = found, closer
    struck = given.with_impacts(rough.terms)
    if struck is not given:
        found = refit_if_misfit(search(setting.evaluator(struck.parts)))
        before = found.evaluator.make_step(None, rough.steps[-1].model)
        if len(found.steps) > 1 and found.evaluator.is_confirmed(found.steps[-1], before):
            rough, given = found, struck
    return rough, given


def _of_little(count: int) -> list[Finding]:
    """Return a finding where few stretches of motion are clear of stick."""
    return [Finding(Kind.FEW_STRETCHES, {"count": Quantity(count)})] if count < PLENTY else []


def _untested(terms: Sequence[Term], low: float, high: float) -> list[Finding]:
    """Find terms that were tested between two angles [rad] only."""
    ends = {term.id: untested_ends(term, low, high) for term in terms}
    return [Finding(Kind.UNTESTED_RANGE, own, effects=(id,)) for id, own in ends.items() if own]
