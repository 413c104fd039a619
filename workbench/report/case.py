"""What a section of the report may look at, worked out once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from estimators.checks.alignment import Aligned
from estimators.checks.torque_constant import Calibrated
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.run import agreeing, gather
from estimators.regression.equations import IdentificationError
from estimators.schemes.identification import Identification, identify
from estimators.schemes.six import SCHEMES
from estimators.selection.data import PreparedData, with_impacts
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.recording import Recording


@dataclass(frozen=True)
class Case:
    """A diagnosis with the recordings it rests on.

    Attributes:
        train: recordings that were fitted.
        holdout: recordings that were held out: given ones, or the ends of the fitted ones.
        is_split: whether the held-out recordings are the ends of the fitted ones.
        diagnosis: what was found.
        gathered: data prepared of the recordings, fitted and held out, where it is at hand already.
        first: what the model is called that the diagnosis started from.
    """

    train: tuple[Recording, ...]
    holdout: tuple[Recording, ...]
    is_split: bool
    diagnosis: Diagnosis
    gathered: tuple[PreparedData, ...] | None = None
    first: str = "base model"

    @classmethod
    def of(cls, recordings: Sequence[Recording], holdout: Sequence[Recording], diagnosis: Diagnosis) -> Case:
        """Gather a case as the diagnosis did.

        Currents are turned into torque and torque that was logged late is corrected alike.
        Recordings that disagree are not fitted; without held-out recordings, the end of each recording is held out.
        """
        calibrated = Calibrated.by(diagnosis.torque_constant, recordings, holdout)
        recordings, holdout = calibrated.recordings, calibrated.holdout
        if diagnosis.alignments:
            aligned = Aligned.by(diagnosis.alignments, recordings, holdout)
            recordings, holdout = aligned.recordings, aligned.holdout
        fitted = tuple(agreeing(recordings, [one.recording for one in diagnosis.disagreements]))
        return cls(fitted, tuple(holdout) or fitted, not holdout, diagnosis)

    @cached_property
    def _prepared(self) -> tuple[PreparedData, ...]:
        if self.gathered is not None:
            return self.gathered
        found = self.diagnosis
        prepared = gather(self.train, () if self.is_split else self.holdout, found.window_share)
        return prepared if found.impacts_beside is None else with_impacts(prepared, found.impacts_beside)

    @cached_property
    def training(self) -> PreparedData:
        """Windows and segments of the fitted recordings."""
        return self._prepared[0]

    @cached_property
    def testing(self) -> PreparedData:
        """Windows and segments of the held-out recordings."""
        return self._prepared[1]

    @cached_property
    def schemes(self) -> Identification | None:
        """All schemes with the terms of the final model, None where the recordings are too poor for them."""
        try:
            return identify(self.train, self.diagnosis.model.terms, SCHEMES)
        except IdentificationError:
            return None

    @property
    def base(self) -> Model:
        """The model that the diagnosis started from."""
        return self.diagnosis.steps[0].model

    @property
    def models(self) -> tuple[tuple[str, str, Model], ...]:
        """Label, colour and model of what is drawn: the base model and, where effects were added, the final one."""
        base = (self.first, "--base", self.base)
        final = ("final model", "--final", self.diagnosis.model)
        return (base, final) if self.diagnosis.selected else (base,)

    @cached_property
    def _watched(self) -> dict[int, list[PreparedData]]:
        return {}

    def watched(self, prepared: PreparedData) -> list[PreparedData]:
        """Prepared data for each drawn model, with its link watched if it has one; worked out once."""
        if id(prepared) not in self._watched:
            self._watched[id(prepared)] = [prepared.watching(model) for _, _, model in self.models]
        return self._watched[id(prepared)]

    def residuals(self, prepared: PreparedData) -> list[Array]:
        """Measured minus modelled torque (R,) [N m] of each drawn model."""
        seen = zip(self.watched(prepared), self.models, strict=True)
        return [own.residual(model.terms, model.theta) for own, (_, _, model) in seen]
