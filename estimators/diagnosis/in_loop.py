"""Diagnosis in the loop: what is missing in the model of a servo, told by simulating it with its controller.

Friction at rest, and how a servo sticks and leaves, shows in how far it stays behind its goal. Torque that is regressed
on motion says nothing of that, and is a function of the position itself, where a controller made it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.checks.remedies import remedies
from estimators.checks.torque_constant import widened
from estimators.data.fit_data import HELD_OUT, FitData
from estimators.data.regression_data import RegressionData, fit_terms
from estimators.diagnosis.ranking import rank_effects
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.setting import Setting
from estimators.findings import Finding, Kind, Quantity
from estimators.in_loop.fit import LOOP
from estimators.in_loop.rollout_rows import RolloutRows
from estimators.in_loop.rollouts import FINE, Rollouts
from estimators.progress import no_progress
from estimators.regression.equations import IdentificationError
from estimators.selection.errors import Step, of_one
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.physical import significant_sign
from estimators.selection.search import SearchResult, search
from estimators.signals.residual import Region, everywhere
from estimators.simulation.output_error import Point
from estimators.weak_form.windows import WHOLE
from pendulum_env.physics import Model, Term
from pendulum_env.physics.actuation import BackEmf
from pendulum_env.physics.friction import LoadDependentFriction
from pendulum_env.physics.potential import GravityTilt
from pendulum_env.physics.terms import ids
from pendulum_env.recording import Recording
from pendulum_env.recording.record import NEWTON_METRE


@dataclass(frozen=True)
class Looped:
    """Servos ready to be compared with models in the loop.

    Attributes:
        evaluator: what the recordings say of models.
        train, check: fitted and held-out recordings.
        given: the same in the unit of their torque.
    """

    evaluator: ModelEvaluator
    train: RolloutRows
    check: RolloutRows
    given: FitData

    @classmethod
    def of(cls, recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> Looped:
        """Prepare recordings; without held-out ones, the end of each is held out.

        Raises:
            IdentificationError: if the recordings hold too little motion to begin with.
        """
        setting.progress("reading the motion", 0.0)
        given = FitData.of(recordings, holdout, setting.base)
        fitted, unseen = given.recordings, given.holdout
        first, last = (WHOLE, WHOLE) if unseen else ((0.0, 1 - HELD_OUT), (1 - HELD_OUT, 1.0))
        unseen = unseen or fitted
        base, windows = base_of(setting.base, fitted), RegressionData.of(fitted, part=first)
        ways = [RolloutRows(Rollouts(fitted, is_held=held, shares=first), windows.torque) for held in (True, False)]
        library = {id: kind for id, kind in setting.library.items() if kind.kind != "sensor"}
        train = likeliest_way(ways, base, list(library.values()))
        rest = Rollouts(unseen, is_held=train.rollouts.is_held, shares=last)
        check = RolloutRows(rest, RegressionData.of(unseen, part=last).torque, train)
        criterion = replace(setting.criterion, explained_share=LOOP.needed, needed_share=LOOP.needed)
        evaluator = replace(setting, base=base, library=library, criterion=criterion).evaluator(
            (train.data, check.data)
        )
        return cls(evaluator, train, check, given)

    @cached_property
    def fine(self) -> tuple[RolloutRows, RolloutRows]:
        """The fitted and the held-out recordings with shorter steps of the integrator."""
        train = self.train.with_steps(FINE)
        return train, self.check.with_steps(FINE, train)

    def searched(self) -> tuple[SearchResult, SearchResult]:
        """What is found, and what of it stands with shorter steps of the integrator."""
        found = search(self.evaluator)
        return found, replace(found, steps=self.confirmed(found.steps))

    def confirmed(self, steps: Sequence[Step]) -> list[Step]:
        """Steps sharpened, without effects that predict no better with shorter steps: they made up for long ones."""
        evaluator = replace(self.evaluator, train=self.fine[0].data, holdout=self.fine[1].data)
        found = [self.sharpened(step) for step in steps]
        rungs = {ids(step.model.terms): step.model.terms for step in found}
        terms, named = found[-1].model.terms, [step.added for step in steps[1:]]

        def without(*left_out: str | None) -> tuple[Term, ...]:
            return tuple(term for term in terms if term.id not in left_out)

        while idle := [id for id in named if not evaluator.is_significant(terms, without(id))]:
            named.remove(idle[-1])
            rest = without(idle[-1])
            terms = rungs.get(ids(rest)) or self.fine[0].with_nonlinear(rest)
        if len(named) == len(steps) - 1:
            return found
        return [found[0], *(self._fitted(id, without(*named[k + 1 :])) for k, id in enumerate(named))]

    def sharpened(self, step: Step) -> Step:
        """A step fitted anew, and compared, with shorter steps of the integrator, from where it was."""
        start = Point.within(step.model.terms, np.asarray(step.model.theta))  # where nonlinear parameters follow
        self.fine[0].begin_at(start)
        return self._fitted(step.added, start.terms)

    def readable(self, step: Step) -> Step:
        """A step without back-EMF where that and viscous friction are one number: that of both.

        They are until the motor is off, or its gear surely rubs under its torque; or if viscous friction is limited.
        """
        if BackEmf.id not in step.model.estimates or are_ever_off(self.given.recordings) or rubs(step):
            return step
        theta = {column.name: value for column, value in zip(step.model.columns, step.model.theta, strict=True)}
        viscous = next((column for column in step.model.columns if column.name == "viscous"), None)
        both = theta.get("viscous", 0.0) + theta.pop(BackEmf.id)
        if viscous is None or viscous.is_known or not viscous.allows(both):
            return step
        rest = tuple(term for term in step.model.terms if term.id != BackEmf.id)
        start = Point.within(rest, np.array(list((theta | {"viscous": both}).values())))
        self.fine[0].begin_at(start)
        return self._fitted(step.added, start.terms)

    def _fitted(self, added: str | None, terms: Sequence[Term]) -> Step:
        """A step to some terms with shorter steps of the integrator."""
        train, unseen = self.fine
        terms = train.fit(terms).terms
        model = self._in_unit(_timed(fit_terms(train.data, terms)[0], train))
        return Step(added, model, {"train": train.data.errors(model), "holdout": unseen.data.errors(model)})

    def _in_unit(self, model: Model) -> Model:
        """A model in the unit of the torque, with its constant, by whose error all parameters may be off alike."""
        constant = self.given.constant
        if constant is None:
            return model.per(self.given.unit)
        larger = 1.0 + constant.std / constant.value
        there = {
            name: replace(own, value=larger * own.value) if own.unit.startswith((NEWTON_METRE, "kg")) else own
            for name, own in model.estimates.items()
        }
        return widened(model, constant, model, replace(model, estimates=there))


def diagnose_in_loop(recordings: Sequence[Recording], holdout: Sequence[Recording], setting: Setting) -> Diagnosis:
    """Find what the model of a servo lacks; see `estimators.diagnose`.

    Raises:
        IdentificationError: if the recordings hold too little motion to begin with.
    """
    servos = Looped.of(recordings, holdout, setting)
    searched, found = servos.searched()
    braked = with_back_emf(setting, recordings) if LoadDependentFriction.id in ids(found.terms) else setting
    if braked is not setting:
        again = Looped.of(recordings, holdout, braked)
        both = again.searched()
        if rubs(both[1].steps[-1]):
            servos, (searched, found) = again, both
    given = servos.given
    setting.progress("judging", 0.93)
    candidates, groups = rank_effects(found, found.terms)
    dropped = ids(searched.terms) - ids(found.terms)
    candidates = [replace(own, reason=Finding(Kind.LONG_STEPS)) if own.effect in dropped else own for own in candidates]
    left = unexplained(found, servos.fine[0])
    *others, last = map(servos.readable, found.steps)
    model = last.model.biased() if left else last.model
    doubts = (given.doubt, _of_rate(last.model, recordings), _of_scale(recordings))
    diagnosis = Diagnosis(
        steps=(*others, replace(last, model=model)),
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=tuple(left),
        floors=servos.train.rollouts.encoder,
        findings=(*remedies(model, recordings, groups), *filter(None, doubts)),
        forbidden=Finding(Kind.CHECK_DRIVE) if left else None,
        torque_unit=given.unit,
        torque_constant=given.constant,
        data=given,
        evaluator=found.evaluator,
    )
    return _beside_torque(diagnosis, setting)


def _beside_torque(found: Diagnosis, setting: Setting) -> Diagnosis:
    """A diagnosis in the loop, with the effects that torque which was logged calls for by itself, if there is any.

    What the drive asked for is no such torque: it is a function of the motion that the loop has simulated. Play and
    links that yield are left to the loop, as a search for them by torque takes longer than all else.
    """
    given = found.data
    if given is not None and all(own.has_logged_torque for own in (*given.recordings, *given.holdout)):
        setting.progress("looking at the torque", 0.96)
        library = {id: kind for id, kind in setting.library.items() if kind.kind != "transmission"}
        alone = replace(setting, base=found.steps[0].model.terms, library=library, progress=no_progress)
        with suppress(IdentificationError):  # too little motion for a regression
            by_torque = search(replace(alone.evaluator(given.timed().parts), tables=()))
            found = replace(found, by_torque=tuple(sorted(ids(by_torque.terms) - ids(alone.base))))
    setting.progress("done", 1.0)
    return found


def _of_rate(model: Model, recordings: Sequence[Recording]) -> Finding | None:
    """Return a finding where a controller may see the speed so late that this passes for inertia."""
    drives = [own.drive for own in recordings if own.drive is not None and own.drive.rate is None]
    gains = [(drive.kp if drive.acts_on_speed else drive.kd) * (drive.gain or 1.0) for drive in drives]
    off = max(gains, default=0.0) / (2 * LOOP.seldom)
    if off <= model.estimates["inertia"].std:
        return None
    inertia = Quantity(off, unit=model.estimates["inertia"].unit)
    return Finding(Kind.SPEED_RATE_UNKNOWN, {"rate": Quantity(LOOP.seldom, unit="Hz"), "inertia": inertia})


def _of_scale(recordings: Sequence[Recording]) -> Finding | None:
    """Return a finding where the logged torque is not the torque that the drive asks for, but a multiple of it."""
    told = [own for own in recordings if own.has_logged_torque and own.drive and own.torque_unit == own.drive.unit]
    if not told:
        return None
    logged, asked = (
        np.concatenate(every) for every in zip(*((own.torque, own.asked_torque) for own in told), strict=True)
    )
    share = float(logged @ asked / max(asked @ asked, np.finfo(float).tiny))
    if abs(share - 1.0) < LOOP.scale:
        return None
    return Finding(Kind.TORQUE_SCALED, {"factor": Quantity(share)})


def _timed(model: Model, rows: RolloutRows) -> Model:
    """A fitted model whose standard errors count that a log's clock is off by a share of a sample."""
    point = Point.of(model)
    near, rollouts = rows.near(model.terms), rows.rollouts
    by_nonlinear, nonlinear = rows.nonlinear_jacobian(model.terms, point.theta)
    slopes = np.column_stack([near.slopes[:, : len(point.theta)], by_nonlinear])
    late = np.column_stack([other.position_errors([point])[:, 0] for other in rollouts.mistimed])
    weights = near.weights[:, None]
    moved = np.linalg.lstsq(weights * slopes, -weights * (late - rollouts.position_errors([point])), rcond=None)[0]
    names = [*(column.name for column in model.columns), *nonlinear]
    place = [list(model.estimates).index(name) for name in names]
    covariance = model.assumed_covariance[np.ix_(place, place)] + moved @ moved.T
    wider = {
        name: replace(model.estimates[name], std=float(std))
        for name, std in zip(names, np.sqrt(np.diag(covariance)), strict=True)
    }
    return replace(model, estimates={**model.estimates, **wider}).correlated(names, covariance)


def likeliest_way(ways: Sequence[RolloutRows], base: Sequence[Term], effects: Sequence[type[Term]]) -> RolloutRows:
    """That of several ways to look at recordings under which a model is likeliest, with one more effect if need be.

    A goal that is held is late by half a sample, which a model without what is missing may well prefer.
    """

    def of(one: RolloutRows) -> float:
        terms = one.fit(base, exactly=True).terms
        beside = [effect for effect in effects if effect.id not in ids(terms)]
        foreseen = [trial for effect in beside for trial in one.data.ranked(terms, effect)[:1]]
        promising = sorted(foreseen, key=lambda trial: trial.fitted_rms)[: LOOP.promising]
        return min(one.trial(each).fitted_rms for each in (terms, *(trial.terms for trial in promising)))

    return min(ways, key=of)


def base_of(base: Sequence[Term], recordings: Sequence[Recording]) -> tuple[Term, ...]:
    """The model that a search in the loop starts from.

    A horn is put on a servo by hand, so that the angle at which it hangs is fitted along; and where the motor was off
    for a while, what it brakes while it is on is told from viscous friction.
    """
    more = [GravityTilt(), *([BackEmf()] if are_ever_off(recordings) else [])]
    return (*base, *(term for term in more if term.id not in ids(base)))


def with_back_emf(setting: Setting, recordings: Sequence[Recording]) -> Setting:
    """The same with back-EMF in the base model, if a voltage drives the motor, and it is there for no other reason.

    It is viscous friction until the motor is off, or its gear rubs under the torque that is left.
    """
    is_there = BackEmf.id in ids(setting.base) or are_ever_off(recordings)
    return replace(setting, base=(*setting.base, BackEmf())) if under_voltage(recordings) and not is_there else setting


def rubs(step: Step) -> bool:
    """Whether a gear surely rubs under the motor's torque, which back-EMF is no part of."""
    return significant_sign(step.model, LoadDependentFriction.id) > 0


def are_ever_off(recordings: Sequence[Recording]) -> bool:
    """Whether a motor that a voltage drives is off for a while."""
    return not all(recording.powered.all() for recording in under_voltage(recordings))


def under_voltage(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings whose drive gives the motor a voltage, not a torque."""
    return [own for own in recordings if own.drive is not None and own.drive.output in ("duty", "voltage")]


def unexplained(found: SearchResult, train: RolloutRows) -> list[Region]:
    """What the final model leaves of the motion, and where most of it is."""
    evaluator, last, data = found.evaluator, found.steps[-1], train.rollouts
    left = train.residual(last.model.terms, np.asarray(last.model.theta))
    if evaluator.residuals.is_noise_in(evaluator.train, left):
        return []
    sizes = np.array([np.mean(np.abs(left[data.recording_of == k])) for k in range(len(data.recordings))])
    worst = int(np.argmax(sizes))
    error, floor = float(np.mean(np.abs(left))), of_one(data.encoder)
    numbers = {"error": Quantity(error, unit="rad"), "times": Quantity(error / floor)}
    if len(sizes) > 1:
        numbers["worst"] = Quantity(sizes[worst], unit="rad")
    cause = Finding(Kind.SERVO_OFF, numbers, recordings=(data.recordings[worst].name,))
    return [everywhere(cause, evaluator.train.samples, error, floor)]
