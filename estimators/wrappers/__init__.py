"""Gymnasium wrappers for online estimation, diagnosis and information rewards."""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from estimators.wrappers.diagnose_online import DiagnoseOnline, DiagnoseOnlineVector
    from estimators.wrappers.estimate_parameters import EstimateParameters, EstimateParametersVector
    from estimators.wrappers.information_reward import InformationReward, InformationRewardVector
else:
    __getattr__, __dir__ = lazy_exports(__name__)

__all__ = [
    "DiagnoseOnline",
    "DiagnoseOnlineVector",
    "EstimateParameters",
    "EstimateParametersVector",
    "InformationReward",
    "InformationRewardVector",
]
