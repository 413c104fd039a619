"""Options of a diagnosis."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.decisions.criterion import Criterion
from estimators.decisions.score import BLOCK
from estimators.diagnosis.experiment import ExperimentLimits
from estimators.progress import Progress, no_progress
from estimators.regression.least_squares import IdentificationError
from estimators.selection.evidence import Evidence
from pendulum_env.physics import Model, Term

LEAST_BLOCKS = 5  # least number of blocks longer than the default: folds and scatter need several


@dataclass(frozen=True)
class Options:
    """Options of a diagnosis.

    Attributes:
        base: terms that the search starts from, prepared for the recordings.
        library: effects that may be selected, by id.
        criterion: thresholds of the decisions.
        rng: random numbers of the bootstrap.
        progress: called with the present work and the share that is done.
        limits: bounds of the suggested experiment.
        horizon: time of free-running motion of a final refit [s]; None without.
        original: base of a pendulum as the user gave it.
        known: model of the same plant, whose parameters are a start of slow fits; None without one.
    """

    base: Sequence[Term]
    library: Mapping[str, type[Term]]
    criterion: Criterion = Criterion()
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    progress: Progress = no_progress
    limits: ExperimentLimits = field(default_factory=ExperimentLimits)
    horizon: float | None = None
    original: Sequence[Term] = ()
    known: Model | None = None

    def make_evidence(
        self, parts: tuple[RegressionData, RegressionData], tables: Sequence[type[Term]] = ()
    ) -> Evidence:
        """Return the evidence of fitted and held-out data, with tables that compete with the effects."""
        blocks = parts[0].layout.scored.of_block
        if self.criterion.block > BLOCK and len(blocks) < LEAST_BLOCKS:
            raise IdentificationError(
                f"blocks of {self.criterion.block:g} s are too long: the fitted recordings have {len(blocks)} of them, "
                f"and need at least {LEAST_BLOCKS}: give shorter blocks or more recordings"
            )
        return Evidence.from_data(
            *parts,
            base=tuple(self.base),
            library=self.library,
            tables=tables,
            criterion=self.criterion,
            rng=self.rng,
            progress=self.progress,
        )
