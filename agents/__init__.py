"""What chooses the torque: signals, planning and learning agents, and how they compare."""

from agents.network import Network, load
from agents.pilot import Pilot

__all__ = ["Network", "Pilot", "load"]
