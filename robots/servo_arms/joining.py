"""Join the results of the joints of an arm of servos: models, errors, verdicts and findings, each at its joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from estimators.data.fit_data import FitData
from estimators.data.regions import ResidualWithoutPlace
from estimators.decisions.errors import Step, join_errors
from estimators.diagnosis.result import Diagnosis
from estimators.findings import Finding
from pendulum_env.physics import Model
from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.recording.study import collect_log_format
from robots.arms.body import find_body
from robots.servo_arms.model import ServoArmModel


@dataclass(frozen=True)
class AtJoint(Finding):
    """Finding on the servo of a joint, or the same finding on those of several joints."""

    joints: tuple[str, ...]
    finding: Finding

    @property
    def is_biasing(self) -> bool:
        """Return False: it is of some joints alone."""
        return False

    @property
    def is_open(self) -> bool:
        """Return whether another recording would settle it."""
        return self.finding.is_open


def join_diagnoses(data: FitData, diagnoses: Mapping[str, Diagnosis]) -> Diagnosis:
    """Join the diagnoses of the joints to one of an arm's data, with effects such as `stribeck@elbow`."""
    body = find_body(data.terms)
    present = {at: one.steps[0] for at, one in diagnoses.items()}
    steps = [join_steps(present, body)]
    for at, one in diagnoses.items():
        for step in one.steps[1:]:
            present = present | {at: step}
            steps.append(join_steps(present, body, f"{step.added}@{at}"))
    steps[-1] = steps[-1].with_log_format(collect_log_format(data.recordings))
    pairs = [*diagnoses.items()]
    return Diagnosis(
        steps=tuple(steps),
        candidates=tuple(
            replace(candidate, effect=f"{candidate.effect}@{at}", terms=())
            for is_selected in (True, False)
            for at, one in pairs
            for candidate in one.candidates
            if (candidate.effect in one.selected) == is_selected
        ),
        ambiguous=tuple(tuple(f"{id}@{at}" for id in group) for at, one in pairs for group in one.ambiguous),
        unexplained=tuple(replace(region, at=at) for at, one in pairs for region in one.unexplained),
        floors={at: floor for at, one in pairs for floor in one.floors.values()},
        findings=join_findings({at: one.findings for at, one in pairs}),
        data=data,
        joint_residuals={at: _get_residual(one) for at, one in pairs if one.unexplained},
    )


def join_findings(findings: Mapping[str, Sequence[Finding]]) -> tuple[AtJoint, ...]:
    """Join the findings by joint; equal ones are one finding on several joints."""
    joined = list[AtJoint]()
    for of_joint in findings.values():
        for finding in of_joint:
            if all(finding != other.finding for other in joined):
                joints = tuple(at for at, own in findings.items() if finding in own)
                joined.append(AtJoint(joints, finding))
    return tuple(joined)


def _get_residual(diagnosis: Diagnosis) -> float:
    """Return the error of the motion in the loop that the cause of the unexplained region states [rad]."""
    cause = diagnosis.unexplained[0].cause
    if isinstance(cause, ResidualWithoutPlace):
        return cause.residual.value
    return diagnosis.steps[-1].errors["holdout"].motion


def join_steps(steps: Mapping[str, Step], body: Mechanism, added: str | None = None, of: Model | None = None) -> Step:
    """Join the steps of the joints; other joints are those of a model `of` the arm."""
    parts = next(iter(steps.values())).errors
    errors = {part: join_errors({at: step.errors[part] for at, step in steps.items()}) for part in parts}
    servos = of.servos if isinstance(of, ServoArmModel) else {}
    servos = {**servos, **{at: step.model for at, step in steps.items()}}
    return Step(added, ServoArmModel.join(servos, body), errors)
