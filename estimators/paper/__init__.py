"""The source paper's experiment, repeated on a pendulum whose parameters are known."""

from estimators.paper.as_printed import PRINTED, as_logged
from estimators.paper.experiment import PARAMETERS, TABLE_2, Experiment, paper_experiment
from estimators.paper.ways import WAYS, Way

__all__ = ["PARAMETERS", "PRINTED", "TABLE_2", "WAYS", "Experiment", "Way", "as_logged", "paper_experiment"]
