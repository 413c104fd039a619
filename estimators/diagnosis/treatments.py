"""Candidate treatments of the recordings: functions from a trial to treated data, and the decision on each."""

from dataclasses import replace
from functools import partial

from estimators.arms.payload import Payload, detect_payloads
from estimators.data.fit_data import FitData
from estimators.data.fits import find_inertia_of_noise
from estimators.decisions.decision import Decision, decide
from estimators.decisions.gate import Gate
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.result import TriedTreatment
from estimators.diagnosis.setting import Setting
from estimators.findings import Finding, Kind, Quantity
from estimators.selection.evidence import Evidence, Hypothesis
from estimators.selection.policies import ADD_STOP, FOLLOW, SWAP, TIE
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import find_links
from pendulum_env.arms.recording import add_payload
from pendulum_env.physics import BASE, Term, list_ids
from pendulum_env.recording.channel import NEWTON_METRE

GOALS = {Kind.GOALS_HELD, Kind.GOALS_RUN_ON}
INPUTS = {Kind.PAYLOAD, *GOALS}  # treatments of payloads or goals, with the same rows
TIMES = {Kind.TIMED_BESIDE, Kind.TIMED_AS_LOGGED}  # treatments of the time of the torque
PURPOSES = {Kind.IMPACTS_INCLUDED: ADD_STOP, Kind.NARROWER_WINDOWS: FOLLOW}  # windows in contact, and near reversals


def choose_treatment(case: Case, data: FitData, setting: Setting) -> tuple[Trial, tuple[TriedTreatment, ...]]:
    """Search for effects in the data and under each candidate treatment; return the kept trial and all tried ones.

    If a treatment is kept, all treatments are tried again on its data.
    """
    best, tried, waiting = Trial.search(case, data, setting), list[TriedTreatment](), list(case.treatments)
    while waiting:
        treated = waiting.pop(0)(best)
        if treated is None:
            continue
        trial = Trial.search(case, treated, setting)
        tried.append(decide_treatment(trial, best))
        if tried[-1].is_kept:
            best, waiting = trial, list(case.treatments)
    return best, tuple(tried)


def decide_treatment(trial: Trial, best: Trial) -> TriedTreatment:
    """Decide whether a treated trial takes the place of the best trial so far.

    Its model must predict significantly better, or equally well by no more assumptions; see `_make_hypotheses` for the
    data. A treatment with a purpose must serve it, see `PURPOSES`.
    """
    treatment = find_treatment(trial, best)
    counts = count_assumptions(trial), count_assumptions(best)
    after, before = _make_hypotheses(trial, best, treatment)
    decision = decide(after, before, SWAP)
    if not decision.passed:
        equal = decide(after, before, TIE).join(Decision((Gate("assumptions", *counts, counts[0] <= counts[1]),)))
        decision = equal if equal.passed else decision.join(equal)
    if decision.passed and treatment.kind in PURPOSES:
        decision = decision.join(decide(after, before, PURPOSES[treatment.kind]))
    return TriedTreatment(treatment, decision, *counts)


def find_treatment(trial: Trial, best: Trial) -> Finding:
    """Return the treatment that only the data of the first trial have."""
    return next(treatment for treatment in trial.data.treatments if treatment not in best.data.treatments)


def _make_hypotheses(trial: Trial, best: Trial, treatment: Finding) -> tuple[Hypothesis, Hypothesis]:
    """Return the models of a treated trial and of the best one, on data with the same rows.

    The treated data serve both. If the treatment changes payloads or goals, each model has its own data. If it changes
    the time of the torque, the windows are those of the torque as logged, and each model has its own torque in these.
    """
    of_trial, of_best = trial.evidence, best.evidence if treatment.kind in INPUTS else trial.evidence
    if treatment.kind in TIMES:
        logged = trial.data.without_timing()
        moved = (logged.move_logged_torque(each.data.timing) for each in (trial, best))
        of_trial, of_best = (trial.case.make_evidence(data, trial.setting) for data in moved)
        of_trial = _with_link(of_trial, trial)
    if treatment.kind not in INPUTS:
        of_best = _with_link(of_best, best)
    after = Hypothesis(of_trial, trial.result.terms, trial.result.steps[-1])
    return after, Hypothesis(of_best, best.result.terms)


def _with_link(evidence: Evidence, trial: Trial) -> Evidence:
    """Return the evidence with states of the link of a trial; unchanged without a link."""
    linked = trial.evidence.fits.linked
    return evidence if linked is None else evidence.with_fits(evidence.fits.with_link(linked))


def count_assumptions(trial: Trial) -> int:
    """Return the number of effects, payloads, windows in contact, added base terms, and corrected timing.

    Goals that run on count as one, since held goals are the default. Excluded recordings do not count, as a test
    detected them.
    """
    counted = Kind.IMPACTS_INCLUDED, Kind.BACK_EMF_INCLUDED, Kind.PAYLOAD
    kinds = [treatment.kind for treatment in trial.data.treatments]
    run_on = [kind for kind in kinds if kind in GOALS][-1:] == [Kind.GOALS_RUN_ON]
    return len(trial.result.steps) - 1 + trial.data.timing.has_moved + sum(kind in counted for kind in kinds) + run_on


def narrow_windows(trial: Trial) -> FitData | None:
    """Return data with narrower windows, closer to reversals, if torque leaves only noise but motion does not."""
    evidence, found = trial.evidence, trial.result
    if trial.data.has_treatment(Kind.NARROWER_WINDOWS):
        return None
    if not evidence.residuals.is_noise_by_part(found.terms)[0] or not evidence.motion.is_misfit(found.steps[-1]):
        return None
    share = evidence.criterion.shorter_window
    cut = replace(trial.data.cut, window_share=share)
    return trial.data.with_treatment(Finding(Kind.NARROWER_WINDOWS, {"share": Quantity(share)}), cut=cut)


def scale_noise_by_model(trial: Trial) -> FitData | None:
    """Return data with windows and noise floor by the inertia of the trial's model; see `find_inertia_of_noise`."""
    train = trial.evidence.train
    if (inertia := find_inertia_of_noise(train, trial.result.terms, trial.setting.criterion)) is None:
        return None
    numbers, unit = {"inertia": inertia.value, "before": train.data.base_inertia}, train.units().unit(inertia.unit)
    finding = Finding(Kind.WINDOWS_BY_INERTIA, {name: Quantity(value, unit=unit) for name, value in numbers.items()})
    return trial.data.with_treatment(finding, cut=replace(trial.data.cut, inertia=inertia.value))


def include_contacts(trial: Trial) -> FitData | None:
    """Add windows in contact with a stop, see `add_contacts` of `split`; None for few contacts."""
    if trial.data.has_treatment(Kind.IMPACTS_INCLUDED):
        return None
    data = trial.data.with_contacts(trial.result.terms)
    return None if data is trial.data else data


def exclude_outliers(trial: Trial) -> FitData | None:
    """Return data without recordings that disagree with the others; None if no more are excluded than before."""
    data = (trial.data.whole or trial.data).without_outliers(trial.outliers)
    return data if len(data.recordings) < len(trial.data.recordings) else None


def include_payload(trial: Trial) -> FitData | None:
    """Return data with payloads that only some recordings of an arm show; None without any, or if all is explained."""
    data = trial.data
    if not trial.unexplained or len(data.recordings) + len(data.holdout) < 2:
        return None
    parts = [part.data for part in (data.parts if data.holdout else data.parts[:1])]
    for payload, numbers in detect_payloads(parts, trial.result.terms):
        names = tuple(data.all_recordings[k].name for k in numbers)
        finding = make_payload_finding(payload, find_links(trial.setting.base), names)
        data = data.with_changes(partial(add_payload, load=payload.load), numbers).with_treatment(finding)
    return None if data is trial.data else data


def make_payload_finding(payload: Payload, body: Body, names: tuple[str, ...]) -> Finding:
    """Return the finding on a payload in recordings: mass, centre, and torque RMS of joints without and with it."""
    numbers = {"mass": payload.estimates["m"], **payload.center}
    sizes = {name: Quantity(quantity.value, quantity.std, quantity.unit) for name, quantity in numbers.items()}
    for at, (before, after) in payload.torque_rms.items():
        unit = body.units(at).unit(NEWTON_METRE)
        sizes |= {f"{at}.before": Quantity(before, unit=unit), f"{at}.after": Quantity(after, unit=unit)}
    return Finding(Kind.PAYLOAD, sizes, recordings=names, joints=(payload.joint,))


def align_with_effects(trial: Trial) -> FitData | None:
    """Return data with torque timed under a model with the selected effects, which may imitate or hide a delay.

    None if this was done, if torque is kept as logged, if it needs no correction and all is explained, or if the timing
    agrees.
    """
    known = list_ids((*BASE, *(term for term in trial.data.terms if isinstance(term, Term))))
    effects = [term for term in trial.result.terms if term.id not in known]
    if not effects or any(map(trial.data.has_treatment, (Kind.TIMED_BESIDE, Kind.TIMED_AS_LOGGED))):
        return None
    if not (trial.data.timing.has_moved or trial.data.timing.has_unknown or trial.unexplained):
        return None
    timed = trial.data.with_timing(effects)
    return None if timed.timing.agrees(trial.data.timing) else timed


def keep_logged_time(trial: Trial) -> FitData | None:
    """Return data with torque as logged: an effect that the base model lacks may look like a delay of the log.

    None if this was done, if no torque was corrected, or if the correction leaves only noise without an effect.
    """
    has_effects = len(trial.result.steps) > 1
    if not trial.data.timing.has_moved or trial.data.has_treatment(Kind.TIMED_AS_LOGGED):
        return None
    return trial.data.without_timing() if has_effects or trial.unexplained else None
