"""One effect added at a joint by choice, and what the errors say of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.arms.diagnosis import models_of_arm, of_arm, parted
from estimators.arms.identification import JointError, compare_arm
from estimators.checks.physical import objection
from estimators.diagnosis.result import CHANCE, looks
from estimators.progress import Progress, no_progress
from estimators.regression.equations import IdentificationError
from estimators.selection.criterion import Criterion
from estimators.selection.moves import best
from pendulum_env.arms.joints import kind_at
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import ModelError
from pendulum_env.physics.table import refuse_held
from pendulum_env.physics.term import loads


@dataclass(frozen=True, eq=False)
class Refitted:
    """A model of an arm fitted to recordings, and its torque errors on them and on what was held out."""

    model: ArmModel
    train: tuple[JointError, ...]
    holdout: tuple[JointError, ...]


@dataclass(frozen=True, eq=False)
class ArmAddition:
    """One effect added at a joint of an arm.

    Attributes:
        effect: `stribeck@elbow`.
        joint: index of its joint, the first of two that it loads.
        before: the model refitted without the effect.
        after: the same with the effect.
        objection: what speaks against the effect, None if nothing does.
        looks_like: the formulas that a table comes nearest to, in a sentence; None of an effect.
    """

    effect: str
    joint: int
    before: Refitted
    after: Refitted
    objection: str | None
    looks_like: str | None = None

    @property
    def text(self) -> str:
        """Whether the effect earns its place, in a sentence: only data that it was not fitted to can tell."""
        if self.objection is not None:
            return f"{self.effect} {self.objection}: these recordings give no reason to keep it"
        old, new = (part.holdout[self.joint] for part in (self.before, self.after))
        share = new.torque_rms / old.torque_rms
        return f"{self.effect} lowers the held-out torque error of {new.joint} to {share:.1%} of before"


def add_arm(
    model: ArmModel,
    effect: str,
    recordings: ArmRecording | Sequence[ArmRecording],
    holdout: Sequence[ArmRecording] = (),
    progress: Progress = no_progress,
    *,
    criterion: Criterion | None = None,
    rng: np.random.Generator | None = None,
) -> ArmAddition:
    """Refit the body and the terms of a model, then with one more effect; shape parameters of its terms stay.

    Args:
        model: to start from.
        effect: `stribeck@elbow`, or a table, `torque_by_angle@elbow`.
        recordings: to fit, jointly.
        holdout: to confirm on; without any, the last 30 % of each recording.
        progress: told what is being done.
        criterion: what the effect has to achieve.
        rng: of the bootstrap.

    Raises:
        ValueError: if there is no such effect or joint, it cannot be there, or a table there holds all that it is.
        ModelError: if the model has the effect already.
        IdentificationError: if a joint hardly moves, or its motion does not show the effect at all.
    """
    body, criterion = model.body, criterion or Criterion()
    kind = kind_at(effect, body)
    if any(own.id == effect for own in model.terms):
        raise ModelError(f"the model has {effect} already")
    refuse_held(model.terms, kind())
    train, held = parted(recordings, holdout)
    base = model.terms
    models = models_of_arm(train, held, base, {kind.id: kind}, criterion, rng, progress)
    trial = best(models, base, kind)
    if trial is None:
        names = ", ".join(recording.name for recording in train)
        raise IdentificationError(f"{names}: the motion does not show {effect} at all: record another one")
    steps = models.report(None, base), models.report(effect, trial.terms)
    before, after = (
        Refitted(fitted, compare_arm(fitted, train), compare_arm(fitted, held))
        for fitted in (of_arm(step.model) for step in steps)
    )
    against = objection(steps[1], steps[0], models.train.motions)
    if against is None and models.gain(trial.terms, base).chance > criterion.chance:
        against = CHANCE
    joint = body.joints.index(next(iter(loads(kind.at))))
    return ArmAddition(effect, joint, before, after, against, looks(steps[1]) if against is None else None)
