"""What many diagnoses show together: which parameters drift or jump, which joints differ, since when."""

from estimators.fleet.course import Course, course
from estimators.fleet.onset import Onset, onset
from estimators.fleet.several import LEVEL, surely
from estimators.fleet.siblings import Odd, odd_ones

__all__ = ["LEVEL", "Course", "Odd", "Onset", "course", "odd_ones", "onset", "surely"]
