"""Case of servos: effects are found by simulating each servo with its controller in the loop.

Friction at rest, sticking and breaking away show in the distance between a servo and its goal. A regression of torque
on motion omits rest, and torque of a controller is a function of the position itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.checks.remedies import find_remedies
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.data.split import HELD_OUT
from estimators.diagnosis.case import Case, Setting, Trial
from estimators.diagnosis.result import Diagnosis
from estimators.findings import Finding, Kind, Quantity
from estimators.in_loop.fit import LOOP
from estimators.in_loop.goals import (
    has_unpowered_motor,
    make_base,
    read_goals,
    select_voltage_drives,
    with_goals,
)
from estimators.in_loop.refit import fit_step, refine_rows, refit_step
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.in_loop.rollouts import Rollouts, are_driven
from estimators.selection.errors import Step, Terms, get_single
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.physical import compute_significant_sign
from estimators.selection.search import SearchResult, search
from estimators.signals.residual import Region, make_region_everywhere
from estimators.simulation.output_error import Point
from estimators.weak_form.torque_rows import TorqueRows
from estimators.weak_form.torque_windows import cut_all
from estimators.weak_form.windows import WHOLE, Part
from pendulum_env.physics import Model, Term
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.estimate import SIGNIFICANT
from pendulum_env.physics.friction import LoadDependentFriction
from pendulum_env.physics.terms import list_ids
from pendulum_env.recording import Recording
from pendulum_env.servo.torque import compute_asked_torque


def prepare(recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> tuple[FitData, Setting]:
    """Calibrate the recordings; a simulation from goals shows no effect of a sensor."""
    data = FitData.of(recordings, holdout, setting.base)
    base = make_base(data.recordings, setting.base)
    library = {id: kind for id, kind in setting.library.items() if kind.kind != "sensor"}
    criterion = replace(setting.criterion, explained_share=LOOP.needed, needed_share=LOOP.needed)
    data = with_goal_reading(data, base)
    return data, replace(setting, base=base, library=library, criterion=criterion)


def with_goal_reading(data: FitData, base: Sequence[Term]) -> FitData:
    """Return the data with goals that are held or run on between rows, decided once, by the base model."""
    reading = read_goals(data.recordings, base, fitted_part(data))
    if reading is None and all(own.drive is None or own.drive.goal for own in data.holdout):
        return data
    is_held = reading is None or reading.kind is Kind.GOALS_HELD
    data = replace(data, recordings=with_goals(data.recordings, is_held), holdout=with_goals(data.holdout, is_held))
    return data if reading is None else data.with_treatment(reading)


def fitted_part(data: FitData) -> Part:
    """Return the part of each recording that is fitted: without held-out recordings, its end is held out."""
    return WHOLE if data.holdout else (0.0, 1 - HELD_OUT)


def make_evaluator(data: FitData, setting: Setting) -> ModelEvaluator:
    """Make the evaluator of models on rollouts; without held-out recordings, the end of each is held out.

    Raises:
        IdentificationError: if the recordings hold too little motion to begin with.
    """
    first, last = fitted_part(data), WHOLE if data.holdout else (1 - HELD_OUT, 1.0)
    fitted, unseen = data.recordings, data.holdout or data.recordings
    if data.has_treatment(Kind.BACK_EMF_INCLUDED):
        setting = replace(setting, base=(*setting.base, BackEmf()))
    windows = RegressionData.of(fitted, part=first).torque
    train = RolloutRows(Rollouts(fitted, shares=first), windows)
    check = RolloutRows(Rollouts(unseen, shares=last), TorqueRows(cut_all(unseen, part=last)), guide=train)
    return setting.evaluator((train.data, check.data))


def refit(found: SearchResult, start: Model | None = None) -> SearchResult:
    """Refit all steps with shorter steps of the integrator."""
    return replace(found, steps=[refit_step(found.evaluator, step) for step in found.steps])


def refine(trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
    """Refit all steps with shorter steps of the integrator, and drop effects that are not needed then.

    An effect is needed if it predicts better and its size is not zero within 3 standard errors. The prediction alone
    does not decide: a servo that sticks a little earlier or later changes whole seconds of the motion.
    """
    found = refit(trial.found)
    last = found.steps[-1]
    train, unseen = refine_rows(found.evaluator)
    evaluator, steps = replace(found.evaluator, train=train.data, holdout=unseen.data), found.steps
    fitted = {list_ids(step.model.terms): step.model.terms for step in steps}
    terms, named = found.terms, [step.added for step in steps[1:]]

    def without(*left_out: str | None) -> Terms:
        return tuple(term for term in terms if term.id not in left_out)

    def find_idle() -> list[str | None]:
        sizeless = {term.id for term in last.model.terms if term.columns and not has_size(last.model, term)}
        return [id for id in named if id in sizeless or not evaluator.is_significant(terms, without(id))]

    while idle := find_idle():
        named.remove(idle[-1])
        rest = without(idle[-1])
        terms = fitted.get(list_ids(rest)) or train.with_nonlinear(rest)
        last = fit_step(found.evaluator, named[-1] if named else None, terms)
    if len(named) == len(steps) - 1:
        return found, ()
    earlier = [fit_step(found.evaluator, id, without(*named[k + 1 :])) for k, id in enumerate(named[:-1])]
    return replace(found, steps=[steps[0], *earlier, *([last] if named else [])]), ()


def has_size(model: Model, term: Term) -> bool:
    """Return whether the linear parameters of a term differ from zero together by more than 3 standard errors."""
    names = list(model.estimates)
    place = [names.index(column.name) for column in term.columns]
    values = np.array([model.estimates[names[k]].value for k in place])
    covariance = model.assumed_covariance[np.ix_(place, place)]
    return bool(values @ np.linalg.pinv(covariance) @ values > SIGNIFICANT**2)


def present(trial: Trial, step: Step) -> Step:
    """Return a step with back-EMF added to viscous friction if recordings do not distinguish the two.

    They do if the motor is ever off, or if friction depends on its torque. Known or bounded friction stays as it is.
    """
    if BackEmf.id not in step.model.estimates or has_unpowered_motor(trial.data.recordings) or has_gear_friction(step):
        return step
    theta = {column.name: value for column, value in zip(step.model.columns, step.model.theta, strict=True)}
    viscous = next((column for column in step.model.columns if column.name == "viscous"), None)
    both = theta.get("viscous", 0.0) + theta.pop(BackEmf.id)
    if viscous is None or viscous.is_known or not viscous.is_allowed(both):
        return step
    rest = tuple(term for term in step.model.terms if term.id != BackEmf.id)
    start = Point.within(rest, np.array(list((theta | {"viscous": both}).values())))
    refine_rows(trial.evaluator)[0].begin_at(start)
    return fit_step(trial.evaluator, step.added, start.terms)


def include_back_emf(data: FitData, terms: Sequence[Term]) -> FitData | None:
    """Include back-EMF in the base model if a voltage drives the motor and friction depends on the load.

    Otherwise back-EMF is viscous friction, unless the motor is ever off: then the base model has it already.
    """
    is_pressed = LoadDependentFriction.id in list_ids(terms) and BackEmf.id not in list_ids(terms)
    finding = Finding(Kind.BACK_EMF_INCLUDED, effects=(BackEmf.id,))
    return data.with_treatment(finding) if is_pressed and select_voltage_drives(data.recordings) else None


def conclude(trial: Trial, found: Diagnosis) -> Diagnosis:
    """Add findings on the drive and on the reading of the goals."""
    data = trial.data
    dropped = list_ids(trial.found.terms) - list_ids(trial.final.terms)
    doubts = (data.doubt, find_speed_rate(found.model, data.recordings), find_torque_scale(data.recordings))
    readings = [one for one in data.treatments if one.kind in (Kind.GOALS_HELD, Kind.GOALS_RUN_ON)]
    return replace(
        found,
        candidates=tuple(
            replace(own, reason=Finding(Kind.LONG_STEPS)) if own.effect in dropped else own for own in found.candidates
        ),
        floors=refine_rows(trial.evaluator)[0].rollouts.encoder,
        findings=(
            *readings,
            *find_remedies(trial.unbounded(found.model), data.recordings, found.ambiguous, not found.unexplained),
            *filter(None, doubts),
        ),
        forbidden=Finding(Kind.CHECK_DRIVE) if found.unexplained else None,
    )


def find_speed_rate(model: Model, recordings: Sequence[Recording]) -> Finding | None:
    """Return a finding where a controller may see the speed so late that this passes for inertia."""
    drives = [own.drive for own in recordings if own.drive is not None and own.drive.rate is None]
    gains = [(drive.kp if drive.acts_on_speed else drive.kd) * (drive.gain or 1.0) for drive in drives]
    off = max(gains, default=0.0) / (2 * LOOP.seldom)
    if off <= model.estimates["inertia"].std:
        return None
    inertia = Quantity(off, unit=model.estimates["inertia"].unit)
    return Finding(Kind.SPEED_RATE_UNKNOWN, {"rate": Quantity(LOOP.seldom, unit="Hz"), "inertia": inertia})


def find_torque_scale(recordings: Sequence[Recording]) -> Finding | None:
    """Return a finding where the logged torque is not the torque that the drive asks for, but a multiple of it."""
    told = [own for own in recordings if own.has_logged_torque and own.drive and own.torque_unit == own.drive.unit]
    if not told:
        return None
    logged, asked = (
        np.concatenate(every) for every in zip(*((own.torque, compute_asked_torque(own)) for own in told), strict=True)
    )
    share = float(logged @ asked / max(asked @ asked, np.finfo(float).tiny))
    if abs(share - 1.0) < LOOP.scale:
        return None
    return Finding(Kind.TORQUE_SCALED, {"factor": Quantity(share)})


def has_gear_friction(step: Step) -> bool:
    """Return whether load-dependent friction is significant; it distinguishes back-EMF from viscous friction."""
    return compute_significant_sign(step.model, LoadDependentFriction.id) > 0


def find_regions(trial: Trial) -> Sequence[Region]:
    """Find the residual of the motion under the final model, and the recording with the largest share."""
    evaluator, last, train = trial.evaluator, trial.final.steps[-1], refine_rows(trial.evaluator)[0]
    data = train.rollouts
    residual = train.residual(last.model.terms, np.asarray(last.model.theta))
    if evaluator.residuals.is_noise_in(evaluator.train, residual):
        return []
    sizes = np.array([np.mean(np.abs(residual[data.recording_of == k])) for k in range(len(data.recordings))])
    worst = int(np.argmax(sizes))
    error, floor = float(np.mean(np.abs(residual))), get_single(data.encoder)
    unit = last.model.units().unit("rad")
    numbers = {"error": Quantity(error, unit=unit), "times": Quantity(error / floor)}
    if len(sizes) > 1:
        numbers["worst"] = Quantity(sizes[worst], unit=unit)
    cause = Finding(Kind.SERVO_OFF, numbers, recordings=(data.recordings[worst].name,))
    return [make_region_everywhere(cause, evaluator.train.samples, error, floor)]


SERVO = Case(
    takes=lambda base, recordings: are_driven(recordings),
    prepare=prepare,
    evaluator=make_evaluator,
    search=search,
    refit=refit,
    refine=refine,
    unexplained=find_regions,
    present=present,
    conclude=conclude,
    reveal=lambda data, base, kind: include_back_emf(data, (*base, kind())) or data,
    treatments=(lambda trial: include_back_emf(trial.data, trial.final.terms),),
    is_timed=False,
)
