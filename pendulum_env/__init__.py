"""Measurements of a pendulum: physics, recordings, excitation, backends and the Gymnasium environment.

Importing it makes the environments known to `gymnasium.make`, as is Gymnasium's custom.
"""

from pendulum_env.registration import register_environments

register_environments()
