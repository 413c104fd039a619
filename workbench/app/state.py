"""Immutable state of a session: each change makes a new state, and a page is drawn from one state."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Self

from estimators import Addition, Diagnosis, FitData, Identification
from estimators.data.regions import find_failures
from estimators.findings import Finding
from estimators.schemes.identifiability import find_undetermined_parameters
from estimators.selection.errors import Step
from pendulum_env.arms.joints import arm_base, arrange_terms, find_links
from pendulum_env.physics import BASE, PENDULUM, Mechanism, Model, Term
from pendulum_env.recording import Recording, Source
from pendulum_env.recording.study import find_duplicate
from workbench.app.choices import NO_CHOICES, SearchChoices
from workbench.app.fits import BaseFit, fit_arm, fit_pendulum
from workbench.errors import USER_ERRORS, InputError
from workbench.report.data import ReportData
from workbench.robot import RobotFile, find_straying

NO_RECORDING = "load a recording first"
ALL_HELD_OUT = "every recording is held out: keep one to fit the model to"
FITTING = "the model is being fitted"


def read_one(source: Source) -> Recording:
    """Read a recording of a pendulum; raises RecordingError, in the words of the command line."""
    return replace(source.read(), drive=None)  # pages draw it by its torque


@dataclass(frozen=True, eq=False)
class LoadedRecording:
    """A recording of a session."""

    id: str  # by which the page names it: that of its file, with a number where several are of one file
    source: Source  # how its file is read, and whether it is held out
    recording: Recording  # what that gives
    origin: tuple[str, ...] = ()  # arguments of `pendulum-ident record` that made it; empty if it was uploaded

    @classmethod
    def read(
        cls,
        source: Source,
        known: Sequence[Self] = (),
        origin: tuple[str, ...] = (),
        read: Callable[[Source], Recording] = read_one,
    ) -> Self:
        """Read a recording beside those that are known, of whose files it may be another range.

        Raises InputError if it is known already, and RecordingError if it cannot be read, in the words of the command
        line.
        """
        name, ids = source.file.name, {one.id for one in known}
        alike = [one.source for one in known if one.source.file.name == name]
        if any(one.file != source.file or find_duplicate((one, source)) for one in alike):
            raise InputError(f"{name}: is loaded already: remove it, or give this one another name")
        recording = read(source)
        endings = ("", *(f" ({k})" for k in range(2, len(ids) + 2)))
        more = next(ending for ending in endings if name + ending not in ids)
        return cls(f"{name}{more}", source, replace(recording, name=f"{recording.name}{more}"), origin)

    @property
    def held_out(self) -> bool:
        """Return whether the recording is held out."""
        return self.source.role == "holdout"


@dataclass(frozen=True, eq=False)
class State:
    """Choices of the user and results of jobs. Nothing is fitted here: see `fits`."""

    loaded: tuple[LoadedRecording, ...] = ()  # recordings
    terms: tuple[Term, ...] = ()  # of the base model, of an arm those at its joints; empty: the usual ones
    model_file: str = ""  # name of the file that they came from; empty for the usual ones
    is_aligned: bool = False  # whether torque that was logged late or filtered is corrected
    asked: SearchChoices = NO_CHOICES  # which effects are looked for, and which values are known
    fit: BaseFit | None = None  # result of the worker; None before, or if nothing can be fitted
    failure: str = ""  # reason why recordings cannot be fitted
    ladder: tuple[Step, ...] = ()  # the base model, then one step for each added effect; empty without a fit
    schemes: Identification | None = None  # of the last model, of an arm of the base model
    diagnosis: Diagnosis | None = None  # the last one of these recordings
    started: tuple[Step, ...] = ()  # the ladder that it started from
    robot: RobotFile | None = None  # whose recordings they are; None of a pendulum

    @property
    def moving(self) -> tuple[str, ...]:
        """Return the joints of an arm that recordings are of; none of a pendulum."""
        return self.robot.body().joints if self.robot is not None else ()

    def read(self, source: Source) -> Recording:
        """Read a recording, as it is for this state; raises RecordingError, and InputError if it is of other joints."""
        if self.robot is None:
            return read_one(source)
        if source.joints not in (None, self.robot.joints):
            raise InputError(f"{source.file.name}: its study has other joints move: drop it together with the robot")
        return self.robot.read(source)

    @cached_property
    def body(self) -> Mechanism:
        """Return the joints of the recordings; those of an arm that do not move are where the recordings have them."""
        return self.robot.hold_joints([item.recording for item in self.loaded]) if self.robot is not None else PENDULUM

    @property
    def base_terms(self) -> tuple[Term, ...]:
        """Return the terms of the base model."""
        return arrange_terms(self.terms, self.body) if self.terms else arm_base(self.body)

    @cached_property
    def doubts_about_recordings(self) -> list[str]:
        """List doubts about the recordings of an arm, one sentence each."""
        return find_straying(find_links(self.base_terms), [item.recording for item in self.loaded])

    def restart(self, **choices: Any) -> Self:
        """Return other choices, from which the ladder begins anew."""
        return replace(self, **choices, fit=None, failure="", ladder=(), schemes=None, diagnosis=None, started=())

    def make_fit_task(self) -> partial[BaseFit]:
        """Make the task to fit the base model, for a worker."""
        train, holdout = (
            tuple(item.recording for item in self.loaded if item.held_out is is_held_out)
            for is_held_out in (False, True)
        )
        fit = fit_pendulum if self.body.can_simulate else fit_arm
        return partial(fit, train, holdout, self.base_terms, self.is_aligned, self.asked.limits)

    def with_fit(self, fit: BaseFit) -> Self:
        """Return the state with the fit of its base model."""
        return replace(self, fit=fit, ladder=(fit.step,), schemes=fit.schemes)

    @property
    def needs_fit(self) -> bool:
        """Return whether the base model has to be fitted."""
        return self.failure_reason == FITTING

    def swap_recording(self, old: LoadedRecording, *new: LoadedRecording) -> Self:
        """Return the state with one recording for another, or for none."""
        return self.restart(loaded=tuple(own for item in self.loaded for own in (new if item is old else (item,))))

    def set_robot(self, robot: RobotFile) -> Self:
        """Return the loaded recordings of a robot; raises BodyError or InputError for others."""
        robot.body()  # what is wrong with its file comes first
        try:
            robot = robot.keep_logged_joints([item.source for item in self.loaded])
            state = type(self)(robot=robot)
            return state.restart(loaded=tuple(replace(item, recording=state.read(item.source)) for item in self.loaded))
        except USER_ERRORS as error:
            raise InputError(f"what is loaded is not of this robot: {error}") from None

    def find(self, id: str) -> LoadedRecording:
        """Find the recording of an id; raises InputError if there is none."""
        for item in self.loaded:
            if item.id == id:
                return item
        raise InputError(f"{id[:80]}: is not loaded any more")

    @property
    def failure_reason(self) -> str:
        """Return the reason why there is no model; empty if there is one."""
        if self.fit is not None:
            return ""
        if all(item.held_out for item in self.loaded):
            return ALL_HELD_OUT if self.loaded else NO_RECORDING
        return self.failure or FITTING

    @property
    def data(self) -> FitData:
        """Return the data for fits; raises InputError if there are none."""
        if self.fit is None:
            raise InputError(self.failure_reason)
        return self.fit.data

    @property
    def recordings(self) -> list[Recording]:
        """Return the loaded recordings, calibrated and aligned as far as known and requested."""
        if self.failure_reason:
            return [item.recording for item in self.loaded]
        fitted, held_out = iter(self.train), iter(self.holdout)
        return [next(held_out if item.held_out else fitted) for item in self.loaded]

    @property
    def train(self) -> tuple[Recording, ...]:
        """Return the recordings that are fitted."""
        return self.data.recordings

    @property
    def holdout(self) -> tuple[Recording, ...]:
        """Return the recordings to check on; empty if the ends of the fitted ones are."""
        return self.data.holdout

    @property
    def model(self) -> Model:
        """Return the model at the end of the ladder."""
        return self.ladder[-1].model

    @property
    def added(self) -> tuple[str, ...]:
        """Return the effects on the ladder."""
        return list_added(self.ladder)

    @property
    def suggested_steps(self) -> tuple[Step, ...]:
        """Return the ladder as the diagnosis would have it; empty before there is one."""
        return (*self.started, *self.diagnosis.steps[1:]) if self.diagnosis is not None else ()

    @property
    def suggested_effects(self) -> tuple[str, ...]:
        """Return the effects of that ladder."""
        return list_added(self.suggested_steps)

    @property
    def suggested_additions(self) -> tuple[str, ...]:
        """Return the effects that the diagnosis calls for beyond the ladder."""
        return tuple(effect for effect in self.suggested_effects if effect not in self.added)

    def add_diagnosis(self, found: Diagnosis) -> Self:
        """Return the state with a diagnosis that started from its ladder."""
        return replace(self, diagnosis=found, started=self.ladder)

    def add_step(self, addition: Addition, schemes: Identification | None = None) -> Self:
        """Return the state with one more step; the effect's own refit of the model before it replaces the last step."""
        last = replace(addition.before, added=self.ladder[-1].added)
        ladder = (*self.ladder[:-1], last, addition.after)
        return replace(self, ladder=ladder, schemes=schemes if self.body.can_simulate else self.schemes)

    @cached_property
    def doubts(self) -> tuple[Finding, ...]:
        """Return findings on parameters that the fitted recordings do not determine."""
        if not self.body.can_simulate:
            return ()
        fitted = [r for r, item in zip(self.recordings, self.loaded, strict=True) if not item.held_out]
        return find_undetermined_parameters(fitted, BASE if self.failure_reason else self.model.terms)

    @cached_property
    def result(self) -> Diagnosis:
        """Return the result for the report: the diagnosis if it contains all added effects, else the added steps.

        Of an arm, the diagnosis if there is one.
        """
        found = self.diagnosis
        if found is not None and not self.body.can_simulate:
            return found
        if found is not None and set(self.added) < set(self.suggested_effects):
            return replace(found, steps=self.suggested_steps)
        data = self.data
        if data.terms and self.added:  # perhaps what joints share
            data = replace(data, terms=self.model.terms)
        if found is not None and self.added == self.suggested_effects:
            return replace(found, steps=self.ladder)
        fitted = data.parts[0]
        residual = fitted.with_link_states(self.model).residual(self.model.terms, self.model.theta)
        left = tuple(find_failures(fitted, residual))
        if found is not None:
            return replace(found, steps=self.ladder, unexplained=left)
        return Diagnosis(self.ladder, (), (), left, fitted.floors, self.doubts, data=data)

    @cached_property
    def report_data(self) -> ReportData:
        """Return the state with all recordings and added steps, without the effects of the diagnosis."""
        return ReportData(replace(self.result, steps=self.ladder, data=self.data), identified=self.schemes)


def list_added(steps: Sequence[Step]) -> tuple[str, ...]:
    """List the effects that steps added."""
    return tuple(step.added for step in steps if step.added is not None)
