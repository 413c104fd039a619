"""Gymnasium wrappers that randomise the plant, and record measurements and videos."""

from pendulum_env.wrappers.randomize_plant import RandomizePlant, RandomizePlantVector
from pendulum_env.wrappers.record_measurements import RecordMeasurements
from pendulum_env.wrappers.record_video import RecordVideo

__all__ = ["RandomizePlant", "RandomizePlantVector", "RecordMeasurements", "RecordVideo"]
