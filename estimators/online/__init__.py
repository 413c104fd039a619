"""Estimation while it runs: one sample in, the parameters of all schemes out."""

from estimators.online.diagnosis import Diagnoser, OnlineDiagnosis, Standing
from estimators.online.estimates import Estimates, SchemeEstimate, SchemeEstimates
from estimators.online.estimator import OnlineEstimator
from estimators.online.joint_state import JointState
from estimators.online.watch import Verdict, Watch

__all__ = [
    "Diagnoser",
    "Estimates",
    "JointState",
    "OnlineDiagnosis",
    "OnlineEstimator",
    "SchemeEstimate",
    "SchemeEstimates",
    "Standing",
    "Verdict",
    "Watch",
]
