"""Gymnasium wrappers that draw plants and hidden effects, and record measurements and videos."""

from pendulum_env.wrappers.hide_effects import HideEffects, HideEffectsVector
from pendulum_env.wrappers.randomize_plant import RandomizePlant, RandomizePlantVector
from pendulum_env.wrappers.record_measurements import RecordMeasurements
from pendulum_env.wrappers.record_video import RecordVideo

__all__ = [
    "HideEffects",
    "HideEffectsVector",
    "RandomizePlant",
    "RandomizePlantVector",
    "RecordMeasurements",
    "RecordVideo",
]
