"""What chooses the torque: signals, planning and learning agents, and how they compare.

Importing it makes the task of choosing an excitation known to `gymnasium.make`.
"""

from gymnasium.envs.registration import register

from agents.network import Network, load
from agents.pilot import Pilot

DESIGN = "pendulum_env/ExcitationDesign-v0"

register(
    DESIGN,
    entry_point="agents.design_env:ExcitationDesign",
    vector_entry_point="agents.design_env:ExcitationDesignVector",
)

__all__ = ["DESIGN", "Network", "Pilot", "load"]
