"""What chooses the torque: signals, planning and learning agents, and how they compare."""

from agents.comparison import PolicyComparison, compare_policies
from agents.network import Network, load
from agents.observer import Pilot
from pendulum_env.registration import ARM_DESIGN, DESIGN

__all__ = ["ARM_DESIGN", "DESIGN", "Network", "Pilot", "PolicyComparison", "compare_policies", "load"]
