"""Gymnasium environments of a pendulum and an arm, with their physics, recordings, excitation and backends.

The import registers the environments in Gymnasium.
"""

from pendulum_env.registration import ARM, ARM_DESIGN, DESIGN, PENDULUM, register_environments

__all__ = ["ARM", "ARM_DESIGN", "DESIGN", "PENDULUM"]

register_environments()
