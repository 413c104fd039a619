"""Measurements of a pendulum: physics, recordings, excitation, backends and the Gymnasium environment.

Importing it makes the environments known to `gymnasium.make`, as is Gymnasium's custom.
"""

from pendulum_env.registration import ARM, ARM_DESIGN, DESIGN, PENDULUM, register_environments

__all__ = ["ARM", "ARM_DESIGN", "DESIGN", "PENDULUM"]

register_environments()
