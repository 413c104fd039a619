"""What many diagnoses show together: which parameters drift, which joints differ, what is weak in each and in all."""

from estimators.fleet.drift import Course, Drift, Jump, drift, jump
from estimators.fleet.onset import Onset, onset
from estimators.fleet.pooling import Pooled, pool, weigh
from estimators.fleet.several import LEVEL, surely
from estimators.fleet.siblings import Odd, odd_ones

__all__ = [
    "LEVEL",
    "Course",
    "Drift",
    "Jump",
    "Odd",
    "Onset",
    "Pooled",
    "drift",
    "jump",
    "odd_ones",
    "onset",
    "pool",
    "surely",
    "weigh",
]
