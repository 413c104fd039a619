"""A survey: a diagnosis of each recording in a folder, one table, and the trends of machines."""

from workbench.survey.diagnosis import Settings, content_hash, diagnose_source
from workbench.survey.recordings import SurveyedRecording, find_recordings
from workbench.survey.run import survey
from workbench.survey.table import Series, find_series

__all__ = [
    "Series",
    "Settings",
    "SurveyedRecording",
    "content_hash",
    "diagnose_source",
    "find_recordings",
    "find_series",
    "survey",
]
