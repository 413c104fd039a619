"""Gymnasium wrappers around what is measured and around the plant."""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from pendulum_env.wrappers.randomize_plant import RandomizePlant, RandomizePlantVector
    from pendulum_env.wrappers.record_measurements import RecordMeasurements
else:
    __getattr__, __dir__ = lazy_exports(__name__)

__all__ = ["RandomizePlant", "RandomizePlantVector", "RecordMeasurements"]
