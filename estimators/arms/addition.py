"""One effect added at a joint by choice, and what the errors say of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimators.arms.diagnosis import models_of_arm, of_arm, parted
from estimators.arms.identification import ArmStep
from estimators.diagnosis.result import CHANCE, looks
from estimators.progress import Progress, no_progress
from estimators.regression.equations import IdentificationError
from estimators.selection.moves import best
from estimators.selection.physical import objection
from pendulum_env.arms.joints import kind_at
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import ModelError
from pendulum_env.physics.table import refuse_held
from pendulum_env.physics.term import loads


@dataclass(frozen=True, eq=False)
class ArmAddition:
    """One effect added at a joint of an arm.

    Attributes:
        before: the model refitted without the effect.
        after: the same with the effect, `stribeck@elbow`.
        objection: what speaks against the effect, None if nothing does.
    """

    before: ArmStep
    after: ArmStep
    objection: str | None

    @property
    def text(self) -> str:
        """Whether the effect earns its place, in a sentence: only data that it was not fitted to can tell."""
        effect = self.after.added or ""
        if self.objection is not None:
            return f"{effect} {self.objection}: these recordings give no reason to keep it"
        joint = self.after.model.body.joints.index(next(iter(loads(effect.partition("@")[2]))))
        old, new = (step.errors["holdout"][joint] for step in (self.before, self.after))
        share = new.torque_rms / old.torque_rms
        return f"{effect} lowers the held-out torque error of {new.joint} to {share:.1%} of before"

    @property
    def looks_like(self) -> str | None:
        """The formulas that a table which was added comes nearest to, in a sentence; None of an effect."""
        return looks(self.after) if self.objection is None else None


def add_arm(
    model: ArmModel,
    effect: str,
    recordings: ArmRecording | Sequence[ArmRecording],
    holdout: Sequence[ArmRecording] = (),
    progress: Progress = no_progress,
) -> ArmAddition:
    """Refit the body and the terms of a model, then with one more effect; shape parameters of its terms stay.

    Args:
        model: to start from.
        effect: `stribeck@elbow`, or a table, `torque_by_angle@elbow`.
        recordings: to fit, jointly.
        holdout: to confirm on; without any, the last 30 % of each recording.
        progress: told what is being done.

    Raises:
        ValueError: if there is no such effect or joint, it cannot be there, or a table there holds all that it is.
        ModelError: if the model has the effect already.
        IdentificationError: if a joint hardly moves, or its motion does not show the effect at all.
    """
    kind, base = kind_at(effect, model.body), model.terms
    if any(own.id == effect for own in base):
        raise ModelError(f"the model has {effect} already")
    refuse_held(base, kind())
    train, held = parted(recordings, holdout)
    models = models_of_arm(train, held, base, {kind.id: kind}, progress)
    trial = best(models, base, kind)
    if trial is None:
        names = ", ".join(recording.name for recording in train)
        raise IdentificationError(f"{names}: the motion does not show {effect} at all: record another one")
    without, with_it = models.report(None, base), models.report(effect, trial.terms)
    against = objection(with_it, without, models.train.motions)
    if against is None and models.gain(trial.terms, base).chance > models.criterion.chance:
        against = CHANCE
    before, after = (
        ArmStep.of(step.added, of_arm(step.model), train=train, holdout=held) for step in (without, with_it)
    )
    return ArmAddition(before, after, against)
