"""The source paper's experiment, repeated on a pendulum whose parameters are known."""

from estimators.paper.experiment import PARAMETERS, TABLE_2, Experiment, paper_experiment
from estimators.paper.ways import WAYS, Way

__all__ = ["PARAMETERS", "TABLE_2", "WAYS", "Experiment", "Way", "paper_experiment"]
