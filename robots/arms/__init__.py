"""Arms of n joints: bodies from files, recordings, simulated arms, excitation, payloads and standard parameters.

The import registers how models and recordings of an arm are read.
"""

import lazy_loader

from robots.arms.model import ArmModel as ArmModel  # registers models
from robots.arms.reading import read_arm_recording as read_arm_recording  # registers recordings

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
