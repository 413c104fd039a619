"""What a session knows, as a value: every change makes a new one, so that a page is always drawn from one state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from estimators.agreement import Disagreement, disagreements
from estimators.diagnose import Addition, fit, gather, is_structured
from estimators.diagnosis import Diagnosis, Step
from estimators.equations import IdentificationError
from estimators.evidence import Evidence
from estimators.identifiability import Doubt, identifiability
from estimators.identify import Identification
from estimators.measurements import measure
from estimators.regions import Region, profiles, stand_out
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.recording import Recording
from workbench.app.brushing import Points
from workbench.commands.identify import six_schemes
from workbench.report.case import Case


@dataclass(frozen=True, eq=False)
class Loaded:
    """A recording of a session.

    Attributes:
        file: where it lies, in the session's folder.
        recording: what it holds.
        held_out: whether it is kept for checking.
        origin: arguments of `pendulum-ident record` that made it; empty if it was uploaded.
    """

    file: Path
    recording: Recording
    held_out: bool = False
    origin: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class State:
    """Recordings, the ladder of models fitted to them, and what a diagnosis found.

    Attributes:
        loaded: recordings.
        terms: of the base model.
        model_file: name of the file that they came from; empty for the paper's four.
        ladder: the base model, then one step for each effect that was added; empty while nothing can be fitted.
        trouble: why nothing can be fitted.
        evidence: what is fitted and what is held out, as windows and flights; None while nothing can be fitted.
        diagnosis: the last one of these recordings.
        started: the ladder that it started from.
    """

    loaded: tuple[Loaded, ...] = ()
    terms: tuple[Term, ...] = BASE
    model_file: str = ""
    ladder: tuple[Step, ...] = ()
    trouble: str = ""
    evidence: tuple[Evidence, Evidence] | None = None
    diagnosis: Diagnosis | None = None
    started: tuple[Step, ...] = ()

    @classmethod
    def of(cls, loaded: Sequence[Loaded], terms: Sequence[Term] = BASE, model_file: str = "") -> State:
        """Begin with recordings: the base model is fitted to them, if it can be."""
        bare = cls(tuple(loaded), tuple(terms), model_file)
        if not loaded:
            return bare
        if not bare.train:
            return replace(bare, trouble="every recording is held out: keep one to fit the model to")
        try:
            evidence = gather(bare.train, bare.holdout)
            return replace(bare, ladder=(fit(*evidence, terms),), evidence=evidence)
        except IdentificationError as error:
            return replace(bare, trouble=str(error))

    def having(self, loaded: Sequence[Loaded]) -> State:
        """Begin anew with other recordings and the same base model."""
        return State.of(loaded, self.terms, self.model_file)

    @property
    def train(self) -> list[Recording]:
        """Recordings that are fitted."""
        return [one.recording for one in self.loaded if not one.held_out]

    @property
    def holdout(self) -> list[Recording]:
        """Recordings to check on; empty if the ends of the fitted ones are."""
        return [one.recording for one in self.loaded if one.held_out]

    @property
    def model(self) -> Model:
        """The model at the end of the ladder; there has to be one."""
        return self.ladder[-1].model

    @property
    def added(self) -> tuple[str, ...]:
        """Effects on the ladder."""
        return ids(self.ladder)

    @property
    def called_for(self) -> tuple[Step, ...]:
        """The ladder as the diagnosis would have it; empty before there is one."""
        return (*self.started, *self.diagnosis.steps[1:]) if self.diagnosis is not None else ()

    @property
    def astray(self) -> bool:
        """Whether the ladder has an effect that the diagnosis does not call for."""
        return self.diagnosis is not None and not set(self.added) <= set(ids(self.called_for))

    @property
    def found(self) -> tuple[str, ...]:
        """Effects that the diagnosis calls for beyond the ladder, as long as the ladder goes with it."""
        return () if self.astray else tuple(effect for effect in ids(self.called_for) if effect not in self.added)

    def diagnosed(self, diagnosis: Diagnosis, started: tuple[Step, ...]) -> State:
        """The state with a diagnosis that started from a ladder."""
        return replace(self, diagnosis=diagnosis, started=started)

    def grown(self, addition: Addition) -> State:
        """The state with one more step; the effect's own refit of the model before it replaces the last step."""
        last = replace(addition.before, added=self.ladder[-1].added)
        return replace(self, ladder=(*self.ladder[:-1], last, addition.after))

    def undone(self) -> State:
        """The state without the last effect that was added."""
        return replace(self, ladder=self.ladder[:-1]) if self.added else self

    @cached_property
    def doubts(self) -> tuple[Doubt, ...]:
        """What the fitted recordings cannot tell about the model's parameters."""
        terms = self.model.terms if self.ladder else BASE
        return identifiability([measure(recording) for recording in self.train], terms)

    @cached_property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Recordings that show another plant than the others, as the diagnosis has it, or would begin with."""
        if self.diagnosis is not None:
            return self.diagnosis.disagreements
        if self.evidence is None:
            return ()
        parts = self.evidence if self.holdout else self.evidence[:1]
        return disagreements([part.data for part in parts], self.model.terms, only_if_all_fit=True)

    @cached_property
    def identification(self) -> Identification | None:
        """The six schemes with the model's terms, None where the recordings are too poor for them."""
        return six_schemes(self.train, self.model.terms)

    @cached_property
    def told(self) -> Diagnosis:
        """What the report tells: the diagnosis as far as the ladder goes with it, or the ladder itself."""
        if self.diagnosis is None:
            floor = self._train.data.noise(abs(self.model.estimates["inertia"].value))
            advice = tuple(doubt.text for doubt in self.doubts)
            return Diagnosis(self.ladder, (), (), self._left(floor), floor, advice)
        if self.astray:
            return replace(self.diagnosis, steps=self.ladder, unexplained=self._left(self.diagnosis.noise_floor))
        return replace(self.diagnosis, steps=self.called_for if self.found else self.ladder)

    @cached_property
    def case(self) -> Case:
        """What the sections of the report may look at."""
        return Case.of(self.train, self.holdout, self.told)

    @cached_property
    def standing(self) -> Case:
        """The same with all recordings and the ladder as they are, whatever the diagnosis found beyond them."""
        diagnosis = replace(self.told, steps=self.ladder, disagreements=(), window_share=1.0)
        return replace(Case.of(self.train, self.holdout, diagnosis), gathered=self.evidence)

    @property
    def _train(self) -> Evidence:
        if self.evidence is None:
            raise ValueError("there is no evidence before recordings are loaded")
        return self.evidence[0]

    @cached_property
    def scheming(self) -> Case:
        """The same with the six schemes, which take a moment."""
        return replace(self.standing, identification=self.identification)

    def points(self, number: int) -> Points:
        """Windows of a loaded recording under the models of the ladder's ends; worked out once."""
        if number not in self._points:
            self._points[number] = Points.of(self.standing, self.loaded[number].recording)
        return self._points[number]

    @cached_property
    def _points(self) -> dict[int, Points]:
        return {}

    def _left(self, floor: float) -> tuple[Region, ...]:
        """Where the last model leaves more than noise."""
        evidence = self._train
        residual: Array = evidence.watching(self.model).residual(self.model.terms, self.model.theta)
        if not is_structured(residual, floor):
            return ()
        return tuple(stand_out(profiles(evidence.samples, residual, floor)))

    @property
    def seconds(self) -> float:
        """Length of all recordings [s]."""
        return float(np.sum([one.recording.duration for one in self.loaded]))


def ids(steps: Sequence[Step]) -> tuple[str, ...]:
    """Effects that steps added."""
    return tuple(step.added for step in steps if step.added is not None)
