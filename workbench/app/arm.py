"""What a session knows of an arm: the state of a pendulum's session, with a robot and a ladder of its models."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

from estimators.arguments import chosen_effects
from estimators.arms.gains import in_torque, without_loads
from estimators.comparison import compare, step_of_arm
from estimators.diagnosis.addition import add
from estimators.diagnosis.arm import parted
from estimators.diagnosis.run import diagnose
from estimators.regression.equations import IdentificationError
from estimators.schemes.identification import SAVED, Identification, identify
from estimators.selection.data import Step
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import Links, arm_base, at_joints, joint_effects, kind_at
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.mistake import Mistake
from pendulum_env.physics import Term
from pendulum_env.physics.table import TABLES
from pendulum_env.recording import Recording, Source
from pendulum_env.words import name, opening
from workbench.app import uploads
from workbench.app.state import NO_RECORDING, Asked, State
from workbench.mistakes import InputError
from workbench.processes import Task
from workbench.report import render, render_comparison
from workbench.robot import RobotFile, loaded_text, meaning, straying

WEIGHTLESS = "Its torques are without gravity"
SCHEMES = ("dynamic", "filtered_dynamic", "filtered_hamiltonian")  # the sure ones


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
    identification: Identification
    base: Step


@lru_cache(maxsize=4)  # states of the same choices share it
def fit_arm(
    body: Body, train: tuple[ArmRecording, ...], holdout: tuple[ArmRecording, ...], terms: tuple[Term, ...]
) -> Fitted:
    """The base model of an arm, with friction at each joint or with given terms.

    Raises:
        IdentificationError: if there is too little motion.
    """
    fitted, unseen = parted(train, holdout)
    found = identify(fitted, (Links(body), *terms) if terms else arm_base(body), SCHEMES)
    return Fitted(train, holdout, found, step_of_arm(None, found[SAVED].model, train=fitted, holdout=unseen))


@dataclass(frozen=True, eq=False)
class ArmState(State):
    """The same of recordings of an arm; `terms` are those at its joints, none for friction alone.

    Attributes:
        robot: whose recordings they are.
    """

    terms: tuple[Term, ...] = ()
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
    def told(self) -> Any:
        """The diagnosis."""
        return self.diagnosis

    @property
    def table(self) -> str | None:
        """A function of one joint that would explain what is left there."""
        return next(iter(self.diagnosis.tables), None) if self.diagnosis is not None else None

    def report(self) -> str:
        """HTML of the report: of the diagnosis, else of the comparison with what was held out."""
        if self.diagnosis is not None:
            return render(self.train, self.holdout, self.diagnosis)
        _, holdout = parted(self.fitted.train, self.fitted.holdout)
        return render_comparison(compare(self.model, holdout), holdout)

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
        chosen_effects(None, **asked.effects, body=self.body)

    def searching(self, at_will: bool) -> Task:
        """The search for what the ladder's last model lacks."""
        del at_will  # it suggests no experiment
        return partial(diagnose, self.fitted.train, self.fitted.holdout, self.model.terms, **self.asked.effects)

    def adding(self, id: str) -> Task:
        """The refit with one effect more; raises ValueError if it is none."""
        kind_at(id, self.body)
        return partial(add, self.model, id, self.fitted.train, self.fitted.holdout)


def called(id: str) -> str:
    """How a page names an effect at a joint."""
    effect, at, joint = id.partition("@")
    return f"{opening(name(effect))} at {joint}" if at else opening(name(effect))
