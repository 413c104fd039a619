from .comparison import PolicyComparison, compare_policies
from .network import Network, load
from .observer import Pilot

ARM_DESIGN: str
DESIGN: str

__all__ = ["ARM_DESIGN", "DESIGN", "Network", "Pilot", "PolicyComparison", "compare_policies", "load"]
