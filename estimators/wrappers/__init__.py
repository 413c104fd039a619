"""Gymnasium wrappers for online estimation, diagnosis and information rewards."""

from estimators.wrappers.diagnose_online import DiagnoseOnline, DiagnoseOnlineVector
from estimators.wrappers.estimate_parameters import EstimateParameters, EstimateParametersVector
from estimators.wrappers.information_reward import InformationReward, InformationRewardVector

__all__ = [
    "DiagnoseOnline",
    "DiagnoseOnlineVector",
    "EstimateParameters",
    "EstimateParametersVector",
    "InformationReward",
    "InformationRewardVector",
]
