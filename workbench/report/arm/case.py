"""What a section of an arm's report may look at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from estimators.arms.identification import JointError
from estimators.diagnosis.result import Candidate
from estimators.selection.data import Evidence
from pendulum_env.arms.model import ArmModel


@dataclass(frozen=True, eq=False)
class Drawn:
    """One model of the report.

    Attributes:
        label: by which the page calls it.
        color: of its curves, a name of the page's style.
        model: itself.
        errors: its torque errors, joint by joint.
    """

    label: str
    color: str
    model: ArmModel
    errors: tuple[JointError, ...]


@dataclass(frozen=True, eq=False)
class ArmCase:
    """One model of an arm, or one before and one after effects were added, with the recordings they are drawn on.

    Attributes:
        evidence: windows of the recordings.
        models: one or two, the last one final.
        measured: of what the errors are, in words.
        selected: effects that were found, `stribeck@elbow`.
        judged: effects that were judged, each once.
        unexplained: torque that is left at joints and surely is something [N m].
        next_step: what to do now, if anything.
    """

    evidence: Evidence
    models: tuple[Drawn, ...]
    measured: str
    selected: tuple[str, ...] = ()
    judged: tuple[Candidate, ...] = ()
    unexplained: Mapping[str, float] = field(default_factory=dict)
    next_step: str = ""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.evidence.data.joints

    @property
    def final(self) -> Drawn:
        """The last of the models."""
        return self.models[-1]
