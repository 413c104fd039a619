"""Gymnasium wrappers that learn while the environment runs."""

from estimators.wrappers.estimate_parameters import EstimateParameters
from estimators.wrappers.estimate_parameters_vector import EstimateParametersVector
from estimators.wrappers.information_reward import InformationReward
from estimators.wrappers.information_reward_vector import InformationRewardVector

__all__ = ["EstimateParameters", "EstimateParametersVector", "InformationReward", "InformationRewardVector"]
