"""What produces measurements of a pendulum: physics, recordings, excitation, backends and the Gymnasium environment.

Importing it makes the environments known to `gymnasium.make`, without importing Gymnasium itself.
"""

from pendulum_env.plugin import announce

announce()
