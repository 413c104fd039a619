"""What chooses the torque: signals, planning and learning agents, and how they compare."""

from agents.network import Network, load

__all__ = ["Network", "load"]
