"""Estimation and diagnosis while it runs: one sample in, what is known out.

    samples -> stream -> equations -> OnlineEstimator: parameters of all schemes
                 |
               Binner -> bins of motion -> Diagnoser: which effect does the model lack, which parameters have changed?

A stream is that of B pendulums, sample by sample (`stream`), or that of an arm's joints, chunk by chunk (`arm_stream`).
Both take samples by `take(time, position, torque)` and start anew by `reset(which)`.
"""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from estimators.online.diagnosis import Diagnoser, OnlineDiagnosis, Standing
    from estimators.online.estimates import Estimates, SchemeEstimate, SchemeEstimates
    from estimators.online.estimator import OnlineEstimator
    from estimators.online.joint_state import JointState
else:
    __getattr__, __dir__ = lazy_exports(__name__)

__all__ = [
    "Diagnoser",
    "Estimates",
    "JointState",
    "OnlineDiagnosis",
    "OnlineEstimator",
    "SchemeEstimate",
    "SchemeEstimates",
    "Standing",
]
