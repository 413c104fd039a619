"""Immutable state of a session: each change makes a new state, and a page is drawn from one state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from estimators.arguments import chosen_effects, within_limits
from estimators.checks.homogeneity import Disagreement, disagreements, own_fits
from estimators.checks.torque_constant import with_torque_constant
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.data.split import split_arm
from estimators.diagnosis.addition import fit
from estimators.diagnosis.result import Addition, Diagnosis
from estimators.findings import Finding
from estimators.free_swings import restore_known, swing_terms
from estimators.regression.equations import IdentificationError
from estimators.schemes.identifiability import identifiability
from estimators.schemes.identification import SAVED, Identification, identify
from estimators.selection.criterion import Criterion
from estimators.selection.errors import Step
from estimators.signals.measurements import measure_segments
from estimators.signals.residual import Region, everywhere
from pendulum_env._typing import Array
from pendulum_env.arms.joints import arm_base, body_of, links_of, model_terms
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.mistake import Mistake
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.physics.mechanism import PENDULUM, Mechanism
from pendulum_env.recording import Recording, RecordingError, Source
from pendulum_env.recording.record import PER_INERTIA
from pendulum_env.recording.study import named_twice
from workbench.app.uploads import safe_name
from workbench.mistakes import InputError
from workbench.narrator.findings import describe
from workbench.options import ids as effects_of
from workbench.options import known as values_of
from workbench.options import ranges
from workbench.report.case import Case
from workbench.robot import RobotFile, straying

NO_RECORDING = "load a recording first"
SCHEMES = ("dynamic", "filtered_dynamic", "filtered_hamiltonian")  # of an arm, the sure ones


def read_one(source: Source) -> Recording:
    """A recording of a pendulum; raises RecordingError, in the words of the command line."""
    return replace(source.read(), drive=None)  # pages draw it by its torque


@dataclass(frozen=True, eq=False)
class Loaded:
    """A recording of a session."""

    id: str  # by which the page names it: that of its file, with a number where several are of one file
    source: Source  # how its file is read, and whether it is held out
    recording: Recording  # what that gives
    origin: tuple[str, ...] = ()  # arguments of `pendulum-ident record` that made it; empty if it was uploaded

    @classmethod
    def of(
        cls,
        source: Source,
        known: Sequence[Loaded] = (),
        origin: tuple[str, ...] = (),
        read: Callable[[Source], Recording] = read_one,
    ) -> Loaded:
        """Read a recording beside those that are known, of whose files it may be another range.

        Raises InputError if it is known already, and RecordingError if it cannot be read, in the words of the command
        line.
        """
        name, ids = source.file.name, {one.id for one in known}
        alike = [one.source for one in known if one.source.file.name == name]
        if any(one.file != source.file or named_twice((one, source)) for one in alike):
            raise InputError(f"{name}: is loaded already: remove it, or give this one another name")
        recording = read(source)
        endings = ("", *(f" ({k})" for k in range(2, len(ids) + 2)))
        more = next(ending for ending in endings if name + ending not in ids)
        return cls(f"{name}{more}", source, replace(recording, name=f"{recording.name}{more}"), origin)

    @property
    def held_out(self) -> bool:
        """Return whether the recording is held out."""
        return self.source.role == "holdout"


@dataclass(frozen=True)
class Asked:
    """Effects to look for, values that are known and bounds of others, each in the words of the command line."""

    only: str = ""  # ids of the effects that are looked for, with commas; empty: all
    without: str = ""  # ids of those that are not
    fix: str = ""  # `gravity=2.01,...`
    bound: str = ""  # `viscous=0:0.5,...`

    @classmethod
    def of(cls, form: Mapping[str, Any]) -> Asked:
        """Return the values of the form fields `ask-only` and so on: ids in a list, or text."""
        values = (form.get(f"ask-{field.name}") or "" for field in fields(cls))
        return cls(*(",".join(map(str, value)) if isinstance(value, list) else str(value).strip() for value in values))

    @property
    def effects(self) -> dict[str, Any]:
        """Return the effects for `diagnose`; raises as the command line."""
        return {"only": effects_of(self.only) or None, "without": effects_of(self.without)}

    @property
    def limits(self) -> dict[str, Any]:
        """Return the limits of parameters for `diagnose` and `add`; raises as the command line."""
        return {
            "fixed": values_of(self.fix) if self.fix else {},
            "bounds": ranges(self.bound) if self.bound else {},
        }

    def check(self, terms: Sequence[Term]) -> None:
        """Refuse what makes no sense beside a model's terms: raises ValueError as the command line does."""
        chosen_effects(None, **self.effects, body=body_of(terms))
        within_limits(terms, {}, **self.limits)

    def options(self, *fields: str) -> list[str]:
        """Some fields as words of a command."""
        return [f"--{field}={getattr(self, field)}" for field in fields if getattr(self, field)]

    def arguments(self, *kinds: dict[str, Any]) -> str:
        """Arguments of Python that are given, each with a comma before it."""
        return "".join(f", {name}={value!r}" for kind in kinds for name, value in kind.items() if value)


NOTHING = Asked()  # every effect is looked for, and nothing is known


@dataclass(frozen=True, eq=False)
class Prepared:
    """Recordings that a model can be fitted to."""

    data: FitData  # in N m, with their torque in time if that is asked for
    timed: FitData  # the same with their torque in time
    base: Step  # the base model, fitted
    schemes: Identification | None = None  # what some schemes find of an arm


@lru_cache(maxsize=4)  # states of the same choices share it
def prepare(loaded: tuple[Loaded, ...], terms: tuple[Term, ...], is_aligned: bool, asked: Asked) -> Prepared:
    """Prepare recordings for fits; `asked` has the fixed and bounded parameters of the base model.

    Raises InputError if no known load tells a gain, and IdentificationError if there is too little motion.
    """
    train, holdout = ([one.recording for one in loaded if one.held_out is held] for held in (False, True))
    terms, _ = within_limits(terms, {}, **asked.limits)
    given = FitData.of(train, holdout, terms)
    if given.doubt is not None and given.unit != PER_INERTIA:
        raise InputError(f"{describe(given.doubt)} Or give the gain itself.")
    timed = given.timed()
    own = timed if is_aligned else given
    base = fit(*own.parts, swing_terms(terms, own.recordings))
    model = restore_known(with_torque_constant(base.model, own.parts[0].data), terms, own.recordings)
    return Prepared(own, timed, replace(base, model=model))


@lru_cache(maxsize=4)
def prepare_arm(loaded: tuple[Loaded, ...], terms: tuple[Term, ...], is_aligned: bool, asked: Asked) -> Prepared:
    """Prepare recordings of an arm for fits, without alignment; raises as `prepare`."""
    train, holdout = ([one.recording for one in loaded if one.held_out is held] for held in (False, True))
    fitted, _ = split_arm(train, holdout)
    found = identify(fitted, terms, SCHEMES)
    model, data = found[SAVED].model, FitData.of(train, holdout, found[SAVED].model.terms)
    errors = {name: part.errors(model) for name, part in zip(("train", "holdout"), data.parts, strict=True)}
    return Prepared(data, data, Step(None, model, errors), found)


def unexplained(prepared: RegressionData, model: Model) -> tuple[Region, ...]:
    """Find regions of the residual above noise in the fitted data, by joint."""
    residual: Array = prepared.with_link_states(model).residual(model.terms, model.theta)
    felt, data, regions = prepared.inertias(prepared.base), prepared.data, list[Region]()
    for at in data.joints:
        structure = data.part(at).structure(residual[data.where(at)], felt[at])
        if not Criterion().is_noise(structure, prepared.floors[at]):
            regions += prepared.stand_out(residual, at) or [everywhere(at=at)]
    return tuple(regions)


@dataclass(frozen=True, eq=False)
class State:
    """Choices of the user and results of jobs; other values are computed from these on demand."""

    loaded: tuple[Loaded, ...] = ()  # recordings
    terms: tuple[Term, ...] = ()  # of the base model, of an arm those at its joints; empty: the usual ones
    model_file: str = ""  # name of the file that they came from; empty for the usual ones
    is_aligned: bool = False  # whether torque that was logged late or filtered is corrected
    asked: Asked = NOTHING  # which effects are looked for, and which values are known
    # The ladder once effects were added: the base model, then one step for each; empty before
    grown: tuple[Step, ...] = ()
    diagnosis: Diagnosis | None = None  # the last one of these recordings
    started: tuple[Step, ...] = ()  # the ladder that it started from
    robot: RobotFile | None = None  # whose recordings they are; None of a pendulum

    @property
    def moving(self) -> tuple[str, ...]:
        """Joints of an arm that recordings are of; none of a pendulum."""
        return self.robot.body().joints if self.robot is not None else ()

    def read(self, source: Source) -> Recording:
        """A recording, as it is for this state; raises RecordingError, and InputError if it is of other joints."""
        if self.robot is None:
            return read_one(source)
        if source.joints not in (None, self.robot.joints):
            raise InputError(f"{source.file.name}: its study has other joints move: drop it together with the robot")
        return self.robot.read(source)

    @cached_property
    def body(self) -> Mechanism:
        """Joints of the recordings; those of an arm that do not move are where the recordings have them."""
        return self.robot.holding(self._arms) if self.robot is not None else PENDULUM

    @property
    def base_terms(self) -> tuple[Term, ...]:
        """Return the terms of the base model."""
        return model_terms(self.terms, self.body) if self.terms else arm_base(self.body)

    @property
    def _arms(self) -> list[ArmRecording]:
        return [one.recording for one in self.loaded if isinstance(one.recording, ArmRecording)]

    @cached_property
    def questions(self) -> list[str]:
        """List doubts about the recordings of an arm, one sentence each."""
        return straying(links_of(self.base_terms), self._arms)

    def anew(self, **choices: Any) -> State:
        """Other choices, from which the ladder begins anew."""
        return replace(self, **choices, grown=(), diagnosis=None, started=())

    def having(self, loaded: Sequence[Loaded]) -> State:
        """The state with more recordings; raises InputError if they are not of its arm."""
        if self.robot is not None and not all(isinstance(one.recording, ArmRecording) for one in loaded):
            raise InputError("this session is of an arm: leave the robot first, in the stage Data")
        return self.anew(loaded=(*self.loaded, *loaded))

    def swapping(self, old: Loaded, *new: Loaded) -> State:
        """The state with one recording for another, or for none."""
        return self.anew(loaded=tuple(own for one in self.loaded for own in (new if one is old else (one,))))

    def of_robot(self, robot: RobotFile) -> State:
        """Return the loaded recordings of a robot; raises BodyError or InputError for others."""
        try:
            robot = robot.with_logged_joints([one.source for one in self.loaded])
        except RecordingError as error:
            raise InputError(f"what is loaded is not of this robot: {error}") from None
        robot.body()
        state = State(robot=robot)
        try:
            return state.anew(loaded=tuple(replace(one, recording=state.read(one.source)) for one in self.loaded))
        except Mistake as error:
            raise InputError(f"what is loaded is not of this robot: {error}") from None

    def find(self, id: str) -> Loaded:
        """The recording of an id; raises InputError if there is none."""
        for one in self.loaded:
            if one.id == id:
                return one
        raise InputError(f"{safe_name(id)}: is not loaded any more")

    @cached_property
    def _prepared(self) -> Prepared | str:
        """Return the data for fits, or the reason why there are none."""
        if all(one.held_out for one in self.loaded):
            return "every recording is held out: keep one to fit the model to" if self.loaded else NO_RECORDING
        try:
            known = Asked(fix=self.asked.fix, bound=self.asked.bound)
            make = prepare if self.body.can_simulate else prepare_arm
            return make(self.loaded, self.base_terms, self.is_aligned, known)
        except (Mistake, IdentificationError) as error:
            return str(error)

    @property
    def prepared(self) -> Prepared:
        """Return the data for fits; raises InputError if there are none."""
        if isinstance(self._prepared, str):
            raise InputError(self._prepared)
        return self._prepared

    @property
    def trouble(self) -> str:
        """Why nothing can be fitted; empty if there is a model."""
        return self._prepared if isinstance(self._prepared, str) else ""

    @property
    def ladder(self) -> tuple[Step, ...]:
        """The base model, then one step for each effect that was added; empty while nothing can be fitted."""
        return () if self.trouble else self.grown or (self.prepared.base,)

    @property
    def recordings(self) -> list[Recording]:
        """Return the loaded recordings, calibrated and aligned as far as known and requested."""
        if self.trouble:
            return [one.recording for one in self.loaded]
        fitted, held_out = iter(self.train), iter(self.holdout)
        return [next(held_out if one.held_out else fitted) for one in self.loaded]

    @property
    def train(self) -> tuple[Recording, ...]:
        """Recordings that are fitted."""
        return self.prepared.data.recordings

    @property
    def holdout(self) -> tuple[Recording, ...]:
        """Recordings to check on; empty if the ends of the fitted ones are."""
        return self.prepared.data.holdout

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
    def called(self) -> tuple[str, ...]:
        """Its effects."""
        return ids(self.called_for)

    @property
    def found(self) -> tuple[str, ...]:
        """Effects that the diagnosis calls for beyond the ladder."""
        return tuple(effect for effect in self.called if effect not in self.added)

    def diagnosed(self, found: Diagnosis) -> State:
        """The state with a diagnosis that started from its ladder."""
        return replace(self, diagnosis=found, started=self.ladder)

    def with_step(self, addition: Addition) -> State:
        """The state with one more step; the effect's own refit of the model before it replaces the last step."""
        last = replace(addition.before, added=self.ladder[-1].added)
        return replace(self, grown=(*self.ladder[:-1], last, addition.after))

    def without_step(self) -> State:
        """The state without the last effect that was added."""
        return replace(self, grown=self.ladder[:-1]) if self.added else self

    @cached_property
    def doubts(self) -> tuple[Finding, ...]:
        """Return findings on parameters that the fitted recordings do not determine."""
        if not self.body.can_simulate:
            return ()
        fitted = [r for r, one in zip(self.recordings, self.loaded, strict=True) if not one.held_out]
        measured = [segment for recording in fitted for segment in measure_segments(recording)]
        return identifiability(measured, BASE if self.trouble else self.model.terms) if measured else ()

    @cached_property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Recordings that show another plant than the others, as the diagnosis has it, or would begin with."""
        if self.diagnosis is not None:
            return self.diagnosis.disagreements
        if self.trouble:
            return ()
        parts = self.prepared.data.parts[: 2 if self.holdout else 1]
        return disagreements(own_fits([part.data for part in parts], self.model.terms), only_if_all_fit=True)

    @cached_property
    def told(self) -> Diagnosis:
        """Return the result for the report: the diagnosis if it contains all added effects, else the added steps.

        Of an arm, the diagnosis if there is one.
        """
        found = self.diagnosis
        if found is not None and not self.body.can_simulate:
            return found
        if found is not None and set(self.added) < set(self.called):
            return replace(found, steps=self.called_for)
        data = self.prepared.data
        if data.terms and self.added:  # perhaps what joints share
            data = replace(data, terms=self.model.terms)
        if found is not None:
            left = found.unexplained if self.added == self.called else unexplained(data.parts[0], self.model)
            return replace(found, steps=self.ladder, unexplained=left)
        left = unexplained(data.parts[0], self.model)
        return Diagnosis(self.ladder, (), (), left, data.parts[0].floors, self.doubts, data=data)

    @cached_property
    def case(self) -> Case:
        """Return the data of the sections of the report."""
        return Case(self.told)

    @cached_property
    def standing(self) -> Case:
        """Return the state with all recordings and added steps, without the effects of the diagnosis."""
        return Case(replace(self.told, steps=self.ladder, data=self.prepared.data))

    @property
    def seconds(self) -> float:
        """Length of all recordings [s]."""
        return float(np.sum([one.recording.duration for one in self.loaded]))


def ids(steps: Sequence[Step]) -> tuple[str, ...]:
    """Effects that steps added."""
    return tuple(step.added for step in steps if step.added is not None)
