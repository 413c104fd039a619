"""Policies that choose excitation torques: signals, planners and trained networks, and their comparison.

Related work: arXiv 2606.00059 (2026) trains excitation of a real machine and counts its safety violations.
"""

import lazy_loader

from pendulum_env.registration import ARM_DESIGN, DESIGN

__getattr__, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["ARM_DESIGN", "DESIGN"]


def __dir__() -> list[str]:
    return __all__
