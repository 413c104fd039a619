from .diagnosis import Diagnoser, OnlineDiagnosis, RankingEntry
from .estimates import Estimates, SchemeEstimate, SchemeEstimates
from .estimator import OnlineEstimator
from .joint_state import JointState
from .replay import stream_recording

__all__ = [
    "Diagnoser",
    "Estimates",
    "JointState",
    "OnlineDiagnosis",
    "OnlineEstimator",
    "RankingEntry",
    "SchemeEstimate",
    "SchemeEstimates",
    "stream_recording",
]
