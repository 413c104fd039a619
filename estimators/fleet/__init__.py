"""What many diagnoses show together: which parameters drift, which joints differ, what is weak in each and in all."""

from estimators.fleet.course import Course, course
from estimators.fleet.onset import Onset, onset
from estimators.fleet.pooling import Pooled, pool, weigh
from estimators.fleet.several import LEVEL, surely
from estimators.fleet.siblings import Odd, odd_ones

__all__ = ["LEVEL", "Course", "Odd", "Onset", "Pooled", "course", "odd_ones", "onset", "pool", "surely", "weigh"]
