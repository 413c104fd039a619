"""Estimation while it runs: one sample in, the parameters of all schemes out."""

from estimators.online.estimator import Estimates, OnlineEstimator, SchemeEstimate, SchemeEstimates

__all__ = ["Estimates", "OnlineEstimator", "SchemeEstimate", "SchemeEstimates"]
