"""What chooses the torque: signals, planning and learning agents, and how they compare."""

from agents.network import Network, load
from agents.pilot import Pilot
from pendulum_env.registration import DESIGN

__all__ = ["DESIGN", "Network", "Pilot", "load"]
