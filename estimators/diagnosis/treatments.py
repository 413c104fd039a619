"""Candidate treatments of the recordings: functions from a trial to treated data, and the decision on each."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.checks.alignment import NO_ALIGNMENT, Alignment
from estimators.checks.channel import predict_log
from estimators.checks.settings import CHECKS
from estimators.data.fit_data import FitData
from estimators.data.fits import find_inertia_of_noise
from estimators.data.treatment import Action, DataChange, Treatment
from estimators.decisions.decision import NOTHING_TESTED, Decision, Policy, decide
from estimators.decisions.gate import Gate, limit_gain, limit_tie
from estimators.decisions.score import Bootstrap
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.options import Options
from estimators.diagnosis.result import TriedTreatment
from estimators.findings import Finding, Quantity, withhold_everything
from estimators.selection.evidence import Hypothesis
from estimators.selection.policies import ADD_STOP, FOLLOW, HAVE_INERTIA, SWAP, TIE
from pendulum_env.physics import Term, has_link
from pendulum_env.physics.actuation import DeadTime
from pendulum_env.physics.terms import count_parameters

TIMES = {Action.TIMED_BY_MODEL, Action.TIMED_AS_LOGGED}  # treatments of the time of the torque
PURPOSES: Mapping[str, Policy[Hypothesis]] = {
    Action.IMPACTS_INCLUDED: ADD_STOP,  # windows in contact
    Action.NARROWER_WINDOWS: FOLLOW,  # near reversals
    Action.WINDOWS_BY_INERTIA: HAVE_INERTIA,
}


def choose_treatment(case: Case, data: FitData, options: Options) -> tuple[Trial, tuple[TriedTreatment, ...]]:
    """Search for effects in the data and under each candidate treatment; return the kept trial and all tried ones.

    If a treatment is kept, all treatments are tried again on its data.
    """
    best, tried, waiting = Trial.search(case, data, options), list[TriedTreatment](), list(case.treatments)
    while waiting:
        treated = waiting.pop(0)(best)
        if treated is None:
            continue
        trial = Trial.search(case, treated, options)
        tried.append(decide_treatment(trial, best))
        if tried[-1].is_kept:
            best, waiting = trial, list(case.treatments)
    return best, tuple(tried)


def decide_treatment(trial: Trial, best: Trial) -> TriedTreatment:
    """Decide whether a treated trial takes the place of the best trial so far.

    Its model must predict significantly better, or equally well by no more assumptions; see `_make_hypotheses` for the
    data. A treatment of the time of the torque is decided by the density of the log, see `_compare_times`. A treatment
    with a purpose must serve it, see `PURPOSES`.
    """
    treatment = find_treatment(trial, best)
    counts = count_assumptions(trial), count_assumptions(best)
    if isinstance(treatment, Treatment) and treatment.action in TIMES:
        decision, tie = _compare_times(trial, best)
    else:
        after, before = _make_hypotheses(trial, best, treatment)
        decision = decide(after, before, SWAP)
        tie = NOTHING_TESTED if decision.passed else decide(after, before, TIE)
    if not decision.passed:
        equal = tie.join(Decision((Gate("assumptions", *counts, counts[0] <= counts[1]),)))
        decision = equal if equal.passed else decision.join(equal)
    tried = TriedTreatment(treatment, decision, *counts)
    if decision.passed and tried.action in PURPOSES:
        tried = replace(tried, decision=decision.join(decide(after, before, PURPOSES[tried.action])))
    return tried


def find_treatment(trial: Trial, best: Trial) -> Finding:
    """Return the treatment that only the data of the first trial have."""
    return next(treatment for treatment in trial.data.treatments if treatment not in best.data.treatments)


def _make_hypotheses(trial: Trial, best: Trial, treatment: Finding) -> tuple[Hypothesis, Hypothesis]:
    """Return the models of a treated trial and of the best one, on data with the same rows.

    The treated data serve both. If the treatment changes inputs, each model has its own data.
    """
    has_own_data = isinstance(treatment, DataChange) and treatment.has_new_inputs
    of_best, linked = best.evidence if has_own_data else trial.evidence, best.evidence.fits.linked
    if linked is not None and not has_own_data:
        of_best = of_best.with_fits(of_best.fits.with_link(linked))
    after = Hypothesis(trial.evidence, trial.result.terms, trial.result.steps[-1])
    return after, Hypothesis(of_best, best.result.terms)


def _compare_times(trial: Trial, best: Trial) -> tuple[Decision, Decision]:
    """Decide whether a trial predicts the log significantly better than another, and whether both are equally probable.

    Each has its own time of the torque and its own effects, in the same windows. The noise is that of the log.
    """
    criterion = trial.options.criterion
    if not (predicted := _predict_log((trial.data, trial.effects), (best.data, best.effects))):
        failed = Decision((Gate("same_rows", 0, 1, False),))
        return failed, failed
    after, before = predicted
    bootstrap = Bootstrap(after.of_block)
    n_more = trial.data.timing.count_parameters() - best.data.timing.count_parameters()
    penalty = trial.evidence.penalty(trial.result.terms, best.result.terms)
    penalty += max(n_more, 0) * float(np.log(CHECKS.channel.candidates))
    gates = limit_gain(bootstrap.gain(after.density, before.density, penalty), penalty, criterion.p_value)
    probability = float(bootstrap.probabilities([after.density, before.density])[0])
    return Decision(tuple(gates)), Decision((limit_tie(probability, criterion.tie_probability),))


def _predict_log(*models: tuple[FitData, Sequence[Term]]) -> list[Alignment]:
    """Predict the log of the same recordings, each under the timing of some data and with some effects."""
    data = models[0][0]
    logged = data.without_timing().all_recordings
    timed = (
        (each.timing.alignments or (NO_ALIGNMENT,) * len(logged), (*each.base_terms, *effects))
        for each, effects in models
    )
    return predict_log(logged, timed, data.criterion)


def count_assumptions(trial: Trial) -> int:
    """Return the number of free parameters of the effects and of the timing, and the assumptions of the treatments.

    A later decision on the same topic takes the place of an earlier one.
    """
    data = trial.data
    changes = [treatment for treatment in data.treatments if isinstance(treatment, DataChange)]
    last = {change.topic or str(k): change for k, change in enumerate(changes)}
    n_assumptions = sum(change.n_assumptions for change in last.values())
    return count_parameters(trial.effects) + data.timing.count_parameters() + n_assumptions


def narrow_windows(trial: Trial) -> FitData | None:
    """Return data with narrower windows, closer to reversals, if torque leaves only noise but motion does not.

    Also if the inertia is undetermined: its motion cannot be simulated.
    """
    evidence, found = trial.evidence, trial.result
    if Action.NARROWER_WINDOWS in trial.data.actions:
        return None
    follows_motion = trial.model.has_known_inertia and not evidence.motion.is_misfit(found.steps[-1])
    if not evidence.residuals.is_noise_by_part(found.terms)[0] or follows_motion:
        return None
    share = evidence.criterion.shorter_window
    cut = replace(trial.data.cut, window_share=share)
    return trial.data.with_treatment(Treatment(Action.NARROWER_WINDOWS, {"share": Quantity(share)}), cut=cut)


def scale_noise_by_model(trial: Trial) -> FitData | None:
    """Return data with windows and noise floor by the inertia of the trial's model; see `find_inertia_of_noise`."""
    train = trial.evidence.train
    if (inertia := find_inertia_of_noise(train, trial.result.terms, trial.options.criterion)) is None:
        return None
    values, unit = {"inertia": inertia.value, "before": train.data.base_inertia}, train.units().unit(inertia.unit)
    sizes = {name: Quantity(value, unit=unit) for name, value in values.items()}
    treatment = Treatment(Action.WINDOWS_BY_INERTIA, sizes)
    return trial.data.with_treatment(treatment, cut=replace(trial.data.cut, inertia=inertia.value))


def include_contacts(trial: Trial) -> FitData | None:
    """Add windows in contact with a stop, see `add_contacts` of `split`; None for few contacts.

    A link, which has impacts of its own, is left out of the model that shows them.
    """
    if Action.IMPACTS_INCLUDED in trial.data.actions:
        return None
    data = trial.data.with_contacts([term for term in trial.result.terms if not has_link([term])])
    return None if data is trial.data else data


def exclude_outliers(trial: Trial) -> FitData | None:
    """Return data without recordings that disagree with the others; None if no more are excluded than before."""
    data = (trial.data.whole or trial.data).without_outliers(trial.outliers)
    return data if len(data.recordings) < len(trial.data.recordings) else None


def align_with_effects(trial: Trial) -> FitData | None:
    """Return data with torque timed under the found model alone, which shows shorter delays than nearly any law does.

    A dead time after the correction of a delay is the excess of this delay, and shortens it. Other effects may have
    been found because torque is late: it is timed under the fewest of them, see `_time_by_fewest`.

    None if this was done, if torque is kept as logged, if no parameter is determined, if the timing agrees, or if it
    contradicts the one beside nearly any law: the few columns of a wrong model may hide a delay, or imitate one.
    """
    data, model, effects = trial.data, trial.result.steps[-1].model, trial.effects
    dead_times = [term for term in effects if isinstance(term, DeadTime) and data.timing.is_late_at(term.at)]
    done = [
        treatment for treatment in data.treatments if isinstance(treatment, Treatment) and treatment.action in TIMES
    ]
    for term in dead_times:
        if all(term.id not in treatment.effects for treatment in done):
            return data.with_shorter_delay(term.at, model.estimates[term.get_full_name("dead_time")], effects)
    if done or withhold_everything(trial.doubts):
        return None
    timed = _time_by_fewest(data, effects, data.with_timing(effects))
    return None if data.timing.contradicts(timed.timing) or timed.timing.agrees(data.timing) else timed


def _time_by_fewest(data: FitData, effects: Sequence[Term], timed: FitData) -> FitData:
    """Return data timed under the fewest of some effects, by dropping effects without which late torque fits as well.

    `timed` are the data that were timed under all effects.
    """
    for effect in effects:
        fewer = [other for other in effects if other is not effect]
        simpler = data.with_timing(fewer)
        predicted = _predict_log((timed, effects), (simpler, fewer)) if simpler.timing.has_moved else []
        if predicted and not predicted[0].beats(predicted[1]):
            return _time_by_fewest(data, fewer, simpler)
    return timed


def keep_logged_time(trial: Trial) -> FitData | None:
    """Return data with torque as logged: an effect that the base model lacks may look like a delay of the log.

    None if this was done, if no torque was late, or if the correction leaves only noise without an effect. Torque that
    is sampled instead of held is no delay.
    """
    has_effects = len(trial.result.steps) > 1
    if not trial.data.timing.has_delay or Action.TIMED_AS_LOGGED in trial.data.actions:
        return None
    return trial.data.without_timing() if has_effects or trial.unexplained else None
