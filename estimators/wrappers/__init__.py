"""Gymnasium wrappers that learn while the environment runs."""

from estimators.wrappers.diagnose_online import DiagnoseOnline, DiagnoseOnlineVector
from estimators.wrappers.estimate_parameters import EstimateParameters, EstimateParametersVector
from estimators.wrappers.information_reward import InformationReward, InformationRewardVector
from estimators.wrappers.watch_model import WatchModel, WatchModelVector

__all__ = [
    "DiagnoseOnline",
    "DiagnoseOnlineVector",
    "EstimateParameters",
    "EstimateParametersVector",
    "InformationReward",
    "InformationRewardVector",
    "WatchModel",
    "WatchModelVector",
]
