"""What a diagnosis is told besides the recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.diagnosis.experiment import Limits
from estimators.free_swings import needs_torque
from estimators.progress import Progress, no_progress
from estimators.selection.criterion import Criterion
from estimators.selection.evaluator import ModelEvaluator
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import at_joints, body_of
from pendulum_env.physics import Term
from pendulum_env.physics.table import COMPETING, TABLES


@dataclass(frozen=True)
class Setting:
    """What a diagnosis is told besides the recordings.

    Attributes:
        base: terms of the model to start from.
        library: effects that may be named, by id.
        criterion: what they have to achieve.
        rng: of the bootstrap.
        progress: told what is being done and the share that is done.
        limits: of the rig, for the experiment that is suggested.
        by_reference: whether the base model is fitted by instruments.
    """

    base: Sequence[Term]
    library: Mapping[str, type[Term]]
    criterion: Criterion = field(default_factory=Criterion)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    progress: Progress = no_progress
    limits: Limits = field(default_factory=Limits)
    by_reference: bool = False

    def evaluator(self, prepared: tuple[RegressionData, RegressionData]) -> ModelEvaluator:
        """What some data say of models; at the joints of an arm any table may compete, in the loop of a servo none."""
        body, competes = body_of(self.base), prepared[0].layout.predicts_torque
        is_free = all(recording.known_inertia for recording in prepared[0].recordings)
        alone = [kind for kind in COMPETING if not (is_free and needs_torque(kind))]
        tables = at_joints(TABLES.values(), body) if isinstance(body, Body) else alone if competes else ()
        return ModelEvaluator(
            *prepared, self.progress, self.library, self.criterion, self.rng, tuple(self.base), tables
        )
