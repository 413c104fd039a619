"""What a session knows, as a value: every change makes a new one, so that a page is always drawn from one state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from estimators.arguments import within_limits
from estimators.checks.alignment import Aligned
from estimators.checks.homogeneity import Disagreement, disagreements
from estimators.checks.identifiability import Doubt, identifiability
from estimators.checks.residual import Region, profiles, stand_out
from estimators.checks.torque_constant import Calibrated, told
from estimators.diagnosis.added import Addition
from estimators.diagnosis.addition import fit
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.run import gather
from estimators.regression.equations import IdentificationError
from estimators.schemes.identification import Identification
from estimators.selection.criterion import Criterion
from estimators.selection.data import Evidence, Step
from estimators.signals.measurements import measure_segments
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.recording import Recording, Source
from workbench.app.asked import NOTHING, Asked
from workbench.app.brushing import Points
from workbench.commands.identify import six_schemes
from workbench.report.case import Case
from workbench.report.words import listing, name


@dataclass(frozen=True, eq=False)
class Loaded:
    """A recording of a session.

    Attributes:
        file: where it lies, in the session's folder.
        recording: what it holds.
        held_out: whether it is kept for checking.
        origin: arguments of `pendulum-ident record` that made it; empty if it was uploaded.
        told: how the file is read, where its names do not tell.
        measured: what it held before `recording` was corrected; None if it was not.
    """

    file: Path
    recording: Recording
    held_out: bool = False
    origin: tuple[str, ...] = ()
    told: Source | None = None
    measured: Recording | None = None

    @property
    def uncorrected(self) -> Loaded:
        """The same as it was read."""
        return self if self.measured is None else replace(self, recording=self.measured, measured=None)

    def corrected(self, recording: Recording) -> Loaded:
        """The same with another recording in the place of what was read."""
        if recording is self.recording:
            return self
        return replace(self, recording=recording, measured=self.measured or self.recording)

    @property
    def source(self) -> Source:
        """The same as a study names it."""
        return replace(self.told or Source(self.file), role="holdout" if self.held_out else "fit")

    @property
    def is_plain(self) -> bool:
        """Whether the file is read whole and as it is, so that no study has to tell how."""
        return not (self.source.columns or self.source.unwrap or self.source.range or self.source.load)


@dataclass(frozen=True, eq=False)
class State:
    """Recordings, the ladder of models fitted to them, and what a diagnosis found.

    Attributes:
        loaded: recordings.
        terms: of the base model.
        model_file: name of the file that they came from; empty for the paper's four.
        is_aligned: whether torque that was logged late or filtered is corrected.
        asked: which effects are looked for, and which values are known.
        corrected: what was, in sentences.
        ladder: the base model, then one step for each effect that was added; empty while nothing can be fitted.
        trouble: why nothing can be fitted.
        evidence: what is fitted and what is held out, as windows and flights; None while nothing can be fitted.
        diagnosis: the last one of these recordings.
        started: the ladder that it started from.
    """

    loaded: tuple[Loaded, ...] = ()
    terms: tuple[Term, ...] = BASE
    model_file: str = ""
    is_aligned: bool = False
    asked: Asked = NOTHING
    corrected: tuple[str, ...] = ()
    ladder: tuple[Step, ...] = ()
    trouble: str = ""
    evidence: tuple[Evidence, Evidence] | None = None
    diagnosis: Diagnosis | None = None
    started: tuple[Step, ...] = ()

    @classmethod
    def of(
        cls,
        loaded: Sequence[Loaded],
        terms: Sequence[Term] = BASE,
        model_file: str = "",
        is_aligned: bool = False,
        asked: Asked = NOTHING,
    ) -> State:
        """Begin with recordings as they were read: the base model is fitted to them, if it can be."""
        bare = cls(tuple(one.uncorrected for one in loaded), tuple(terms), model_file, is_aligned, asked)
        if not loaded:
            return bare
        if not bare.train:
            return replace(bare, trouble="every recording is held out: keep one to fit the model to")
        try:
            calibrated = Calibrated.of(bare.train, bare.holdout)
            if calibrated.doubt is not None:
                return replace(bare, trouble=f"{calibrated.doubt}; or give the gain itself")
            bare = bare._with(calibrated)
            if is_aligned:
                aligned = Aligned.of(bare.train, bare.holdout)
                bare = replace(bare._with(aligned), corrected=aligned.texts(True))
            evidence = gather(bare.train, bare.holdout)
            base = fit(*evidence, within_limits(terms, {}, **asked.limits)[0])
            base = replace(base, model=told(base.model, evidence[0].data))
            return replace(bare, ladder=(base,), evidence=evidence)
        except IdentificationError as error:
            return replace(bare, trouble=str(error))

    def _with(self, corrected: Calibrated | Aligned) -> State:
        """The state with its recordings in N m, or with their torque in time."""
        fitted, held_out = iter(corrected.recordings), iter(corrected.holdout)
        return replace(
            self, loaded=tuple(one.corrected(next(held_out if one.held_out else fitted)) for one in self.loaded)
        )

    def having(self, loaded: Sequence[Loaded]) -> State:
        """Begin anew with other recordings and the same base model."""
        return State.of(loaded, self.terms, self.model_file, self.is_aligned, self.asked)

    def fitting(self, terms: Sequence[Term] = BASE, model_file: str = "") -> State:
        """Begin anew with another base model and the same recordings."""
        return State.of(self.loaded, terms, model_file, self.is_aligned, self.asked)

    def aligned(self, is_aligned: bool) -> State:
        """Begin anew with torque that was logged late or filtered corrected, or as it was logged."""
        if is_aligned == self.is_aligned:
            return self
        return State.of(self.loaded, self.terms, self.model_file, is_aligned, self.asked)

    def asking(self, asked: Asked) -> State:
        """Look for other effects from now on; where other values are known, begin anew with them."""
        if asked == self.asked:
            return self
        if asked.limits == self.asked.limits:
            return replace(self, asked=asked)
        return State.of(self.loaded, self.terms, self.model_file, self.is_aligned, asked)

    @cached_property
    def timing(self) -> Aligned | None:
        """What is found of the time between torque and motion; None while nothing can be fitted."""
        return Aligned.of(self.train, self.holdout) if self.ladder else None

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
        return identifiability([m for recording in self.train for m in measure_segments(recording)], terms)

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
        diagnosis = replace(self.told, steps=self.ladder, disagreements=(), window_share=1.0, knocks_beside=None)
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
        inertia = abs(self.model.estimates["inertia"].value) if "inertia" in self.model.estimates else 0.0
        if Criterion().is_noise(evidence.data.structure(residual, inertia), floor):
            return ()
        return tuple(stand_out(profiles(evidence.samples, residual, floor)))

    @property
    def seconds(self) -> float:
        """Length of all recordings [s]."""
        return float(np.sum([one.recording.duration for one in self.loaded]))

    @property
    def samples(self) -> int:
        """Samples of all recordings."""
        return sum(len(one.recording) for one in self.loaded)


def change(old: State, new: State) -> str:
    """What was done between two states, in the words of a button that takes it back."""
    before, after = ({one.file: one for one in state.loaded} for state in (old, new))
    if coming := [one.recording.name for file, one in after.items() if file not in before]:
        return f"load {listing(coming)}"
    if gone := [one.recording.name for file, one in before.items() if file not in after]:
        return f"remove {listing(gone)}"
    if new.is_aligned != old.is_aligned:
        return "correct the torque" if new.is_aligned else "take the torque as it was logged"
    if len(new.added) > len(old.added):
        return f"add {name(new.added[-1])}"
    if new.diagnosis is not None and new.diagnosis is not old.diagnosis:
        return "diagnose"
    if new.terms != old.terms or new.model_file != old.model_file:
        return f"start from {new.model_file or 'four terms'}"
    if new.asked != old.asked:
        return "choose what is looked for"
    if any(after[file].held_out != one.held_out for file, one in before.items()):
        return "fit or check"
    return f"take {name(old.added[-1])} out" if len(new.added) < len(old.added) else "read columns anew"


def ids(steps: Sequence[Step]) -> tuple[str, ...]:
    """Effects that steps added."""
    return tuple(step.added for step in steps if step.added is not None)
