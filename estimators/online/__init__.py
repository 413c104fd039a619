"""Online estimation and diagnosis, sample by sample.

    samples -> stream -> equations -> OnlineEstimator: parameters of all schemes
                 |
               Binner -> bins of motion -> Diagnoser: missing effects, changed parameters

A stream converts samples of B pendulums (`stream`), or samples of an arm in chunks (`arm_stream`), into equations. Both
take samples by `take(time, position, torque)`, and restart by `reset(which)`. `stream_recording` takes a recording.
"""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from estimators.online.diagnosis import Diagnoser, OnlineDiagnosis, RankingEntry
    from estimators.online.estimates import Estimates, SchemeEstimate, SchemeEstimates
    from estimators.online.estimator import OnlineEstimator
    from estimators.online.joint_state import JointState
    from estimators.online.replay import stream_recording
else:
    __getattr__, __dir__ = lazy_exports(__name__)

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
