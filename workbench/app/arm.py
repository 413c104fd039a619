"""What a session knows of an arm: the state of a pendulum's session, with a robot and a ladder of its models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

from estimators.arms.addition import add_arm
from estimators.arms.diagnosis import ArmDiagnosis, diagnose_arm, parted
from estimators.arms.gains import in_torque, without_loads
from estimators.arms.identification import ArmIdentification, ArmStep, for_arms, identify_arm
from estimators.progress import Progress
from estimators.regression.equations import IdentificationError
from estimators.schemes.six import scheme
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import at_joints, joint_effects, kind_at
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.mistake import Mistake
from pendulum_env.physics import Term
from pendulum_env.physics.table import TABLES
from pendulum_env.recording import Recording, Source
from pendulum_env.words import name, opening
from workbench.app import uploads
from workbench.app.state import NO_RECORDING, Asked, State
from workbench.arms import SAVED
from workbench.mistakes import InputError
from workbench.processes import Task
from workbench.report.arm import render_arm
from workbench.robot import RobotFile, loaded_text, looked_for, meaning, straying

WEIGHTLESS = "Its torques are without gravity"
SCHEMES = for_arms([scheme(id) for id in ("dynamic", "filtered_dynamic", "filtered_hamiltonian")])  # the sure ones


@dataclass(frozen=True, eq=False)
class Fitted:
    """What recordings of an arm give to fit models to: as `Prepared` has it.

    Attributes:
        train, holdout: recordings.
        identification: base parameters and friction by some schemes.
        base: the base model.
    """

    train: tuple[ArmRecording, ...]
    holdout: tuple[ArmRecording, ...]
    identification: ArmIdentification
    base: ArmStep


@lru_cache(maxsize=4)  # states of the same choices share it
def fit_arm(
    body: Body, train: tuple[ArmRecording, ...], holdout: tuple[ArmRecording, ...], terms: tuple[Term, ...]
) -> Fitted:
    """The base model of an arm, with friction at each joint or with given terms.

    Raises:
        IdentificationError: if there is too little motion.
    """
    fitted, unseen = parted(train, holdout)
    found = identify_arm(fitted, body, terms or None, SCHEMES)
    return Fitted(train, holdout, found, ArmStep.of(None, found[SAVED].model, train=fitted, holdout=unseen))


@dataclass(frozen=True, eq=False)
class ArmState(State):
    """The same of recordings of an arm; `terms` are those at its joints, none for friction alone.

    Attributes:
        robot: whose recordings they are.
    """

    terms: tuple[Term, ...] = ()
    grown: tuple[ArmStep, ...] = ()
    diagnosis: ArmDiagnosis | None = None  # type: ignore[assignment]
    started: tuple[ArmStep, ...] = ()
    robot: RobotFile = field(kw_only=True)

    @property
    def joints(self) -> tuple[str, ...] | None:
        """Those that move, if that is known."""
        return self.robot.joints

    @property
    def moving(self) -> tuple[str, ...]:
        """Joints that recordings are of."""
        return self.robot.body().joints

    @property
    def files(self) -> set[Path]:
        """Files that the state speaks of."""
        return {*super().files, self.robot.file}

    def read(self, source: Source) -> ArmRecording:
        """A recording of the robot; raises RecordingError, and InputError if a study has other joints move."""
        if source.joints not in (None, self.robot.joints):
            raise InputError(f"{source.file.name}: its study has other joints move: drop it together with the robot")
        return self.robot.read(replace(source, largest=uploads.LIMITS.unpacked))

    @cached_property
    def body(self) -> Body:
        """The links, joints that do not move being where the recordings have them."""
        return self.robot.holding([one.recording for one in self.loaded if isinstance(one.recording, ArmRecording)])

    @cached_property
    def _torques(self) -> tuple[ArmRecording, ...]:
        """What is loaded, currents turned into torques where known loads tell the gains."""
        return in_torque([one.recording for one in self.loaded], self.body).recordings  # type: ignore[misc]

    @property
    def recordings(self) -> list[Recording]:
        """Those that are loaded, in N m as far as that is known."""
        return [one.recording for one in self.loaded] if self.trouble else list(self._torques)

    @cached_property
    def _prepared(self) -> Fitted | str:  # type: ignore[override]
        try:
            both = list(zip(self.loaded, self._torques, strict=True))
            train, holdout = without_loads(
                *([own for one, own in both if one.held_out == held] for held in (False, True))
            )
            if not train:
                return "every recording is held out: keep one to fit the model to" if holdout else NO_RECORDING
            return fit_arm(self.body, tuple(train), tuple(holdout), self.terms)
        except (Mistake, IdentificationError) as error:
            return str(error)

    @property
    def called(self) -> tuple[str, ...]:
        """Effects that the diagnosis calls for; none before there is one."""
        started = tuple(step.added for step in self.started if step.added is not None)
        return (*started, *self.diagnosis.selected) if self.diagnosis is not None else ()

    @property
    def fitted(self) -> Fitted:
        """What models are fitted to; raises InputError as `prepared`."""
        return self.prepared  # type: ignore[return-value]

    @cached_property
    def questions(self) -> list[str]:
        """What is doubtful in the recordings, a sentence or a question each."""
        away = straying(self.body, self.recordings)  # type: ignore[arg-type]
        if self.trouble:
            return away
        loaded = loaded_text(self._torques, [*self.train, *self.holdout])  # type: ignore[list-item]
        return [*away, *([loaded] if loaded else []), *meaning(self._torques, self.body, f"press “{WEIGHTLESS}”")]

    @property
    def rungs(self) -> tuple[ArmStep, ...]:
        """The ladder."""
        return self.ladder  # type: ignore[return-value]

    @property
    def told(self) -> Any:
        """The diagnosis."""
        return self.diagnosis

    @property
    def table(self) -> str | None:
        """A function of one joint that would explain what is left there."""
        return next(iter(self.diagnosis.tables), None) if self.diagnosis is not None else None

    def report(self) -> str:
        """HTML of the report: of the diagnosis, else of the comparison with what was held out."""
        train, holdout = parted(self.fitted.train, self.fitted.holdout)
        if self.diagnosis is not None:
            return render_arm(train, self.diagnosis.steps, self.diagnosis)
        return render_arm(holdout, self.rungs[-1:])

    @property
    def library(self) -> dict[str, str]:
        """What a diagnosis may look for, at every joint or at one, by id."""
        ids = [*joint_effects(), *(kind.id for kind in at_joints(joint_effects().values(), self.body))]
        return {id: called(id) for id in ids}

    @property
    def addable(self) -> dict[str, str]:
        """Effects and tables that may be added at joints, by id."""
        kinds = at_joints([*joint_effects().values(), *TABLES.values()], self.body)
        known = {term.id for term in self.model.terms}
        return {kind.id: called(kind.id) for kind in kinds if kind.id not in known}

    def check(self, asked: Asked) -> None:
        """Refuse what makes no sense, in the words of the command line."""
        if asked.fix or asked.bound:
            raise InputError("values and bounds are known of pendulums alone: leave them out for an arm")
        looked_for(self.body, asked.effects["only"], asked.effects["without"])

    def searching(self, at_will: bool) -> Task:
        """The search for what the ladder's last model lacks."""
        del at_will  # it suggests no experiment
        model = self.rungs[-1].model
        return partial(_diagnose, self.fitted.train, model.body, self.fitted.holdout, model.terms[1:], self.asked)

    def adding(self, id: str) -> Task:
        """The refit with one effect more; raises ValueError if it is none."""
        kind_at(id, self.body)
        return partial(add_arm, self.rungs[-1].model, id, self.fitted.train, self.fitted.holdout)


def called(id: str) -> str:
    """How a page names an effect at a joint."""
    effect, at, joint = id.partition("@")
    return f"{opening(name(effect))} at {joint}" if at else opening(name(effect))


def _diagnose(
    train: Sequence[ArmRecording],
    body: Body,
    holdout: Sequence[ArmRecording],
    terms: tuple[Term, ...],
    asked: Asked,
    progress: Progress,
) -> ArmDiagnosis:
    """`diagnose_arm` in a worker, to which kinds of terms do not travel."""
    library = looked_for(body, asked.effects["only"], asked.effects["without"])
    return diagnose_arm(train, body, holdout, progress, terms=terms, library=library)
