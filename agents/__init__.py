"""Policies that choose excitation torques: signals, planners and trained networks, and their comparison."""

from typing import TYPE_CHECKING

from pendulum_env.lazy import lazy_exports

if TYPE_CHECKING:
    from agents.comparison import PolicyComparison, compare_policies
    from agents.network import Network, load
    from agents.observer import Pilot
    from pendulum_env.registration import ARM_DESIGN, DESIGN
else:
    __getattr__, __dir__ = lazy_exports(__name__)

__all__ = ["ARM_DESIGN", "DESIGN", "Network", "Pilot", "PolicyComparison", "compare_policies", "load"]
