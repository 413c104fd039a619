"""What a section of the report may look at, worked out once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from estimators.diagnosis.result import Diagnosis
from estimators.preprocessing import Preprocessed
from estimators.regression.equations import IdentificationError
from estimators.schemes.identification import Identification, identify
from estimators.schemes.six import SCHEMES
from estimators.selection.data import PreparedData
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.recording import Recording


@dataclass(frozen=True)
class Case:
    """A diagnosis with the data that it rests on.

    Attributes:
        diagnosis: what was found.
        first: what the model is called that the diagnosis started from.
    """

    diagnosis: Diagnosis
    first: str = "base model"

    @property
    def data(self) -> Preprocessed:
        """What the diagnosis was made of; raises ValueError of one that was read from a file, and has none."""
        if self.diagnosis.data is None:
            raise ValueError("the diagnosis has no data: give it those of its recordings, see Preprocessed")
        return self.diagnosis.data

    @property
    def train(self) -> tuple[Recording, ...]:
        """Recordings that were fitted."""
        return self.data.recordings

    @property
    def holdout(self) -> tuple[Recording, ...]:
        """Recordings that were held out: given ones, or the fitted ones, of which the ends were."""
        return self.data.holdout or self.data.recordings

    @property
    def is_split(self) -> bool:
        """Whether what was held out is the ends of the fitted recordings."""
        return not self.data.holdout

    @property
    def training(self) -> PreparedData:
        """Windows and segments of the fitted recordings."""
        return self.data.parts[0]

    @property
    def testing(self) -> PreparedData:
        """Windows and segments of what was held out."""
        return self.data.parts[1]

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
