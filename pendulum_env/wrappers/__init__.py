"""Gymnasium wrappers that randomise the plant and record measurements."""

from pendulum_env.wrappers.randomize_plant import RandomizePlant, RandomizePlantVector
from pendulum_env.wrappers.record_measurements import RecordMeasurements

__all__ = ["RandomizePlant", "RandomizePlantVector", "RecordMeasurements"]
