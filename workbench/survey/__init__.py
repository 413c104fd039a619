"""A survey: a diagnosis of each of many recordings, on Dask, into one Parquet dataset, and what they show together."""

from workbench.survey.cases import Case, find_cases
from workbench.survey.dataset import Dataset
from workbench.survey.fleet import Fleet
from workbench.survey.run import Tally, survey
from workbench.survey.work import Settings, look

__all__ = ["Case", "Dataset", "Fleet", "Settings", "Tally", "find_cases", "look", "survey"]
