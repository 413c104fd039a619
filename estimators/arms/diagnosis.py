"""Which effect is missing at which joint of an arm: added one by one by the pendulum's score, the body fitted along."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimators.arms.evidence import gather_arm
from estimators.arms.identification import JointError, compare_arm
from estimators.arms.search import ArmCandidate, ArmSearch
from estimators.progress import Progress, no_progress
from estimators.selection.criterion import Criterion
from estimators.weak_form.dataset import LEAST_NOISE, TRIFLE
from pendulum_env._typing import JSON
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import friction, joint_effects
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Term

SCHEMA = "pendulum-ident/arm-diagnosis@1"
HELD_OUT = 0.3  # of each recording, where none is held out


@dataclass(frozen=True, eq=False)
class ArmDiagnosis:
    """What an arm's model lacks.

    Attributes:
        base: the model without them.
        model: with the effects that were found.
        selected: them, `stribeck@elbow`.
        candidates: what was judged, each effect once.
        before, after: torque errors on held-out data without and with them, joint by joint.
        unexplained: torque that each joint's neighbouring blocks still share [N m], where it surely is some.
    """

    base: ArmModel
    model: ArmModel
    selected: tuple[str, ...]
    candidates: tuple[ArmCandidate, ...]
    before: tuple[JointError, ...]
    after: tuple[JointError, ...]
    unexplained: Mapping[str, float]

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        return {
            "schema": SCHEMA,
            "selected": list(self.selected),
            "candidates": [candidate.json() for candidate in self.candidates],
            "errors": {"before": [e.json() for e in self.before], "after": [e.json() for e in self.after]},
            "unexplained": dict(self.unexplained),
            "model": self.model.json(),
        }


def parted(
    recordings: ArmRecording | Sequence[ArmRecording], holdout: Sequence[ArmRecording] = ()
) -> tuple[list[ArmRecording], list[ArmRecording]]:
    """What is fitted and what is held out: the last 30 % of each recording, where no others are."""
    recordings = [recordings] if isinstance(recordings, ArmRecording) else list(recordings)
    if holdout:
        return recordings, list(holdout)
    pairs = [recording.split(1 - HELD_OUT) for recording in recordings]
    return [first for first, _ in pairs], [last for _, last in pairs]


def diagnose_arm(
    recordings: ArmRecording | Sequence[ArmRecording],
    body: Body,
    holdout: Sequence[ArmRecording] = (),
    progress: Progress = no_progress,
    *,
    library: Mapping[str, type[Term]] | None = None,
    criterion: Criterion | None = None,
    rng: np.random.Generator | None = None,
) -> ArmDiagnosis:
    """Find the effects at joints that a rigid body with viscous and Coulomb friction lacks.

    Args:
        recordings: to fit.
        body: its links.
        holdout: to predict; without any, the last 30 % of each recording.
        progress: told what is being done.
        library: effects that may be named, by id; by default all that can sit at a joint.
        criterion: what they have to achieve.
        rng: of the bootstrap.

    Raises:
        IdentificationError: if a joint hardly moves.
    """
    train, held = parted(recordings, holdout)
    search = ArmSearch(
        gather_arm(train, body),
        gather_arm(held, body),
        joint_effects() if library is None else library,
        criterion or Criterion(),
        rng or np.random.default_rng(0),
        progress,
    )
    base = friction(body.joints)
    terms = search.find(base)
    lacking, model = search.report(base), search.report(terms)
    before, after = (compare_arm(one, held) for one in (lacking, model))
    residual = search.residual(terms)
    left = {joint: search.train.structure(residual, k) for k, joint in enumerate(body.joints)}
    return ArmDiagnosis(
        base=lacking,
        model=model,
        selected=tuple(own.id for own in terms[len(base) :]),
        candidates=tuple(search.ranking(terms)),
        before=before,
        after=after,
        unexplained={
            joint: size
            for k, (joint, (size, sure)) in enumerate(left.items())
            if sure > search.criterion.sure and size > TRIFLE / LEAST_NOISE * search.trifle(k)
        },
    )
