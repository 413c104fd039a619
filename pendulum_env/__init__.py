"""Gymnasium environments of a pendulum, with its physics, recordings, excitation and backends.

The import registers the environments in Gymnasium, also those of `robots`.
"""

from pendulum_env.registration import ARM, ARM_DESIGN, DESIGN, PENDULUM, register_environments

__all__ = ["ARM", "ARM_DESIGN", "DESIGN", "PENDULUM"]

register_environments()
