"""Immutable state of a session, with the options of a search."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import Any, Self

from estimators import Addition, Diagnosis, FitData
from estimators.arguments import apply_limits, select_effects
from estimators.data.model_errors import compute_errors
from estimators.data.regions import find_failures
from estimators.data.timing import Timing
from estimators.decisions.errors import Step
from estimators.findings import Finding
from estimators.schemes.identifiability import find_undetermined_parameters
from pendulum_env.errors import ColumnError
from pendulum_env.physics import BASE, PENDULUM, Mechanism, Model, Term
from pendulum_env.physics.joints import arrange_terms, find_mechanism, list_base_terms
from pendulum_env.recording import Recording, Source
from pendulum_env.recording.study import find_duplicate
from pendulum_env.robot_file import RobotFile
from workbench.app.fits import BaseFit, fit_arm, fit_pendulum
from workbench.errors import USER_ERRORS, InputError
from workbench.options import parse_bounds
from workbench.options import parse_effects as effects_of
from workbench.options import parse_values as values_of
from workbench.report.data import ReportData


@dataclass(frozen=True)
class SearchChoices:
    """Effects to look for, known values and bounds, each as text of the command-line option."""

    only: str = ""  # comma-separated ids of the effects to look for; empty: all
    without: str = ""  # comma-separated ids of the effects to leave out
    fix: str = ""  # known values, `gravity=2.01,...`
    bound: str = ""  # bounds, `viscous=0:0.5,...`

    @classmethod
    def from_form(cls, form: Mapping[str, Any]) -> SearchChoices:
        """Create choices from the form fields `ask-only`, `ask-without`, `ask-fix` and `ask-bound`."""
        values = (form.get(f"ask-{field.name}") or "" for field in fields(cls))
        return cls(*(",".join(map(str, value)) if isinstance(value, list) else str(value).strip() for value in values))

    @property
    def effects(self) -> dict[str, Any]:
        """Return the arguments `only` and `without` of `diagnose`; raises ValueError if an effect is unknown."""
        return {"only": effects_of(self.only) or None, "without": effects_of(self.without)}

    @property
    def limits(self) -> dict[str, Any]:
        """Return the arguments `fixed` and `bounds` of `diagnose` and `add`; raises InputError if they are invalid."""
        fixed, bounds = values_of(self.fix) if self.fix else {}, parse_bounds(self.bound) if self.bound else {}
        return {"fixed": fixed, "bounds": bounds}

    def check(self, terms: Sequence[Term]) -> None:
        """Raise ValueError if an effect or parameter does not exist for a model with these terms."""
        select_effects(None, **self.effects, mechanism=find_mechanism(terms))
        apply_limits(terms, {}, **self.limits)

    def write_options(self, *fields: str) -> list[str]:
        """Write the given fields as command-line options, without empty ones."""
        return [f"--{field}={getattr(self, field)}" for field in fields if getattr(self, field)]


NO_CHOICES = SearchChoices()  # all effects, no known values


NO_RECORDING = "load a recording first"
ALL_HELD_OUT = "every recording is held out: keep one to fit the model to"
FITTING = "the model is being fitted"


def read_pendulum(source: Source) -> Recording:
    """Read a recording of a pendulum without its drive.

    Raises RecordingError, and ColumnError if it has no torque and its source does not say that nothing drives it.
    """
    recording = replace(source.read(), drive=None)  # the app evaluates torque, not the loop
    named = {} if recording.origin is None else recording.origin.columns
    if recording.is_free and "torque" not in {*named, *source.columns}:
        raise ColumnError(f"{source.file.name}: no column for torque: choose one, or say that nothing drives the joint")
    return recording


@dataclass(frozen=True, eq=False)
class LoadedRecording:
    """Recording of a session with its source."""

    id: str  # file name, with a number for further ranges of one file
    source: Source  # file, reading options and role
    recording: Recording  # as read from the source

    @classmethod
    def read(
        cls,
        source: Source,
        loaded: Sequence[Self] = (),
        read_source: Callable[[Source], Recording] = read_pendulum,
    ) -> Self:
        """Read a recording; it may be another range of a known file.

        Raises InputError if it is among the `loaded` recordings, and RecordingError if it cannot be read.
        """
        name, ids = source.file.name, {other.id for other in loaded}
        same_name = [other.source for other in loaded if other.source.file.name == name]
        if any(other.file != source.file or find_duplicate((other, source)) for other in same_name):
            raise InputError(f"{name}: is loaded already: remove it, or give this one another name")
        recording = read_source(source)
        endings = ("", *(f" ({k})" for k in range(2, len(ids) + 2)))
        suffix = next(ending for ending in endings if name + ending not in ids)
        return cls(f"{name}{suffix}", source, replace(recording, name=f"{recording.name}{suffix}"))

    @property
    def held_out(self) -> bool:
        """Return whether the recording is held out."""
        return self.source.role == "holdout"

    def hold_out(self, held_out: bool) -> Self:
        """Return the recording held out, or to fit."""
        return replace(self, source=replace(self.source, role="holdout" if held_out else "fit"))


@dataclass(frozen=True, eq=False)
class State:
    """Choices of the user and results of jobs; fits are in `fits`."""

    loaded: tuple[LoadedRecording, ...] = ()
    terms: tuple[Term, ...] = ()  # of the base model, for an arm without its links; empty: default terms
    model_file: str = ""  # name of the file of these terms; empty for the default
    is_aligned: bool = False  # whether torque that was logged late or filtered is corrected
    choices: SearchChoices = NO_CHOICES  # effects to look for, and known values
    fit: BaseFit | None = None  # None before the fit, or if it failed
    failure: str = ""  # error of the fit
    steps: tuple[Step, ...] = ()  # base model and one step for each added effect; empty without a fit
    diagnosis: Diagnosis | None = None  # last diagnosis of these recordings
    steps_before: tuple[Step, ...] = ()  # added steps at the start of the diagnosis
    robot: RobotFile | None = None  # None for a pendulum

    @property
    def moving(self) -> tuple[str, ...]:
        """Return the moving joints of the arm; empty for a pendulum."""
        return self.robot.body().joints if self.robot is not None else ()

    def read(self, source: Source) -> Recording:
        """Read a recording of the pendulum or robot; raises RecordingError, and InputError for other joints."""
        if self.robot is None:
            return read_pendulum(source)
        if source.joints not in (None, self.robot.joints):
            raise InputError(f"{source.file.name}: its study has other joints move: drop it together with the robot")
        return self.robot.read(source)

    @cached_property
    def body(self) -> Mechanism:
        """Return the pendulum, or the arm with held joints at their recorded positions."""
        return self.robot.hold_joints([item.recording for item in self.loaded]) if self.robot is not None else PENDULUM

    @property
    def base_terms(self) -> tuple[Term, ...]:
        """Return the terms of the base model."""
        return arrange_terms(self.terms, self.body) if self.terms else list_base_terms(self.body)

    def restart(self, **choices: Any) -> Self:
        """Return the state with changed choices and without fits and diagnosis."""
        return replace(self, **choices, fit=None, failure="", steps=(), diagnosis=None, steps_before=())

    def make_fit_task(self) -> partial[BaseFit]:
        """Make the task that fits the base model."""
        train = tuple(item.recording for item in self.loaded if not item.held_out)
        holdout = tuple(item.recording for item in self.loaded if item.held_out)
        fit = fit_pendulum if self.body.can_simulate else fit_arm
        return partial(fit, train, holdout, self.base_terms, self.is_aligned, self.choices.limits)

    def with_fit(self, fit: BaseFit) -> Self:
        """Return the state with the fit of its base model."""
        return replace(self, fit=fit, steps=(fit.step,))

    @property
    def needs_fit(self) -> bool:
        """Return whether the base model can and must be fitted."""
        return self.failure_reason == FITTING

    def swap_recording(self, removed: LoadedRecording, *added: LoadedRecording) -> Self:
        """Return the state with a recording replaced by `added`, or removed."""
        parts = (added if item is removed else (item,) for item in self.loaded)
        return self.restart(loaded=tuple(recording for part in parts for recording in part))

    def set_robot(self, robot: RobotFile) -> Self:
        """Return a state with the robot and its recordings; raises BodyError or InputError if they do not fit."""
        robot.body()  # report errors in its file first
        try:
            robot = robot.keep_logged_joints([item.source for item in self.loaded])
            state = type(self)(robot=robot)
            return state.restart(loaded=tuple(replace(item, recording=state.read(item.source)) for item in self.loaded))
        except USER_ERRORS as error:
            raise InputError(f"what is loaded is not of this robot: {error}") from None

    def find(self, id: str) -> LoadedRecording:
        """Return the recording of an id; raises InputError for another id."""
        for item in self.loaded:
            if item.id == id:
                return item
        raise InputError(f"{id[:80]}: is not loaded any more")

    @property
    def failure_reason(self) -> str:
        """Return the reason for a missing model; empty with a model."""
        if self.fit is not None:
            return ""
        if all(item.held_out for item in self.loaded):
            return ALL_HELD_OUT if self.loaded else NO_RECORDING
        return self.failure or FITTING

    @property
    def data(self) -> FitData:
        """Return the data for fits; raises InputError before the base model is fitted."""
        if self.fit is None:
            raise InputError(self.failure_reason)
        return self.fit.data

    @property
    def recordings(self) -> list[Recording]:
        """Return the loaded recordings; after the fit, calibrated and, if requested, aligned."""
        if self.failure_reason:
            return [item.recording for item in self.loaded]
        fitted, held_out = iter(self.data.recordings), iter(self.data.holdout)
        return [next(held_out if item.held_out else fitted) for item in self.loaded]

    @property
    def model(self) -> Model:
        """Return the last model."""
        return self.steps[-1].model

    @property
    def added(self) -> tuple[str, ...]:
        """Return the added effects."""
        return list_added(self.steps)

    @property
    def suggested_steps(self) -> tuple[Step, ...]:
        """Return the added steps with those of the diagnosis; empty without a diagnosis."""
        return (*self.steps_before, *self.diagnosis.steps[1:]) if self.diagnosis is not None else ()

    @property
    def suggested_effects(self) -> tuple[str, ...]:
        """Return the effects of `suggested_steps`."""
        return list_added(self.suggested_steps)

    @property
    def suggested_additions(self) -> tuple[str, ...]:
        """Return the effects of the diagnosis that are not added yet."""
        return tuple(effect for effect in self.suggested_effects if effect not in self.added)

    def add_diagnosis(self, diagnosis: Diagnosis) -> Self:
        """Return the state with a diagnosis of its last model."""
        return replace(self, diagnosis=diagnosis, steps_before=self.steps)

    def add_step(self, addition: Addition) -> Self:
        """Return the state with one more step.

        A pendulum's step has the errors on the windows of the base model, which an addition may cut anew; the earlier
        steps stay. For an arm, the addition's refit of the last model replaces the last step.
        """
        if not self.body.can_simulate:
            last = replace(addition.before, added=self.steps[-1].added)
            return replace(self, steps=(*self.steps[:-1], last, addition.after))
        model, parts = addition.after.model, zip(("train", "holdout"), self.data.parts, strict=True)
        errors = {name: compute_errors(part.with_link_states(model), model) for name, part in parts}
        return replace(self, steps=(*self.steps, replace(addition.after, errors=errors)))

    @cached_property
    def torque_timing(self) -> Timing:
        """Return the timing of the torque of a pendulum; slow to estimate."""
        return self.data.timing if self.is_aligned else self.data.with_timing().timing

    @cached_property
    def doubts(self) -> tuple[Finding, ...]:
        """Return findings on parameters that the fitted recordings do not determine; empty for an arm."""
        if not self.body.can_simulate:
            return ()
        fitted = [r for r, item in zip(self.recordings, self.loaded, strict=True) if not item.held_out]
        return find_undetermined_parameters(fitted, BASE if self.failure_reason else self.model.terms)

    @cached_property
    def result(self) -> Diagnosis:
        """Return the result for the report: the diagnosis until all its effects are added, then the added steps.

        For an arm, return the diagnosis if one was made.
        """
        diagnosis = self.diagnosis
        if diagnosis is not None and not self.body.can_simulate:
            return diagnosis
        if diagnosis is not None and self.suggested_additions:
            return replace(diagnosis, steps=self.suggested_steps)
        data = self.data
        if data.terms and self.added:
            data = replace(data, terms=self.model.terms)
        if diagnosis is not None and self.added == self.suggested_effects:
            return replace(diagnosis, steps=self.steps)
        fitted = data.parts[0]
        residual = fitted.with_link_states(self.model).residual(self.model.terms, self.model.theta)
        regions = tuple(find_failures(fitted, residual, data.criterion))
        if diagnosis is not None:
            return replace(diagnosis, steps=self.steps, unexplained=regions)
        return Diagnosis(self.steps, (), (), regions, data.parts[1].floors, self.doubts, data=data)

    @cached_property
    def report_data(self) -> ReportData:
        """Return data of the report for the added steps only, without further effects of the diagnosis."""
        return ReportData(replace(self.result, steps=self.steps, data=self.data))


def list_added(steps: Sequence[Step]) -> tuple[str, ...]:
    """List the effects that steps added."""
    return tuple(step.added for step in steps if step.added is not None)
